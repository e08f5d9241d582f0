"""The estimators in the scenes of the paper's figures, ``data.scenes``; their estimates are kept in the store."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

from bench import cells
from bench.cells import Cell, Outcome
from bench.evaluate import run as evaluate
from bench.profile import Evaluation, Profile
from bench.store import Store, key_of
from bench.versions import code_version
from data.scenes import load_ramps, wearing

RECORDINGS, KIND = "scenes", "scene"
SCENES = {"ramps": load_ramps, "wearing": wearing}
EVALUATION = Evaluation()


@dataclass(frozen=True)
class Take:
    """One estimator in one of SCENES, and the keys of all recordings and of its estimates in the store."""

    cell: Cell
    scene: str
    recordings: str
    key: str


def ensure_recordings(store: Store, profile: Profile, key: str) -> None:
    """Simulate the scenes unless they are there."""
    if not store.has(RECORDINGS, key):
        batches = {name: simulate(profile.data.seed, profile.corruption) for name, simulate in SCENES.items()}
        store.put(RECORDINGS, key, lambda path: cells.save_batches(batches, path))


def recordings_key(profile: Profile) -> str:
    """What the simulated scenes depend on."""
    return key_of(seed=profile.data.seed, corruption=asdict(profile.corruption), code=code_version("data.scenes"))


def takes(done: Sequence[Cell], profile: Profile) -> list[Take]:
    """Every estimator in every scene, with its first seed."""
    recordings = recordings_key(profile)
    return [_take(cell, scene, recordings) for cell in cells.of_first_seed(done, profile) for scene in SCENES]


def _take(cell: Cell, scene: str, recordings: str) -> Take:
    code = code_version("bench.evaluate")
    key = key_of(fit=cell.fit, online=cells.online(cell), recordings=recordings, scene=scene, code=code)
    return Take(cell, scene, recordings, key)


def attempt(store: Store, take: Take) -> Outcome:
    """Run a trained estimator over a scene unless that is done."""

    def run() -> Callable[[Path], None]:
        batch = cells.load_batches(store.path(RECORDINGS, take.recordings))[take.scene].without_truth()
        return evaluate(cells.load_fit(store, take.cell), batch, EVALUATION, take.cell.seed).save

    return replace(cells.attempt(store, KIND, take.cell, take.key, run), stage=f"scene: {take.scene}")
