"""A simulator written as an FMU: FMI 2.0, model exchange and co-simulation, with nothing of Python in it."""

from __future__ import annotations

import tempfile
import uuid
import zipfile
from pathlib import Path

import numpy as np

from twinbench.common.store import write_atomically
from twinbench.physics.fmu.binary_out import compiler, link
from twinbench.physics.fmu.description_out import description, identifier
from twinbench.physics.fmu.object_code import object_files
from twinbench.physics.fmu.unpack import platform_of
from twinbench.physics.simulator import Array, Simulator


def write_fmu(simulator: Simulator, path: Path) -> None:
    """Write a simulator's equations, compiled, with its variables and their nominal values.

    Raises:
        ValueError: one line: its equations cannot do without Python, or there is no C compiler; nothing is written.
    """
    compiler()  # before what takes long
    start, token, objects = _start(simulator), f"{{{uuid.uuid4()}}}", object_files(simulator)
    text = description(simulator, start, token)
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / "model.h").write_text(_header(simulator, start, token))
        library = link(objects, Path(folder), identifier(simulator))

        def pack(beside: Path) -> None:
            with zipfile.ZipFile(beside, "w", zipfile.ZIP_DEFLATED) as archive:
                archive.writestr("modelDescription.xml", text)
                archive.write(library, f"binaries/{platform_of('2')}/{library.name}")

        write_atomically(path, pack)


def _start(simulator: Simulator) -> Array:
    """Where it starts, (nx,) in the states' units: what ``initial`` makes of the nominal state's readings."""
    x, u = (np.array([v.nominal for v in group]) for group in (simulator.states, simulator.inputs))
    theta = simulator.theta()
    found = np.asarray(simulator.initial(u, np.asarray(simulator.output(x, u, theta)), theta), dtype=np.float64)
    if not np.isfinite(found).all():
        which = simulator.states[int(np.argmax(~np.isfinite(found)))].name
        raise ValueError(f"simulator {simulator.name!r}: initial gives no number for {which}; mend it there")
    return found


def _header(simulator: Simulator, start: Array, token: str) -> str:
    """What ``wrapper.c`` wants to know."""
    groups = {"NX": simulator.states, "NU": simulator.inputs, "NY": simulator.outputs, "NP": simulator.parameters}
    rest = np.zeros(len(simulator.states)), [v.nominal for v in simulator.inputs], np.zeros(len(simulator.outputs))
    values = np.concatenate((start, *rest, simulator.theta()))
    defined = {
        **{name: str(len(group)) for name, group in groups.items()},
        "TOKEN": f'"{token}"',
        "START": _in_c(values),
        "SCALE": _in_c(np.array([v.scale for v in simulator.states])),
    }
    return "".join(f"#define {name} {value}\n" for name, value in defined.items())


def _in_c(values: Array) -> str:
    return "{" + ", ".join(float(value).hex() for value in values) + "}"
