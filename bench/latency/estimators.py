"""Time and memory of one online update: serial, one machine, warm, interleaved rounds, every sample kept."""

from __future__ import annotations

import gc
import time
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from rich.progress import Progress

from bench import cells, results
from bench.cells import Cell, Outcome
from bench.registry import find, one_line
from bench.store import Store, key_of, write_atomically
from bench.threads import pin_torch
from methods.estimator import Estimator, Sample, State

ROUNDS = 10
WARM_UP = 60
MODE = "back_to_back"
COLUMNS = results.COLUMNS["latency.csv"]

Name = tuple[str, str, str, int]
"""The first four of COLUMNS."""


class _Runner:
    """An estimator on one machine's recording, timed a block at a time."""

    def __init__(self, estimator: Estimator, samples: np.ndarray) -> None:
        self.estimator, self.samples = estimator, samples
        self.state: State = estimator.init(1)
        *report, memory = self.state
        kept = (*estimator.arrays.values(), *report, *memory)
        self.memory_kB = round(sum(np.asarray(part).nbytes for part in kept) / 1e3, 1)
        """What it has learnt, says of one machine and carries from update to update."""
        self.at = 0
        self.advance(WARM_UP)

    def advance(self, updates: int) -> np.ndarray:
        """Wall time of each update in microseconds."""
        took = np.empty(updates)
        for i in range(updates):
            sample = Sample(0.05 * self.at, self.samples[self.at % len(self.samples)])
            self.at += 1
            start = time.perf_counter_ns()
            self.state, _ = self.estimator.step(self.state, sample)
            took[i] = (time.perf_counter_ns() - start) / 1e3
        return took


def measure(
    store: Store, updates: int, todo: list[Cell], progress: Progress
) -> tuple[pd.DataFrame, list[Outcome]]:
    """Time every trained estimator in each of its implementations; 0 updates: none.

    Returns:
        A table with COLUMNS, and the cells whose estimator does not run on a single machine.
    """
    rows: list[tuple[Any, ...]] = []
    failed: list[Outcome] = []
    if updates and todo:
        pin_torch()
        recording = cells.load_split(store, todo[0].data).test.measured[:1]
        samples = np.ascontiguousarray(recording.transpose(1, 0, 2))
        runners, failed = _runners(store, todo, samples)
        took = _time(runners, updates, progress)
        key = key_of(fits=[c.fit for c in todo], updates=updates)
        store.put("latency", key, lambda path: _save(took, path))
        rows = [(*name, *_percentiles(took[name]), runner.memory_kB) for name, runner in runners.items()]
    return pd.DataFrame(rows, columns=list(COLUMNS)), failed


def write(out: Path, table: pd.DataFrame) -> None:
    """Write ``latency.csv``."""
    write_atomically(out / "latency.csv", lambda path: table.to_csv(path, index=False))


def _runners(store: Store, todo: list[Cell], samples: np.ndarray) -> tuple[dict[Name, _Runner], list[Outcome]]:
    """Warm runners of every implementation, and who fails before it is warm."""
    runners: dict[Name, _Runner] = {}
    failed = []
    for cell in todo:
        for implementation in find(cell.spec).implementations:
            try:
                estimator = _variant(store, cell, implementation)
                runner = _Runner(estimator, samples)
            except Exception as error:
                failed.append(Outcome(cell, "latency", f"{implementation}: {one_line(error)}"))
            else:
                runners[cell.estimator, MODE, implementation, estimator.window] = runner
    return runners, failed


def _time(runners: dict[Name, _Runner], updates: int, progress: Progress) -> dict[Name, np.ndarray]:
    """Microseconds of each update, (updates,); the rounds interleaved, so that a disturbance hits all alike."""
    blocks: dict[Name, list[np.ndarray]] = {name: [] for name in runners}
    bar = progress.add_task("latency", total=ROUNDS)
    for several in np.array_split(np.arange(updates), ROUNDS):
        for name, runner in runners.items():
            gc.collect()
            blocks[name].append(runner.advance(len(several)))
        progress.advance(bar)
    return {name: np.concatenate(several) for name, several in blocks.items()}


def _percentiles(us: np.ndarray) -> list[float]:
    return [round(float(value), 2) for value in (*np.percentile(us, (50, 95, 99)), us.max())]


def _variant(store: Store, cell: Cell, implementation: str) -> Estimator:
    estimator = cells.load_fit(store, cell)
    if "implementation" in estimator.config:
        estimator.config["implementation"] = implementation
        estimator.restore()
    return estimator


def _save(took: dict[Name, np.ndarray], path: Path) -> None:
    named = {f"{estimator}.{implementation}": us for (estimator, _, implementation, _), us in took.items()}
    with open(path, "wb") as file:
        np.savez_compressed(file, allow_pickle=False, **named)
