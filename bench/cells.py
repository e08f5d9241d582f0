"""Cells: the units of work. Each is a function of its arguments alone, and leaves one part in the store."""

from __future__ import annotations

import functools
import hashlib
import time
from collections.abc import Callable, Iterable, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from twinbench.bench import calibrate
from twinbench.bench.estimates import Estimates
from twinbench.bench.profile import Profile
from twinbench.bench.registry import find, one_line
from twinbench.bench.roster import is_ablation
from twinbench.common.filespec import split_spec
from twinbench.common.store import CannotWrite, Store, key_of, reading, write_text
from twinbench.common.threads import pin_torch
from twinbench.common.versions import code_version
from twinbench.data.batch import Batch, Truth
from twinbench.data.benchmark import PARTS, Split, simulate_benchmark
from twinbench.machines.compressor import COMPRESSOR
from twinbench.machines.load import BUILTIN, machine_at
from twinbench.methods.estimator import Estimator


@dataclass(frozen=True)
class Cell:
    """One estimator with one seed, and the keys of its parts in the store.

    The keys are reckoned once, where the run is planned: a file that is edited while a run goes on
    must not send its workers looking for other parts.

    Attributes:
        spec: its name, or the path of the file it comes from.
        machine: the machine's name, or the path of the file it comes from.
        data, fit, estimates: keys of the simulated sequences, the trained estimator, its estimates. Where
            only the settings that work online differ, as in many ablations, training is shared; where
            nothing is drawn at random, all seeds share both.
        settings: those that the profile sets, and those that an ablation does.
    """

    spec: str
    machine: str
    estimator: str
    seed: int
    data: str
    fit: str
    estimates: str
    settings: tuple[tuple[str, Any], ...]

    def __str__(self) -> str:
        return f"{self.estimator}, seed {self.seed}"


@dataclass(frozen=True)
class Outcome:
    """How a cell ended: ``reason`` is empty where it is done."""

    cell: Cell
    stage: str
    reason: str = ""


def make_cell(spec: str, seed: int, profile: Profile) -> Cell:
    """A cell of a profile. Each key hashes all that its part depends on."""
    kind = find(spec)
    data = data_key(profile)
    own = {**profile.settings.get(kind.ablation_of or kind.name, {}), **kind.left_out}
    whole = {**kind.settings, **own}
    learnt = {name: value for name, value in whole.items() if name not in kind.online}
    fit = key_of(
        estimator=kind.ablation_of or kind.name,
        settings=learnt,
        seed=seed if kind.draws else None,
        code=code_version(kind.__module__),
        data=data,
    )
    evaluation = asdict(profile.evaluation)
    code = code_version("twinbench.bench.calibrate")
    estimates = key_of(fit=fit, online=_online(kind, own), evaluation=evaluation, code=code)
    return Cell(spec, profile.machine, kind.name, seed, data, fit, estimates, tuple(sorted(own.items())))


def of_first_seed(done: Iterable[Cell], profile: Profile) -> list[Cell]:
    """Whole methods with the profile's first seed, of which what is too long for every seed is shown."""
    return [c for c in done if c.seed == profile.seeds[0] and not is_ablation(c.estimator)]


def data_key(profile: Profile) -> str:
    """What the simulated sequences depend on."""
    code = code_version("twinbench.data.benchmark")
    made = {"design": asdict(profile.data), "corruption": asdict(profile.corruption), "code": code}
    return key_of(**made, machine=fingerprint_of(profile.machine))


@functools.cache
def fingerprint_of(machine: str) -> str:
    """What a machine is: of one in a file, that file's contents; of a built-in one its module's code.

    Args:
        machine: its name, or the path of the file it comes from.
    """
    if machine in BUILTIN:
        return code_version(BUILTIN[machine].partition(":")[0])
    file, _ = split_spec(machine)
    return hashlib.sha256(Path(file).read_bytes()).hexdigest() if file else machine


def ensure_data(store: Store, profile: Profile, key: str) -> None:
    """Simulate the benchmark's sequences unless they are there."""
    if not store.has("data", key):
        split = simulate_benchmark(profile.data, profile.corruption, machine_at(profile.machine))
        store.put("data", key, lambda path: save_split(split, path))


def fit(store: Store, profile: Profile, cell: Cell) -> Outcome:
    """Train an estimator unless it is there."""

    def train() -> Estimator:
        split = load_split(store, cell)
        estimator = find(cell.spec)(machine_at(cell.machine), **dict(cell.settings))
        estimator.fit(split.train, split.validation, cell.seed)
        return estimator

    return attempt(store, "fit", cell, cell.fit, lambda: train().save)


