"""What a simulator says a machine would have shown for recorded inputs."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from pathlib import Path

import numpy as np
import pandas as pd

from twinbench.common.errors import BadInput
from twinbench.common.store import write_atomically
from twinbench.data.recording import TIME
from twinbench.mismatch.machine import Setting
from twinbench.mismatch.model import Model, as_bad_input, load_model
from twinbench.mismatch.recordings import read_recordings
from twinbench.mismatch.stepped import machine_of
from twinbench.mismatch.steps import settle_step
from twinbench.mismatch.tracks import Track, prepare

_ACCURACY = 0.02
"""The integration step is halved until it moves readings by less than a twentieth of this share of their scale."""


def replay(
    spec: str, paths: Sequence[Path], out: Path, mapping: Sequence[str], kind: str, trust: bool = False
) -> list[Path]:
    """Write ``<recording>.simulated.<kind>`` into ``out``: time, the recorded inputs, the simulated outputs.

    Open loop from the first readings, or from the simulator's nominal ones where none were recorded;
    the faults that a ``model.toml`` holds are in the outputs.

    Args:
        kind: ``csv`` or ``parquet``.
        trust: run the Python that a ``model.toml`` names wherever it lies.

    Raises:
        BadInput: the simulator or a recording cannot be used, or the simulator diverges; nothing is written.
    """
    model = load_model(spec, trust)
    tracks = prepare(read_recordings(paths, model.simulator, mapping), model.simulator, linear=model.inputs == "linear")
    tables = _run(model, tracks)
    written = []
    for track, table in zip(tracks, tables, strict=True):
        path = out / f"{track.name}.simulated.{kind}"
        write_atomically(path, partial(table.to_csv if kind == "csv" else table.to_parquet, index=False))
        written.append(path)
    return written


def _run(model: Model, tracks: Sequence[Track]) -> list[pd.DataFrame]:
    simulator = model.simulator
    machine = machine_of(simulator, (), model.faults)
    with as_bad_input():
        settle_step(machine, tracks, _ACCURACY * np.array([v.scale for v in simulator.outputs]))
    tables = []
    for track in tracks:
        y = machine.run(Setting(track, machine.theta, machine.start(track)))
        wrong = ~np.isfinite(y).all(axis=1)
        if wrong.any():
            raise BadInput(
                f"simulator {simulator.name!r} diverges on recording {track.name} at "
                f"{track.time_s[int(np.argmax(wrong))]:.6g} s; check its equations, units and parameters"
            )
        columns = {TIME: track.time_s}
        columns |= {v.name: track.u[:, i] for i, v in enumerate(simulator.inputs)}
        columns |= {v.name: y[:, i] for i, v in enumerate(simulator.outputs)}
        tables.append(pd.DataFrame(columns))
    return tables
