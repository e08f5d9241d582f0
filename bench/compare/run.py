"""Trained estimators over a user's recordings of a machine, held against what was read later."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import pandas as pd

from twinbench.bench import cells
from twinbench.bench.cells import Cell
from twinbench.bench.compare.page import says, table
from twinbench.bench.compare.scores import promised, score
from twinbench.bench.compare.watched import LEADS_S, lead_ticks, watch
from twinbench.bench.estimate.apply import trained_cells
from twinbench.bench.profile import Profile
from twinbench.bench.registry import one_line
from twinbench.bench.report.provenance import bullets, write_tables
from twinbench.bench.report.table_formats import Table
from twinbench.common.errors import BadInput
from twinbench.common.jobs import cores
from twinbench.common.progress import each
from twinbench.common.store import Store, check_writable, write_csv, write_text
from twinbench.common.threads import pin_torch
from twinbench.common.workers import side_by_side
from twinbench.data.batch import Batch
from twinbench.data.recording import read_recording
from twinbench.data.units import limits_of, units_of
from twinbench.machines.load import load_machine, machine_at
from twinbench.machines.machine import Machine

FEWEST_ORIGINS = 10
"""Forecasts that a recording must have room for. With fewer its score is an accident."""


@dataclass(frozen=True)
class Compared:
    """How estimators compare on a user's recordings.

    Attributes:
        scores: columns ``estimator, seed, sequence, metric, value``.
        failed: estimators that failed, and why.
        sentences: what the table's tests say.
    """

    scores: pd.DataFrame
    failed: dict[str, str]
    table: Table
    sentences: list[str]


def compare(
    profile: Profile, results: Path | None, names: Sequence[str], paths: Sequence[Path], mapping: Sequence[str]
) -> Compared:
    """Run the named estimators, or all that are trained, over recordings; every one is read before anything runs.

    Args:
        profile: what they were trained with, and on which machine.
        results: folder of the run that trained them; where ``twinbench run`` puts it if left out.
        names: of estimators.
        paths: of the recordings.
        mapping: ``COLUMN[unit]=channel``, as ``read_recording`` takes it.

    Raises:
        BadInput: one line; a recording that cannot be used, or an estimator that is not trained.
    """
    load_machine(profile.machine)
    batches = read(profile.machine, paths, mapping)
    store, found = trained_cells(profile, results, names)
    ran = side_by_side(_one, [(store, cell, tuple(paths), tuple(mapping)) for cell in found], cores())
    outcomes = [next(ran) for _ in each("compare", [cell.estimator for cell in found])]
    failed = {name: reason for name, reason, _ in outcomes if reason}
    good = [scores for _, reason, scores in outcomes if not reason]
    if not good:
        raise BadInput("no estimator could be run: " + "; ".join(f"{n}: {why}" for n, why in failed.items()))
    scores = pd.concat(good, ignore_index=True)
    return Compared(scores, failed, table(scores, batches[0].machine.name), says(scores))


def write(out: Path, found: Compared) -> None:
    """Scores, the table in every format, and the sentences."""
    check_writable(out)
    write_csv(out / "scores.csv", found.scores)
    write_tables(out, [found.table])
    write_text(out / "answer.md", bullets(*found.sentences))


def read(machine: str, paths: Sequence[Path], mapping: Sequence[str]) -> list[Batch]:
    """Every recording as a batch of one.

    Args:
        machine: its name, or the path of the file it comes from.
        paths: of the recordings.
        mapping: ``COLUMN[unit]=channel``.

    Raises:
        BadInput: one line; a recording that cannot be used, or two of one name.
    """
    batches = [_read(machine_at(machine), path, mapping) for path in paths]
    names = [batch.names[0] for batch in batches]
    repeated = [name for name in names if names.count(name) > 1]
    if repeated:
        raise BadInput(f"two recordings are named {repeated[0]}; rename one of the files")
    return batches


def _read(machine: Machine, path: Path, mapping: Sequence[str]) -> Batch:
    period_s = machine.sample_period_s
    units, limits = units_of(machine), limits_of(machine)
    recording = read_recording(path, mapping, units, limits, period_s=period_s)
    batch = recording.to_batch(machine)
    least = max(lead_ticks(period_s)) + FEWEST_ORIGINS
    if batch.measured.shape[1] < least:
        raise BadInput(
            f"recording {recording.name} has {batch.measured.shape[1]} ticks of {period_s:g} s; {least} are needed to "
            f"foretell {LEADS_S[-1]:g} s ahead from {FEWEST_ORIGINS} of them; give a longer one"
        )
    return batch


def _one(store: Store, cell: Cell, paths: tuple[Path, ...], mapping: tuple[str, ...]) -> tuple[str, str, pd.DataFrame]:
    """An estimator's scores of every recording; or why it failed."""
    pin_torch()
    try:
        estimator = cells.load_fit(store, cell)
        sd = promised(watch(estimator, cells.load_split(store, cell).calibration.without_truth()))
        batches = read(cell.machine, paths, mapping)
        parts = [score(batch.names[0], watch(estimator, batch), sd) for batch in batches]
    except Exception as error:
        return cell.estimator, one_line(error), pd.DataFrame()
    return cell.estimator, "", pd.concat(parts).assign(estimator=cell.estimator, seed=cell.seed)
