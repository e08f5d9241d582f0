"""Memory of an update, in loops of its own: what is held, what an update asks for besides, what the process holds."""

from __future__ import annotations

import re
import subprocess
import sys
import tracemalloc
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from twinbench.bench.latency.estimators import Stepped, weights_kB
from twinbench.bench.latency.forms import IN_PLACE
from twinbench.machines.load import machine_at
from twinbench.methods.deeponet_kalman.method import DeepONetKalman
from twinbench.methods.deeponet_kalman.online import Online
from twinbench.methods.estimator import Sample

STEPPED_UPDATES = 100
COLUMNS = ("estimator", "implementation", "weights_kB", "buffers_kB", "besides_kB", "process_MB")


class Held(NamedTuple):
    """One row, but for the process."""

    estimator: str
    implementation: str
    weights_kB: float
    buffers_kB: float
    besides_kB: float  # at most, during an update; of Python and NumPy: torch's own is not seen


def of_stepped(stepped: Stepped, implementation: str, ticks: Sequence[Any]) -> Held:
    """An estimator that carries its own state."""
    besides = _besides_kB(stepped, ticks)
    name = stepped.estimator.name
    return Held(name, implementation, weights_kB(stepped.estimator), stepped.buffers_kB, besides)


def in_place(twin: DeepONetKalman, rows: Sequence[Any]) -> Held:
    """DeepONet-Kalman in place: its packed weights, and all other buffers."""
    online = Online(twin)
    weights = twin.weights.nbytes / 1e3
    return Held(twin.name, IN_PLACE, weights, online.nbytes / 1e3 - weights, _besides_kB(online.update, rows))


def _besides_kB(update: Callable[[Any], object], ticks: Sequence[Any]) -> float:
    for tick in ticks[:STEPPED_UPDATES]:
        update(tick)
    tracemalloc.start()
    try:
        most = 0
        for tick in ticks[STEPPED_UPDATES : 2 * STEPPED_UPDATES]:
            tracemalloc.reset_peak()
            before, _ = tracemalloc.get_traced_memory()
            update(tick)
            most = max(most, tracemalloc.get_traced_memory()[1] - before)
    finally:
        tracemalloc.stop()
    return most / 1e3


class Stored(NamedTuple):
    """A trained estimator: its name or file, its machine's, and where it was written."""

    spec: str
    machine: str
    fitted: Path


def process_MB(stored: Stored, implementation: str = "") -> float:
    """The most that a process of its own held, interpreter and libraries included, after some updates; NaN: it died."""
    done = subprocess.run(
        [sys.executable, "-m", __name__, *map(str, stored), implementation], capture_output=True, text=True, check=False
    )
    return float(done.stdout) if done.returncode == 0 else float("nan")


def table(rows: Sequence[Held], processes: Sequence[float]) -> pd.DataFrame:
    """COLUMNS."""
    frame = pd.DataFrame(rows, columns=list(Held._fields)).round(1)
    return frame.assign(process_MB=[round(mb, 1) for mb in processes])[list(COLUMNS)]


def _main(spec: str, machine: str, fitted: str, implementation: str) -> None:
    from twinbench.bench.registry import find

    estimator = find(spec).load(Path(fitted), machine_at(machine))
    plant = estimator.machine.plant
    typical = np.array([v.nominal for v in (*plant.inputs, *plant.outputs)])
    if implementation == IN_PLACE:
        assert isinstance(estimator, DeepONetKalman)
        online = Online(estimator)
        for _ in range(STEPPED_UPDATES):
            online.update(typical)
    else:
        stepped = Stepped(estimator)
        for _ in range(STEPPED_UPDATES):
            stepped(Sample(0.0, typical[None]))
    # Not getrusage: there a child begins with its parent's peak.
    (peak_kB,) = re.findall(r"VmHWM:\s+(\d+)", Path("/proc/self/status").read_text())
    print(int(peak_kB) / 1e3)


if __name__ == "__main__":
    _main(*sys.argv[1:])
