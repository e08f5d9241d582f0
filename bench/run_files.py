"""The files that a run leaves in its folder beside the store: its own rows, and those that it keeps."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from twinbench.bench import cells, robustness
from twinbench.bench.cells import Cell, Outcome
from twinbench.bench.earlier import Earlier, made_by
from twinbench.bench.latency import estimators as latency
from twinbench.bench.profile import Profile
from twinbench.bench.registry import find
from twinbench.bench.robustness import Trial
from twinbench.bench.roster import is_ablation, ordered
from twinbench.bench.scenes import Take
from twinbench.bench.statistics.scores import metrics_of
from twinbench.bench.statistics.subject import subject_of
from twinbench.common.store import Store, write_csv, write_text
from twinbench.common.versions import code_version, provenance
from twinbench.machines.load import machine_at

SCORES = ["estimator", "seed", "sequence", "metric", "value"]


@dataclass(frozen=True)
class Ran:
    """What a run has done, for the files that it leaves.

    Attributes:
        todo: all its cells.
        learners, runs: of them the ones that were trained and evaluated, for those that share what they made.
        good: those with estimates.
        failed: those without, or without something else, and why.
        tables: scores, one table for each of ``good``.
        takes, trials: what was tried in the scenes and under harder conditions.
        timings: latency of those that were timed.
        walls: seconds by stage.
        unchanged: estimators that an earlier run trained and evaluated as they are.
    """

    profile: Profile
    command: str
    todo: list[Cell]
    learners: list[Cell]
    runs: list[Cell]
    good: list[Cell]
    failed: list[Outcome]
    tables: list[pd.DataFrame]
    takes: list[Take]
    trials: list[Trial]
    timings: pd.DataFrame
    walls: dict[str, float]
    unchanged: set[str]


def write(out: Path, before: Earlier, store: Store, ran: Ran) -> None:
    """All files of a run, the manifest last."""
    stale = {c.estimator for c in ran.todo} - ran.unchanged
    test = cells.load_split(store, ran.todo[0]).test
    nothing = [(name, m, np.nan) for name in test.names for m in metrics_of(subject_of(test.machine))]
    write_scores(out, before, ran.tables, ran.failed, nothing)
    write_failures(out, before, ran.failed, ran.todo)
    write_cost(out, before, store, ran)
    robust = write_robustness(out, before, store, ran.trials, stale)
    write_latency(out, before, ran.timings, stale)
    write_regimes(out, before, ran.todo)
    write_manifest(out, before, ran, robust)


def write_scores(
    out: Path,
    before: Earlier,
    tables: list[pd.DataFrame],
    failed: list[Outcome],
    nothing: list[tuple[str, str, float]],
) -> None:
    """``scores.csv`` in a fixed order; cells that have no estimates as ``nothing``: a NaN for every metric."""
    scored = {(e, seed) for table in tables for e, seed in table[["estimator", "seed"]].to_numpy()[:1].tolist()}
    for outcome in failed:
        if (outcome.cell.estimator, outcome.cell.seed) not in scored:
            frame = pd.DataFrame(nothing, columns=["sequence", "metric", "value"])
            tables.append(frame.assign(estimator=outcome.cell.estimator, seed=outcome.cell.seed))
    own = pd.concat(tables, ignore_index=True)[SCORES]
    both = _added(before.rows("scores.csv", own["estimator"].unique()), own)
    write_csv(out / "scores.csv", both.sort_values(SCORES[:4], kind="stable"))


def write_failures(out: Path, before: Earlier, failed: list[Outcome], todo: Iterable[Cell]) -> None:
    """``failures.csv``: which cells failed, where and why."""
    rows = [(o.cell.estimator, o.cell.seed, o.stage, o.reason) for o in failed]
    own = pd.DataFrame(rows, columns=["estimator", "seed", "stage", "reason"])
    write_csv(out / "failures.csv", _added(before.rows("failures.csv", {c.estimator for c in todo}), own))


def write_cost(out: Path, before: Earlier, store: Store, ran: Ran) -> None:
    """``cost.csv``: the processor time of each training and evaluation, whenever that was."""
    lost = {o.cell for o in ran.failed}
    good = [c for c in ran.runs if c not in lost]
    rows = [(c.estimator, c.seed, "fit", cells.cpu_s(store, "fit", c.fit)) for c in ran.learners]
    rows += [(c.estimator, c.seed, "estimate", cells.cpu_s(store, "estimate", c.estimates)) for c in good]
    own = pd.DataFrame(rows, columns=["estimator", "seed", "stage", "cpu_s"])
    write_csv(out / "cost.csv", _added(before.rows("cost.csv", {c.estimator for c in ran.todo}), own))


def write_latency(out: Path, before: Earlier, timings: pd.DataFrame, stale: set[str]) -> None:
    """``latency.csv``; who was not timed this time keeps the times of before unless ``stale``."""
    latency.write(out, _added(before.rows("latency.csv", {*timings["estimator"], *stale}), timings))


def write_robustness(out: Path, before: Earlier, store: Store, trials: Sequence[Trial], stale: set[str]) -> bool:
    """``robustness.csv``; who was not tried this time keeps the rows of before unless ``stale``. Is there any?"""
    redone = {t.cell.estimator for t in trials}
    tables = [before.rows("robustness.csv", redone | stale), *robustness.finished(store, trials)]
    tables = [table for table in tables if len(table)]
    if not tables:
        (out / "robustness.csv").unlink(missing_ok=True)
        return False
    both = pd.concat(tables, ignore_index=True)
    write_csv(out / "robustness.csv", both.sort_values(robustness.COLUMNS[:6], kind="stable"))
    return True


def write_regimes(out: Path, before: Earlier, todo: Iterable[Cell]) -> None:
    """``tables/regimes.csv`` without the rows of those who ran: the report makes theirs again."""
    kept = before.rows("tables/regimes.csv", {c.estimator for c in todo})
    if len(kept):
        write_csv(out / "tables" / "regimes.csv", kept)
    else:
        (out / "tables" / "regimes.csv").unlink(missing_ok=True)


def write_manifest(out: Path, before: Earlier, ran: Ran, robust: bool) -> None:
    """``manifest.json``, last: what it does not name has not been finished."""
    about, takes, todo = provenance(), ran.takes, ran.todo
    made = _made(before, ran, made_by(about, ran.command))
    whole = ordered(name for name in made if not is_ablation(name))
    kept = [made[name] for name in whole]
    recordings = takes[0].recordings if takes else before.manifest.get("scenes", {}).get("recordings")
    all_takes = [take for m in made.values() for take in m["takes"]]
    manifest = {
        "command": ran.command,
        "profile": asdict(ran.profile),
        "subject": subject_of(machine_at(ran.profile.machine)).to_json(),
        "seeds": list(ran.profile.seeds),
        "estimators": whole,
        "ablations": sorted(name for name in made if is_ablation(name)),
        "specs": _of(made, before.manifest.get("specs", {})) | {c.estimator: c.spec for c in todo},
        "code": _of(made, before.manifest.get("code", {}))
        | {c.estimator: code_version(find(c.spec).__module__) for c in todo},
        "made": made,
        "data_key": todo[0].data,
        "estimates_keys": list(dict.fromkeys(key for m in kept for key in m["estimates"])),
        **about,
        "wall_s": ran.walls,
        "robustness": robust,
        "scenes": {"recordings": recordings, "takes": all_takes} if all_takes else {},
    }
    write_text(out / "manifest.json", json.dumps(manifest, indent=2) + "\n")


def _made(before: Earlier, ran: Ran, now: Mapping[str, Any]) -> dict[str, Any]:
    """By estimator, who made its rows and where its estimates are; ``now`` says it of this run."""
    names = {c.estimator for c in ran.todo}
    made: dict[str, Any] = before.others(names)
    for name in sorted(names):
        # Who was trained and evaluated by an earlier run keeps that run's name.
        by = {key: before.made[name][key] for key in now} if name in ran.unchanged else now
        keys = [c.estimates for c in sorted(ran.good, key=lambda c: c.seed) if c.estimator == name]
        filmed = [[t.scene, t.key] for t in ran.takes if t.cell.estimator == name]
        if not ran.takes and name in ran.unchanged:
            filmed = before.made[name]["takes"]
        made[name] = {**by, "estimates": list(dict.fromkeys(keys)), "takes": filmed}
    return made


def _added(kept: pd.DataFrame, own: pd.DataFrame) -> pd.DataFrame:
    """Both tables; an empty one has no types that could spoil the other's."""
    filled = [table for table in (kept, own) if len(table)]
    return pd.concat(filled, ignore_index=True) if filled else own


def _of(made: dict[str, Any], by_name: dict[str, Any]) -> dict[str, Any]:
    return {name: value for name, value in by_name.items() if name in made}
