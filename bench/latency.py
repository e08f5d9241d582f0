"""Time of one online update: serial, one machine, warm, interleaved rounds, every sample kept."""

from __future__ import annotations

import gc
import time
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from bench import cells
from bench.cells import Cell
from bench.profile import Profile
from bench.registry import find
from bench.store import Store, key_of, write_atomically
from methods.estimator import Estimator, Sample, State

ROUNDS = 10
WARM_UP = 60
COLUMNS = ("estimator", "mode", "implementation", "window", "p50_us", "p95_us", "p99_us", "max_us")


class _Runner:
    """An estimator on one machine's recording, timed a block at a time."""

    def __init__(self, estimator: Estimator, samples: np.ndarray) -> None:
        self.estimator, self.samples = estimator, samples
        self.state: State = estimator.init(1)
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


def measure(store: Store, profile: Profile, todo: list[Cell], out: Path, progress: Any = None) -> pd.DataFrame:
    """Time every trained estimator, in each of its implementations, and write ``latency.csv``."""
    if profile.latency.updates == 0 or not todo:
        table = pd.DataFrame(columns=list(COLUMNS))
    else:
        table = _measure(store, profile, todo, progress)
    write_atomically(out / "latency.csv", lambda path: table.to_csv(path, index=False))
    return table


def _measure(store: Store, profile: Profile, todo: list[Cell], progress: Any) -> pd.DataFrame:
    from bench.threads import pin_torch

    pin_torch()
    recording = cells.load_split(store, profile).test.measured[:1]
    samples = np.ascontiguousarray(recording.transpose(1, 0, 2))
    runners = {
        (cell.estimator, implementation): _Runner(_variant(store, profile, cell, implementation), samples)
        for cell in todo
        for implementation in find(cell.spec).implementations
    }
    took: dict[tuple[str, str], list[np.ndarray]] = {name: [] for name in runners}
    block = max(1, profile.latency.updates // ROUNDS)
    bar = progress.add_task("latency", total=ROUNDS) if progress else None
    for _ in range(ROUNDS):
        for name, runner in runners.items():
            gc.collect()
            took[name].append(runner.advance(block))
        if progress:
            progress.advance(bar)
    raw = {f"{e}.{i}": np.concatenate(t) for (e, i), t in took.items()}
    key = key_of(cells=[cells.fit_key(c, profile) for c in todo], updates=profile.latency.updates, at=time.time())
    store.put("latency", key, lambda path: _save(raw, path))
    rows = []
    for (estimator, implementation), blocks in took.items():
        us = np.concatenate(blocks)
        percentiles = [round(float(np.percentile(us, q)), 2) for q in (50, 95, 99)]
        window = runners[estimator, implementation].estimator.window
        rows.append((estimator, "back_to_back", implementation, window, *percentiles, round(float(us.max()), 2)))
    return pd.DataFrame(rows, columns=list(COLUMNS))


def _variant(store: Store, profile: Profile, cell: Cell, implementation: str) -> Estimator:
    estimator = cells.load_fit(store, profile, cell)
    if "implementation" in estimator.config:
        estimator.config["implementation"] = implementation
        estimator.restore()
    return estimator


def _save(raw: dict[str, np.ndarray], path: Path) -> None:
    with open(path, "wb") as file:
        np.savez_compressed(file, allow_pickle=False, **raw)
