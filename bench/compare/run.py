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
from twinbench.bench.compare.watched import lead_ticks, watch
from twinbench.bench.cost import of_comparison
from twinbench.bench.estimate.apply import Training, read_all, trained_cells
from twinbench.bench.profile import profile_on
from twinbench.bench.registry import one_line
from twinbench.bench.report.provenance import bullets, write_tables
from twinbench.bench.report.table_formats import Table
from twinbench.bench.statistics.subject import LEADS_S
from twinbench.common.errors import BadInput
from twinbench.common.progress import TELLS_S, Progress
from twinbench.common.store import Store, check_writable, sha256_of, write_csv, write_text
from twinbench.common.threads import pin_torch
from twinbench.common.versions import write_manifest
from twinbench.common.workers import side_by_side
from twinbench.data.batch import Batch
from twinbench.machines.load import machine_at

FEWEST_ORIGINS = 10
"""Forecasts that a recording must have room for. With fewer its score is an accident."""


@dataclass(frozen=True)
class Compared:
    """How estimators compare on a user's recordings.

    Attributes:
        scores: columns ``estimator, seed, sequence, metric, value``.
        failed: estimators that failed, and why.
        seed: with which they were trained.
        recordings: sha256 of every recording's file, by its name.
        sentences: what the table's tests say.
    """

    scores: pd.DataFrame
    failed: dict[str, str]
    table: Table
    sentences: list[str]
    seed: int
    recordings: dict[str, str]


def compare(
    where: Training, names: Sequence[str], paths: Sequence[Path], mapping: Sequence[str], out: Path
) -> Compared:
    """Run the named estimators, or all that are trained, over recordings; every one is read before anything runs.

    Args:
        where: they were trained, and on which machine.
        names: of estimators.
        paths: of the recordings.
        mapping: ``COLUMN[unit]=channel``, as ``read_recording`` takes it.
        out: where the results will go; on a cluster all workers see it.

    Raises:
        BadInput: one line; a recording that cannot be used, or an estimator that is not trained.
    """
    store, found = trained_cells(where, names)
    batches = read(found[0].machine, paths, mapping)
    several = {cell.estimator: (store, cell, tuple(paths), tuple(mapping)) for cell in found}
    ended = {}
    profile = profile_on(where.profile, where.machine)
    minutes = sum(float(batch.time_s[-1] - batch.time_s[0]) for batch in batches) / 60.0
    with Progress(after_s=TELLS_S) as progress, progress.stage("compare", len(found)) as going:
        progress.say(of_comparison(found, profile, where.folder(profile), minutes))
        for outcome in side_by_side(_one, several, progress.say, out):
            ended[outcome[0]] = outcome
            going.step()
    outcomes = [ended[name] for name in several]
    failed = {name: reason for name, reason, _ in outcomes if reason}
    good = [scores for _, reason, scores in outcomes if not reason]
    if not good:
        raise BadInput("no estimator could be run: " + "; ".join(f"{n}: {why}" for n, why in failed.items()))
    scores = pd.concat(good, ignore_index=True)
    digests = {path.name: sha256_of(path) for path in paths}
    return Compared(scores, failed, table(scores, batches[0].machine.name), says(scores), found[0].seed, digests)


def write(out: Path, found: Compared, command: str) -> None:
    """Scores, the table in every format, the sentences, and a manifest that says what made them."""
    check_writable(out)
    write_csv(out / "scores.csv", found.scores)
    write_tables(out, [found.table])
    write_text(out / "answer.md", bullets(*found.sentences))
    write_manifest(out, command, found.seed, recordings_sha256=found.recordings)


def read(machine: str, paths: Sequence[Path], mapping: Sequence[str]) -> list[Batch]:
    """Every recording as a batch of one.

    Args:
        machine: its name, or the path of the file it comes from.
        paths: of the recordings.
        mapping: ``COLUMN[unit]=channel``.

    Raises:
        BadInput: one line; a recording that cannot be used, or two of one name.
    """
    of = machine_at(machine)
    period_s = of.sample_period_s
    least = max(lead_ticks(period_s)) + FEWEST_ORIGINS
    batches = [recording.to_batch(of) for recording in read_all(paths, mapping, of)]
    for batch in batches:
        if batch.measured.shape[1] < least:
            raise BadInput(
                f"recording {batch.names[0]} has {batch.measured.shape[1]} ticks of {period_s:g} s; {least} are needed "
                f"to foretell {LEADS_S[-1]:g} s ahead from {FEWEST_ORIGINS} of them; give a longer one"
            )
    return batches


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
