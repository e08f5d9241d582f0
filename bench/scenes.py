"""The estimators in the scenes of the paper's figures, ``data.scenes``; their estimates are kept in the store."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

from twinbench.bench import cells
from twinbench.bench.cells import Cell, Outcome
from twinbench.bench.evaluate import run as evaluate
from twinbench.bench.profile import Evaluation, Profile
from twinbench.common.store import Store, key_of
from twinbench.common.versions import code_version
from twinbench.data.scenes import load_ramps, wearing

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

    def __str__(self) -> str:
        return f"{self.cell}, {self.scene}"


def ensure_recordings(store: Store, profile: Profile, key: str) -> None:
    """Simulate the scenes unless they are there."""
    if not store.has(RECORDINGS, key):
        batches = {name: simulate(profile.data.seed, profile.corruption) for name, simulate in SCENES.items()}
        store.put(RECORDINGS, key, lambda path: cells.save_batches(batches, path))


def recordings_key(profile: Profile) -> str:
    """What the simulated scenes depend on."""
    code = code_version("twinbench.data.scenes")
    return key_of(seed=profile.data.seed, corruption=asdict(profile.corruption), code=code)


def takes(done: Sequence[Cell], profile: Profile) -> list[Take]:
    """Every estimator in every scene, with its first seed."""
    recordings = recordings_key(profile)
    return [_take(cell, scene, recordings) for cell in cells.of_first_seed(done, profile) for scene in SCENES]


def _take(cell: Cell, scene: str, recordings: str) -> Take:
    code = code_version("twinbench.bench.evaluate")
    key = key_of(fit=cell.fit, online=cells.online(cell), recordings=recordings, scene=scene, code=code)
    return Take(cell, scene, recordings, key)


def attempt(store: Store, take: Take) -> Outcome:
    """Run a trained estimator over a scene unless that is done."""

    def run() -> Callable[[Path], None]:
        batch = cells.load_batches(store.path(RECORDINGS, take.recordings))[take.scene].without_truth()
        return evaluate(cells.load_fit(store, take.cell), batch, EVALUATION, take.cell.seed).save

    return replace(cells.attempt(store, KIND, take.cell, take.key, run), stage=f"scene: {take.scene}")
