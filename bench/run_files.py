"""The files that a run leaves in its folder beside the store: its own rows, and those that it keeps."""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from dataclasses import asdict
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
from twinbench.bench.statistics.scores import DEFINITIONS
from twinbench.common.store import Store, write_atomically, write_text
from twinbench.common.versions import code_version, provenance

SCORES = ["estimator", "seed", "sequence", "metric", "value"]


def write_scores(
    out: Path, before: Earlier, tables: list[pd.DataFrame], failed: list[Outcome], names: tuple[str, ...]
) -> None:
    """``scores.csv`` in a fixed order; cells that have no estimates as NaN."""
    scored = {(e, seed) for table in tables for e, seed in table[["estimator", "seed"]].to_numpy()[:1].tolist()}
    nothing = [(s, m, np.nan) for s in names for m in DEFINITIONS]
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


def write_cost(
    out: Path, before: Earlier, store: Store, learners: list[Cell], good: list[Cell], todo: Iterable[Cell]
) -> None:
    """``cost.csv``: the processor time of each training and evaluation, whenever that was."""
    rows = [(c.estimator, c.seed, "fit", cells.cpu_s(store, "fit", c.fit)) for c in learners]
    rows += [(c.estimator, c.seed, "estimate", cells.cpu_s(store, "estimate", c.estimates)) for c in good]
    own = pd.DataFrame(rows, columns=["estimator", "seed", "stage", "cpu_s"])
    write_csv(out / "cost.csv", _added(before.rows("cost.csv", {c.estimator for c in todo}), own))


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


def write_manifest(
    out: Path,
    before: Earlier,
    profile: Profile,
    todo: list[Cell],
    unchanged: set[str],
    good: list[Cell],
    takes: list[Take],
    robust: bool,
    command: str,
    walls: dict[str, float],
) -> None:
    """``manifest.json``, last: what it does not name has not been finished."""
    about = provenance()
    names = {c.estimator for c in todo}
    now = made_by(about, command)
    made: dict[str, Any] = before.others(names)
    for name in sorted(names):
        # Who was trained and evaluated by an earlier run keeps that run's name.
        by = {key: before.made[name][key] for key in now} if name in unchanged else now
        keys = [c.estimates for c in sorted(good, key=lambda c: c.seed) if c.estimator == name]
        filmed = [[t.scene, t.key] for t in takes if t.cell.estimator == name]
        if not takes and name in unchanged:
            filmed = before.made[name]["takes"]
        made[name] = {**by, "estimates": list(dict.fromkeys(keys)), "takes": filmed}
    whole = ordered(name for name in made if not is_ablation(name))
    kept = [made[name] for name in whole]
    recordings = takes[0].recordings if takes else before.manifest.get("scenes", {}).get("recordings")
    all_takes = [take for m in made.values() for take in m["takes"]]
    manifest = {
        "command": command,
        "profile": asdict(profile),
        "seeds": list(profile.seeds),
        "estimators": whole,
        "ablations": sorted(name for name in made if is_ablation(name)),
        "specs": _of(made, before.manifest.get("specs", {})) | {c.estimator: c.spec for c in todo},
        "code": _of(made, before.manifest.get("code", {}))
        | {c.estimator: code_version(find(c.spec).__module__) for c in todo},
        "made": made,
        "data_key": todo[0].data,
        "estimates_keys": list(dict.fromkeys(key for m in kept for key in m["estimates"])),
        **about,
        "wall_s": walls,
        "robustness": robust,
        "scenes": {"recordings": recordings, "takes": all_takes} if all_takes else {},
    }
    write_text(out / "manifest.json", json.dumps(manifest, indent=2) + "\n")


def write_csv(path: Path, table: pd.DataFrame) -> None:
    """Write a table atomically."""
    write_atomically(path, lambda beside: table.to_csv(beside, index=False))


def _added(kept: pd.DataFrame, own: pd.DataFrame) -> pd.DataFrame:
    """Both tables; an empty one has no types that could spoil the other's."""
    filled = [table for table in (kept, own) if len(table)]
    return pd.concat(filled, ignore_index=True) if filled else own


def _of(made: dict[str, Any], by_name: dict[str, Any]) -> dict[str, Any]:
    return {name: value for name, value in by_name.items() if name in made}
