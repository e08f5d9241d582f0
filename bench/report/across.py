"""Several finished runs side by side, each on a machine of its own: a row per estimator."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from twinbench.bench.report.measured import skill_cell
from twinbench.bench.report.provenance import profile_of
from twinbench.bench.report.table_formats import Cell, Column, Table, number, to_csv, to_markdown
from twinbench.bench.report.words import names_of
from twinbench.bench.results import Results, load_results
from twinbench.bench.roster import PROPOSED, REFERENCE, UNRANKED, WITHOUT_EQUATIONS, is_ablation, label, ordered
from twinbench.bench.statistics.across import is_ahead, rank_across
from twinbench.bench.statistics.ranks import Ranking
from twinbench.bench.statistics.summary import LIFE, Summary, summarise
from twinbench.common.errors import BadInput
from twinbench.common.page import write_bytes
from twinbench.common.store import check_writable, write_text
from twinbench.common.versions import provenance

PROVENANCE = ("command", "seeds", "data_key", "commit", "uncommitted_changes", "python", "versions", "machine")
"""What is kept of each run's manifest."""
SKILL = (
    "Skill in health: 1 - error / error of the best row that costs nothing on that machine, in % of life; its 95 % "
    "interval is bootstrapped over that machine's recordings. 1 is no error, 0 is no better than that row."
)
RATIOS = "State errors: the median over a machine's outputs of the multiple of the oracle's error."
RANKS = (
    "Mean rank by error of health, 1 is best; the reference rows are left out. Recordings of one name have the same "
    "wear on every machine: their ranks are averaged and count once. A machine with more recordings weighs more."
)
AHEAD = (
    "Machines ahead: on how many of the machines where it was tested Wilcoxon's test with Holm's correction calls it "
    "better than every other estimator without plant equations, in health, and in each filtered state behind an "
    "output. Without plant equations are {names}."
)


@dataclass(frozen=True)
class Run:
    """One finished run: its folder, its files and their statistics on worn machines."""

    folder: Path
    results: Results
    summary: Summary


def read_runs(folders: Sequence[Path]) -> dict[str, Run]:
    """The runs by machine.

    Raises:
        BadInput: fewer than two, a folder without a finished run, or two runs of one machine.
    """
    if len(folders) < 2:
        raise BadInput("machines are compared over two runs or more; name the folder of each")
    runs: dict[str, Run] = {}
    for folder in folders:
        if not (folder / "manifest.json").is_file():
            raise BadInput(f"{folder} holds no run (no manifest.json); make one with: twinbench run --out {folder}")
        results = load_results(folder)
        name = results.subject.machine
        if name in runs:
            raise BadInput(f"{runs[name].folder} and {folder} are both of {name!r}; name one run for each machine")
        whole = ~results.scores["estimator"].map(is_ablation)
        failures = {e: why for e, why in results.failures.items() if not is_ablation(e)}
        summary = summarise(results.scores[whole], failures, subject=results.subject)
        runs[name] = Run(folder, results, summary)
    return runs


def write_across(folders: Sequence[Path], out: Path, command: str = "") -> Table:
    """Write ``machines.md``, ``machines.csv`` and ``manifest.json`` of several runs into ``out``.

    Raises:
        BadInput: as ``read_runs``, or ``out`` cannot be written to.
    """
    runs = read_runs(folders)
    check_writable(out)
    table = across_table(runs)
    write_bytes(out / "machines.md", to_markdown(table).encode())
    write_bytes(out / "machines.csv", to_csv(table).encode())
    made = {name: _made(run) for name, run in runs.items()}
    write_text(out / "manifest.json", json.dumps({"command": command, "runs": made, **provenance()}, indent=2) + "\n")
    return table


