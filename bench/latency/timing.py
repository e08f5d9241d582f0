"""The clock: updates back to back in interleaved rounds, and one by one at the pace of a machine; who disturbed."""

from __future__ import annotations

import contextlib
import gc
import os
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from twinbench.common.progress import Progress
from twinbench.machines.coordinates import Array

ROUNDS = 10
WARM_UP = 60
OTHERS_MOST = 0.1
"""Cores that other processes, or other guests of the hardware, may take on a machine that counts as quiet."""


class Name(NamedTuple):
    """What is timed."""

    estimator: str
    implementation: str
    window: int


class Timed:
    """An update that is called with one sample after the other, round and round."""

    def __init__(self, name: Name, update: Callable[[Any], object], samples: Sequence[Any]) -> None:
        self.name, self._update, self._samples, self._at = name, update, samples, 0
        for _ in range(WARM_UP):
            self.once()

    def once(self) -> float:
        """Wall time of the next update in microseconds."""
        update, sample = self._update, self._samples[self._at % len(self._samples)]
        self._at += 1
        start = time.perf_counter_ns()
        update(sample)
        return (time.perf_counter_ns() - start) / 1e3


def back_to_back(several: Sequence[Timed], updates: int, progress: Progress) -> dict[Name, Array]:
    """Microseconds (updates,) of each; the rounds interleaved, so that a disturbance hits all alike."""
    blocks: dict[Name, list[float]] = {one.name: [] for one in several}
    with _swept(), progress.stage("latency", ROUNDS * len(several)) as going:
        for count in map(len, np.array_split(np.arange(updates), ROUNDS)):
            for one in several:
                gc.collect()
                blocks[one.name] += [one.once() for _ in range(count)]
                going.step()
    return {name: np.array(us) for name, us in blocks.items()}


def paced(several: Sequence[Timed], ticks: int, period_s: float, progress: Progress) -> dict[Name, Array]:
    """The same, one update each period with nothing in between: caches and clock have gone cold, as on a machine."""
    took: dict[Name, Array] = {}
    with _swept(), progress.stage(f"at {1.0 / period_s:g} Hz", len(several)) as going:
        for one in several:
            gc.collect()
            us, due = np.empty(ticks), time.perf_counter()
            for i in range(ticks):
                due += period_s
                time.sleep(max(due - time.perf_counter(), 0.0))
                us[i] = one.once()
            took[one.name] = us
            going.step()
    return took


@contextlib.contextmanager
def _swept() -> Iterator[None]:
    """Meanwhile Python's garbage collector looks at nothing that was there before, recordings above all."""
    gc.collect()
    gc.freeze()
    try:
        yield
    finally:
        gc.unfreeze()


def percentiles(us: Array) -> dict[str, float]:
    """Of the time of an update; jitter is the mean change from one update to the next.

    Args:
        us: (n,) us, one per update.
    """
    p50, p95, p99 = np.percentile(us, (50, 95, 99))
    figures = {"p50_us": p50, "p95_us": p95, "p99_us": p99, "max_us": us.max(), "jitter_us": _jitter(us)}
    return {name: round(float(value), 2) for name, value in figures.items()}


def _jitter(us: Array) -> float:
    return float(np.abs(np.diff(us)).mean()) if us.size > 1 else 0.0


class Watch:
    """How busy the machine was beside this process, from its making to ``told``; unknown where there is no /proc."""

    def __init__(self) -> None:
        self._load, self._begun, self._own, self._all = _load(), time.perf_counter(), _own_s(), _machine_s()

    def told(self) -> dict[str, Any]:
        """Load averages, cores that others took on average, whether that was too much, and the core pinned to."""
        wall = time.perf_counter() - self._begun
        told: dict[str, Any] = {"load_1min_before": self._load, "load_1min_after": _load(), "wall_s": round(wall, 1)}
        now = _machine_s()
        if self._all is not None and now is not None:
            others = max(now[0] - self._all[0] - (_own_s() - self._own), 0.0) / wall
            stolen = (now[1] - self._all[1]) / wall
            told |= {"others_cores": round(others, 3), "stolen_cores": round(stolen, 3)}
            told["loaded"] = others + stolen > OTHERS_MOST
        return told


@contextlib.contextmanager
def one_core() -> Iterator[int | None]:
    """Meanwhile this process stays on one core, the last it may use; None where the system cannot."""
    if not hasattr(os, "sched_setaffinity"):
        yield None
        return
    allowed = os.sched_getaffinity(0)
    core = max(allowed)
    os.sched_setaffinity(0, {core})
    try:
        yield core
    finally:
        os.sched_setaffinity(0, allowed)


def _load() -> float | None:
    return round(os.getloadavg()[0], 2) if hasattr(os, "getloadavg") else None


def _own_s() -> float:
    own = os.times()
    return own.user + own.system


def _machine_s() -> tuple[float, float] | None:
    """Processor seconds that the whole machine has been busy, and those that other guests took from it."""
    try:
        user, nice, system, _, _, irq, soft, stolen = map(int, Path("/proc/stat").read_text().split(maxsplit=9)[1:9])
    except (OSError, ValueError):
        return None
    tick = os.sysconf("SC_CLK_TCK")
    return (user + nice + system + irq + soft) / tick, stolen / tick