def estimate(store: Store, profile: Profile, cell: Cell) -> Outcome:
    """Run a trained estimator over the test and the calibration split unless that is done."""

    def run() -> Estimates:
        split = load_split(store, cell)
        test = split.test.without_truth()
        return calibrate.run(load_fit(store, cell), test, split.calibration, profile.evaluation, cell.seed)

    return attempt(store, "estimate", cell, cell.estimates, lambda: run().save)


def load_fit(store: Store, cell: Cell) -> Estimator:
    """A trained estimator from the store."""
    path = store.path("fit", cell.fit)
    with reading(path):
        return find(cell.spec).load(path, machine_at(cell.machine), **online(cell))


def online(cell: Cell) -> dict[str, Any]:
    """A cell's settings that need no training."""
    return _online(find(cell.spec), dict(cell.settings))


def _online(kind: type[Estimator], own: Mapping[str, Any]) -> dict[str, Any]:
    return {name: {**kind.settings, **own}[name] for name in sorted(kind.online)}


def load_estimates(store: Store, cell: Cell) -> Estimates:
    """Estimates from the store."""
    return Estimates.load(store.path("estimate", cell.estimates))


def attempt(
    store: Store, stage: str, cell: Cell, key: str, work: Callable[[], Callable[[Path], None]], suffix: str = ".npz"
) -> Outcome:
    """Do the work, unless it is done, and keep what its writer writes.

    What the method does wrong is an outcome; a full disk is not.
    """
    if store.has(stage, key, suffix):
        return Outcome(cell, stage)
    pin_torch()
    begun = time.process_time()
    try:
        store.put(stage, key, work(), suffix)
    except CannotWrite:
        raise
    except (Exception, SystemExit) as error:
        return Outcome(cell, stage, one_line(error))
    write_text(_cost_file(store, stage, key), f"{time.process_time() - begun:.3f}")
    return Outcome(cell, stage)


def cpu_s(store: Store, stage: str, key: str) -> float:
    """Processor time that a part took, whenever that was; NaN if that is not known."""
    try:
        return float(_cost_file(store, stage, key).read_text())
    except OSError:
        return np.nan


def _cost_file(store: Store, stage: str, key: str) -> Path:
    return store.path(stage, key).with_name("cpu_s")


def save_split(split: Split, path: Path) -> None:
    """Write the simulated sequences to one ``.npz``, without pickle."""
    save_batches({part: getattr(split, part) for part in PARTS}, path)


def save_batches(batches: Mapping[str, Batch], path: Path) -> None:
    """Write named sets of sequences, with their truth, to one ``.npz``, without pickle."""
    arrays: dict[str, np.ndarray] = {}
    for part, batch in batches.items():
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


def load_split(store: Store, cell: Cell) -> Split:
    """A cell's simulated sequences from the store."""
    return split_at(store, cell.data, cell.machine)


def split_at(store: Store, key: str, machine: str) -> Split:
    """Simulated sequences from the store.

    Args:
        key: theirs.
        machine: its name, or the path of the file it comes from.
    """
    path = store.path("data", key)
    with reading(path):
        return Split(**load_batches(path, machine))


@functools.lru_cache(maxsize=1)
def load_batches(path: Path, machine: str = COMPRESSOR.name) -> dict[str, Batch]:
    """Read what ``save_batches`` wrote of a machine; the last ones loaded stay in memory."""
    of = machine_at(machine)
    with reading(path), open(path, "rb") as file, np.load(file, allow_pickle=False) as stored:
        batches = {}
        for part in dict.fromkeys(name.partition(".")[0] for name in stored.files):
            fields = (stored[f"{part}.{name}"] for name in ("states", "health", "outputs", "inputs"))
            names = tuple(str(n) for n in stored[f"{part}.names"])
            truth = Truth(*fields, machine=of)
            batches[part] = _whole(Batch(names, stored[f"{part}.time_s"], stored[f"{part}.measured"], truth, of))
    return batches


def _whole(batch: Batch) -> Batch:
    """The sequences, if their arrays have the shapes that belong together."""
    assert batch.truth is not None
    machine = batch.machine
    leading = (len(batch.names), len(batch.time_s))
    shapes = {
        "measured": (batch.measured, len(machine.channels)),
        "health": (batch.truth.health, len(machine.health)),
        "outputs": (batch.truth.outputs, len(machine.outputs)),
        "inputs": (batch.truth.inputs, len(machine.inputs)),
        "states": (batch.truth.states, len(machine.plant.states)),
    }
    for name, (array, width) in shapes.items():
        if array.shape != (*leading, width):
            raise ValueError(f"{name} has shape {array.shape}, must have {(*leading, width)}")
    return batch
