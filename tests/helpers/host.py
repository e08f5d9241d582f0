"""A host of FMUs that is not ours: FMPy, which calls what the standard says and checks what it allows."""

from __future__ import annotations

import ctypes
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np
import pytest

from twinbench.physics.simulator import Array

fmpy = pytest.importorskip("fmpy", reason="reads FMUs as others do; pip install fmpy")
fmi2 = pytest.importorskip("fmpy.fmi2")


class Host:
    """One instance of an FMU, initialised; variables are known by their names."""

    def __init__(self, file: Path, folder: Path, exchange: bool) -> None:
        self.about = fmpy.read_model_description(str(file))
        self.references = {v.name: v.valueReference for v in self.about.modelVariables}
        inside = fmpy.extract(str(file), unzipdir=str(folder / f"{file.stem}_{exchange}"))
        kind, part = (
            (fmi2.FMU2Model, self.about.modelExchange) if exchange else (fmi2.FMU2Slave, self.about.coSimulation)
        )
        self.fmu: Any = kind(
            guid=self.about.guid, unzipDirectory=inside, modelIdentifier=part.modelIdentifier, instanceName="one"
        )

    def __enter__(self) -> Host:
        self.fmu.instantiate()
        self.fmu.setupExperiment(startTime=0.0)
        self.fmu.enterInitializationMode()
        self.fmu.exitInitializationMode()
        return self

    def __exit__(self, *_: type[BaseException] | BaseException | TracebackType | None) -> None:
        self.fmu.terminate()
        self.fmu.freeInstance()

    def set(self, names: list[str], values: Array) -> None:
        """Each in its variable's unit."""
        self.fmu.setReal([self.references[name] for name in names], [float(value) for value in values])

    def get(self, names: list[str]) -> Array:
        """As many values, each in its variable's unit."""
        return np.array(self.fmu.getReal([self.references[name] for name in names]))

    def rates(self, x: Array) -> Array:
        """dx/dt (nx,) at states (nx,)."""
        dx = np.empty(x.size)
        places = [ctypes.cast(a.ctypes.data, ctypes.POINTER(ctypes.c_double)) for a in (x, dx)]
        self.fmu.setContinuousStates(places[0], x.size)
        self.fmu.getDerivatives(places[1], x.size)
        return dx
