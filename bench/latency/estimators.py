"""The registry's estimators on one machine: ``step`` in each implementation, timed at the end of every run."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd

from twinbench.bench import cells
from twinbench.bench.cells import Cell, Outcome
from twinbench.bench.latency.timing import Name, Timed, back_to_back, percentiles
from twinbench.bench.registry import find, one_line
from twinbench.bench.roster import TRIVIAL
from twinbench.common.progress import Progress
from twinbench.common.store import Store, key_of, write_csv
from twinbench.common.threads import pin_torch
from twinbench.machines.coordinates import Array
from twinbench.machines.load import machine_at
from twinbench.machines.machine import Machine
from twinbench.methods.estimator import Estimator, Sample

MODE = "back_to_back"
COLUMNS = (
    "estimator", "mode", "implementation", "window", "p50_us", "p95_us", "p99_us", "max_us", "jitter_us", "memory_kB",
)  # fmt: skip


class Stepped:
    """An estimator that carries its own state."""

    def __init__(self, estimator: Estimator) -> None:
        self.estimator, self.state = estimator, estimator.init(1)

    def __call__(self, sample: Sample) -> None:
        self.state, _ = self.estimator.step(self.state, sample)

    @property
    def buffers_kB(self) -> float:
        """What it says of one machine and carries from update to update."""
        *report, memory = self.state
        return sum(np.asarray(part).nbytes for part in (*report, *memory)) / 1e3


def weights_kB(estimator: Estimator) -> float:
    """What it has learnt."""
    return sum(array.nbytes for array in estimator.arrays.values()) / 1e3


def recording(store: Store, todo: list[Cell]) -> Array:
    """Readings (N, nu + ny) of the first test recording, NaN where missing."""
    return np.ascontiguousarray(cells.load_split(store, todo[0]).test.measured[0])


def samples(readings: Array, machine: Machine) -> list[Sample]:
    """One machine's ticks.

    Args:
        readings: (N, nu + ny) in the channels' units; NaN means missing.
        machine: of which kind.
    """
    return [Sample(machine.sample_period_s * k, row[None]) for k, row in enumerate(readings)]


def runners(store: Store, todo: list[Cell], readings: Array) -> tuple[dict[Name, tuple[Timed, Stepped]], list[Outcome]]:
    """Warm runners of every implementation, and who fails before it is warm; the trivial rows do nothing worth timing.

    Args:
        readings: (N, nu + ny) in the channels' units; NaN means missing.
    """
    ready: dict[Name, tuple[Timed, Stepped]] = {}
    failed = []
    ticks = samples(readings, machine_at(todo[0].machine)) if todo else []
    for cell in (c for c in todo if c.estimator not in TRIVIAL):
        kind = find(cell.spec)
        for implementation in () if kind.two_sided else kind.implementations:
            try:
                stepped = Stepped(variant(store, cell, implementation))
                name = Name(cell.estimator, implementation, stepped.estimator.window)
                ready[name] = Timed(name, stepped, ticks), stepped
            except Exception as error:
                failed.append(Outcome(cell, "latency", f"{implementation}: {one_line(error)}"))
    return ready, failed


def variant(store: Store, cell: Cell, implementation: str) -> Estimator:
    """A trained estimator in one of its implementations."""
    estimator = cells.load_fit(store, cell)
    if "implementation" in estimator.config:
        estimator.config["implementation"] = implementation
        estimator.restore()
    return estimator


def measure(store: Store, updates: int, todo: list[Cell], progress: Progress) -> tuple[pd.DataFrame, list[Outcome]]:
    """Time every trained estimator in each of its implementations; 0 updates: none.

    Returns:
        A table with COLUMNS, and the cells whose estimator does not run on a single machine.
    """
    rows: list[dict[str, object]] = []
    failed: list[Outcome] = []
    if updates and todo:
        pin_torch()
        ready, failed = runners(store, todo, recording(store, todo))
        took = back_to_back([timed for timed, _ in ready.values()], updates, progress)
        key = key_of(fits=[c.fit for c in todo], updates=updates)
        store.put("latency", key, lambda path: save_samples({MODE: took}, path))
        for name, (_, stepped) in ready.items():
            memory_kB = round(weights_kB(stepped.estimator) + stepped.buffers_kB, 1)
            rows.append({**name._asdict(), "mode": MODE, **percentiles(took[name]), "memory_kB": memory_kB})
    return pd.DataFrame(rows, columns=list(COLUMNS)), failed


def write(out: Path, table: pd.DataFrame) -> None:
    """Write ``latency.csv``."""
    write_csv(out / "latency.csv", table)


def save_samples(took: dict[str, dict[Name, Array]], path: Path) -> None:
    """Every timed update in microseconds: by mode, estimator, implementation and window an array of an ``.npz``.

    Args:
        took: (n,) us, by mode and name.
    """
    named = {".".join((mode, *map(str, name))): us for mode, by_name in took.items() for name, us in by_name.items()}
    with open(path, "wb") as file:
        np.savez_compressed(file, allow_pickle=False, **named)
