"""Cells: the units of work. Each is a function of its arguments alone, and leaves one part in the store."""

from __future__ import annotations

import functools
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from bench.estimates import Estimates
from bench.evaluate import run as evaluate
from bench.profile import Profile
from bench.registry import find
from bench.store import Store, key_of
from bench.versions import code_version
from data.batch import Batch, Truth
from data.benchmark import PARTS, Split, simulate_benchmark
from methods.estimator import Estimator


@dataclass(frozen=True)
class Cell:
    """One estimator with one seed. ``spec`` is its name, or the path of the file it comes from."""

    spec: str
    estimator: str
    seed: int


@dataclass(frozen=True)
class Outcome:
    """How a cell ended: ``reason`` is empty where it is done."""

    cell: Cell
    stage: str
    reason: str = ""


def data_key(profile: Profile) -> str:
    """What the simulated sequences depend on."""
    return key_of(
        design=asdict(profile.data), corruption=asdict(profile.corruption), code=code_version("data.benchmark")
    )


def settings_of(cell: Cell, profile: Profile) -> dict[str, Any]:
    """The estimator's settings under a profile."""
    return {**find(cell.spec).settings, **profile.settings.get(cell.estimator, {})}


def fit_key(cell: Cell, profile: Profile) -> str:
    """What a trained estimator depends on."""
    return key_of(
        estimator=cell.estimator,
        settings=settings_of(cell, profile),
        seed=cell.seed,
        code=code_version(find(cell.spec).__module__),
        data=data_key(profile),
    )


def estimates_key(cell: Cell, profile: Profile) -> str:
    """What the estimates over the test split depend on."""
    return key_of(
        fit=fit_key(cell, profile), evaluation=asdict(profile.evaluation), code=code_version("bench.evaluate")
    )


def ensure_data(store: Store, profile: Profile) -> None:
    """Simulate the benchmark's sequences unless they are there."""
    key = data_key(profile)
    if not store.has("data", key):
        split = simulate_benchmark(profile.data, profile.corruption)
        store.put("data", key, lambda path: _save_split(split, path))


def fit(store: Store, profile: Profile, cell: Cell) -> Outcome:
    """Train an estimator unless it is there."""
    return _attempt(cell, "fit", lambda: _fit(store, profile, cell))


def estimate(store: Store, profile: Profile, cell: Cell) -> Outcome:
    """Run a trained estimator over the test split unless that is done."""
    return _attempt(cell, "estimate", lambda: _estimate(store, profile, cell))


def load_fit(store: Store, profile: Profile, cell: Cell) -> Estimator:
    """A trained estimator from the store."""
    return find(cell.spec).load(store.path("fit", fit_key(cell, profile)))


def load_estimates(store: Store, profile: Profile, cell: Cell) -> Estimates:
    """Estimates from the store."""
    return Estimates.load(store.path("estimates", estimates_key(cell, profile)))


def _fit(store: Store, profile: Profile, cell: Cell) -> None:
    key = fit_key(cell, profile)
    if store.has("fit", key):
        return
    split = load_split(store, profile)
    estimator = find(cell.spec)(**profile.settings.get(cell.estimator, {}))
    estimator.fit(split.train, split.validation, cell.seed)
    store.put("fit", key, estimator.save)


def _estimate(store: Store, profile: Profile, cell: Cell) -> None:
    key = estimates_key(cell, profile)
    if store.has("estimates", key):
        return
    test = load_split(store, profile).test.without_truth()
    estimates = evaluate(load_fit(store, profile, cell), test, profile.evaluation, cell.seed)
    store.put("estimates", key, estimates.save)


def _attempt(cell: Cell, stage: str, work: Any) -> Outcome:
    from bench.threads import pin_torch

    pin_torch()
    try:
        work()
    except Exception as error:
        return Outcome(cell, stage, f"{type(error).__name__}: {error}".splitlines()[0])
    return Outcome(cell, stage)


def _save_split(split: Split, path: Path) -> None:
    arrays: dict[str, np.ndarray] = {}
    for part in PARTS:
        batch: Batch = getattr(split, part)
        assert batch.truth is not None
        arrays |= {
            f"{part}.names": np.array(batch.names),
            f"{part}.time_s": batch.time_s,
            f"{part}.measured": batch.measured,
            f"{part}.states": batch.truth.states,
            f"{part}.health": batch.truth.health,
            f"{part}.outputs": batch.truth.outputs,
            f"{part}.inputs": batch.truth.inputs,
        }
    with open(path, "wb") as file:
        np.savez(file, allow_pickle=False, **arrays)


def load_split(store: Store, profile: Profile) -> Split:
    """The simulated sequences from the store; the last one loaded stays in memory."""
    return _load_split(store.path("data", data_key(profile)))


def load_truth(store: Store, key: str) -> Batch:
    """The test sequences with their truth, by the key that a manifest records."""
    return _load_split(store.path("data", key)).test


@functools.lru_cache(maxsize=1)
def _load_split(path: Path) -> Split:
    with np.load(path, allow_pickle=False) as stored:
        parts = []
        for part in PARTS:
            fields = (stored[f"{part}.{name}"] for name in ("states", "health", "outputs", "inputs"))
            names = tuple(str(n) for n in stored[f"{part}.names"])
            parts.append(Batch(names, stored[f"{part}.time_s"], stored[f"{part}.measured"], Truth(*fields)))
    return Split(*parts)