def across_table(runs: Mapping[str, Run]) -> Table:
    """Rows: the estimators. Columns: skill and state errors on each machine, mean rank, machines where it is ahead.

    Args:
        runs: by machine.
    """
    summaries = {name: run.summary for name, run in runs.items()}
    names = ordered({e for s in summaries.values() for e in s.estimators})
    ranking, unranked = _ranking(summaries)
    ranks = dict(zip(ranking.estimators, map(float, ranking.mean_ranks), strict=True)) if ranking else {}
    frame = pd.DataFrame({"estimator": names})
    parts: list[tuple[Column, list[Cell]]] = []
    for machine, s in summaries.items():
        for column in ("value", "low", "high", "against"):
            key = f"skill_{machine}" if column == "value" else f"skill_{machine}_{column}"
            frame[key] = [getattr(s.skill(e, LIFE), column) for e in names]
        parts.append((Column(machine, "skill in health"), [_skill(s, e) for e in names]))
    for machine, s in summaries.items():
        times = [_times(s, e) for e in names]
        frame[f"state_times_{machine}"] = times
        parts.append((Column(machine, f"state errors, × {REFERENCE}'s"), [Cell(number(t)) for t in times]))
    frame["mean_rank"] = [ranks.get(e, np.nan) for e in names]
    parts.append((Column("over all", "mean rank"), [Cell(number(ranks.get(e, np.nan))) for e in names]))
    for key, head in (("machines", "health"), ("machines_states", "states")):
        ahead = [[is_ahead(s, e, _asked(s, head)) for s in summaries.values()] for e in names]
        frame[f"{key}_ahead"] = [sum(a is True for a in own) for own in ahead]
        frame[f"{key}_tested"] = [sum(a is not None for a in own) for own in ahead]
        parts.append((Column(head, "machines ahead"), [_of(own) for own in ahead]))
    rows = zip([Cell(label(e)) for e in names], *(cells for _, cells in parts), strict=True)
    shown = names_of(label(e) for e in WITHOUT_EQUATIONS)
    notes = (
        SKILL,
        RATIOS,
        RANKS,
        *_said(ranking, unranked),
        AHEAD.format(names=shown),
        *_behind(summaries),
        *map(_about, runs.values()),
    )
    columns = (Column("estimator"), *(column for column, _ in parts))
    return Table("machines", f"Estimators on {names_of(runs)}", frame, columns, tuple(rows), notes)


def _ranking(summaries: Mapping[str, Summary]) -> tuple[Ranking | None, str]:
    try:
        return rank_across(summaries), ""
    except ValueError as error:
        return None, str(error)


def _said(ranking: Ranking | None, unranked: str) -> list[str]:
    """What the tests of the ranks say."""
    if ranking is None:
        return [f"Not ranked: {unranked}."]
    said = [
        f"Friedman's test over {len(ranking.sequences)} names of recordings: p = {ranking.friedman_p:.2g}; Nemenyi's "
        f"critical difference of mean ranks: {ranking.critical_difference:.2f}."
        if math.isfinite(ranking.friedman_p)
        else f"{len(ranking.estimators)} estimators are too few for Friedman's test."
    ]
    said += [f"Not told apart by mean rank: {names_of(map(label, clique))}." for clique in ranking.cliques]
    return said + [f"{label(name)} is not ranked: {why}." for name, why in ranking.dropped.items()]


def _skill(summary: Summary, estimator: str) -> Cell:
    if estimator in summary.failures:
        return Cell("failed")
    return skill_cell(summary, estimator, LIFE)


def _times(summary: Summary, estimator: str) -> float:
    """Median over the outputs of the multiple of the reference's error; NaN where one is missing."""
    return float(np.median([summary.value(estimator, m).times for m in summary.subject.state_errors]))


def _asked(summary: Summary, head: str) -> tuple[str, ...]:
    """The errors in which an estimator is to be ahead."""
    return (LIFE,) if head == "health" else summary.subject.state_errors


def _of(ahead: Sequence[bool | None]) -> Cell:
    tested = [a for a in ahead if a is not None]
    return Cell(f"{sum(tested)} of {len(tested)}") if tested else Cell("–")


def _behind(summaries: Mapping[str, Summary]) -> Iterator[str]:
    """Whom the proposed method is not ahead of in a filtered state, and whether a filter that knows the plant is."""
    for machine, s in summaries.items():
        for metric, output in zip(s.subject.state_errors, s.subject.outputs, strict=True):
            rivals = [e for e in s.estimators if e in WITHOUT_EQUATIONS and math.isfinite(s.value(e, metric).mean)]
            level = [e for e in rivals if e != PROPOSED and not s.better(PROPOSED, e, metric)]
            if level and PROPOSED in rivals:
                too = [e for e in level if not s.better(REFERENCE, e, metric)]
                nor = (
                    f"not ahead of {names_of(map(label, too))} either"
                    if too
                    else f"ahead of {'it' if len(level) == 1 else 'them'}"
                )
                yield (
                    f"{machine}, filtered {output.says}: {label(PROPOSED)} is not shown to be ahead of "
                    f"{names_of(map(label, level))}. The reference, which knows the plant, is {nor}."
                )


def _about(run: Run) -> str:
    """Which run a machine's columns are of."""
    results = run.results
    recordings = len(run.summary.by_sequence[LIFE].sequences) if LIFE in run.summary.by_sequence else 0
    seeds = ", ".join(map(str, results.manifest.get("seeds", ())))
    return (
        f"{results.subject.machine}: {run.folder}, profile {profile_of(results)}, seeds {seeds}, {recordings} test "
        f"recordings, commit {results.manifest.get('commit') or 'unknown'}."
    )


def _made(run: Run) -> dict[str, Any]:
    manifest = run.results.manifest
    kept = {key: manifest[key] for key in PROVENANCE if key in manifest}
    ranked = [e for e in run.summary.estimators if e not in UNRANKED]
    return {"folder": str(run.folder), "profile": profile_of(run.results), "estimators": ranked, **kept}
