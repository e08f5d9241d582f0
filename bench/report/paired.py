"""Paired differences, sequence by sequence: to the proposed method, and of a method to itself without a part."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import pandas as pd

from twinbench.bench.report.table_formats import Cell, Column, Table, number, span
from twinbench.bench.report.words import names_of
from twinbench.bench.roster import ABLATION, PROPOSED, UNRANKED, WEIGHS_STEPS, is_ablation, label, ordered
from twinbench.bench.statistics.apart import complete
from twinbench.bench.statistics.bootstrap import differences, sequence_scores
from twinbench.bench.statistics.scores import definitions_of, ideal
from twinbench.bench.statistics.subject import PAPERS, Subject
from twinbench.bench.statistics.summary import LIFE, PARAMETERS

ONE_FILTER = f"{PROPOSED}{ABLATION}no_modes"
"""The ablation that leaves one filter and no weighing."""
CHANGES = (
    (LIFE, "Health against the whole, percentage points of a life", "it errs more", "it errs less"),
    ("coverage95_pct", "Truths within the 95 % intervals as it reports them, percentage points", "more", "fewer"),
)
"""A score of ablations, what is said of it, and the words for more of it and for less."""
INTERVAL = (
    "mean over the test sequences; in brackets its 95 % interval: bootstrap over whole sequences, seeds averaged "
    "inside each first. Of errors more than 0 says that {says}; marked is what differs from 0 for sure."
)


def rivals_table(scores: pd.DataFrame, failures: Mapping[str, str]) -> Table:
    """Rows: all but the proposed method. Columns: how much worse they are.

    Args:
        scores: columns ``estimator, seed, sequence, metric, value``; ablations in it are left out.
        failures: per estimator with failed cells, which and why.
    """
    names = [n for n in ordered(scores["estimator"].unique()) if not is_ablation(n) and n != PROPOSED]
    note = f"Paired difference to {label(PROPOSED)}, " + INTERVAL.format(says=f"{label(PROPOSED)} is the better")
    pairs = {n: (label(n), PROPOSED) for n in names}
    return _table("paired", f"Against {label(PROPOSED)}", "estimator", pairs, scores, failures, note)


def ablation_table(scores: pd.DataFrame, failures: Mapping[str, str], subject: Subject = PAPERS) -> Table:
    """Rows: ablations. Columns: how much worse than the whole method.

    Args:
        scores: as of ``rivals_table``.
        failures: likewise.
        subject: what is estimated.
    """
    names = [n for n in ordered(scores["estimator"].unique()) if is_ablation(n)]
    note = "Paired difference, without the part minus with it, " + INTERVAL.format(says="the part helps")
    pairs = {n: (_says(n), n.partition(ABLATION)[0]) for n in names}
    return _table("ablations", "Ablations: what each part is worth", "without", pairs, scores, failures, note, subject)


def without_steps(scores: pd.DataFrame, failures: Mapping[str, str]) -> list[str]:
    """Is the proposed method's lead in health told without its modes? Nothing where that was not left out.

    Args:
        scores: as of ``rivals_table``, ablations among them.
        failures: likewise.
    """
    table = sequence_scores(scores[scores["metric"] == LIFE], LIFE, failures)
    rivals = [e for e in complete(table) if not is_ablation(e) and e not in (*UNRANKED, *WEIGHS_STEPS)]
    if not {PROPOSED, ONE_FILTER} <= set(complete(table)) or not rivals:
        return []
    mean = {e: float(table.row(e).mean()) for e in (PROPOSED, ONE_FILTER, *rivals)}
    nearest = min(rivals, key=lambda e: mean[e])
    found = differences(table, ONE_FILTER).set_index("estimator").loc[nearest, ["difference", "low", "high"]]
    worth, low, high = map(float, found)
    those = [label(e) for e in ordered(complete(table)) if e in WEIGHS_STEPS and e not in UNRANKED]
    weigh = f"{names_of(those)} alone weigh{'s' if len(those) == 1 else ''}"
    says = "are told apart" if low > 0.0 or high < 0.0 else "are not told apart"
    return [
        f"Of the estimators ranked in this run {weigh} what may have caused a sudden step. With that the health error "
        f"of {label(PROPOSED)} is {number(mean[PROPOSED])} % of a life, and without it {number(mean[ONE_FILTER])} %. "
        f"{label(nearest)}, the best of those that do not, errs {number(mean[nearest])} %. Without that, "
        f"{label(PROPOSED)} differs from it by {number(worth)} percentage points ({span(low, high, to=True)}), so they "
        f"{says}."
    ]


def parts_are_worth(scores: pd.DataFrame, failures: Mapping[str, str]) -> list[str]:
    """Which ablations of the proposed method differ from it in health, and in how often intervals hold the truth.

    Args:
        scores: as of ``rivals_table``, ablations among them.
        failures: likewise.
    """
    said = []
    for metric, what, more, less in CHANGES:
        table = sequence_scores(scores[scores["metric"] == metric], metric, failures)
        if PROPOSED not in table.estimators:
            return []
        rows = differences(table, PROPOSED).set_index("estimator")[["difference", "low", "high"]]
        parts = rows[rows.index.str.startswith(f"{PROPOSED}{ABLATION}")].sort_values("difference", ascending=False)
        told = [_told(parts[parts["low"] > 0.0], more), _told(parts[parts["high"] < 0.0], less)]
        open_ = [_part(n) for n in parts.index[(parts["low"] <= 0.0) & (parts["high"] >= 0.0)]]
        told += [f"no difference is found with {names_of(open_)}"] if open_ else []
        if len(parts):
            said.append(f"{what}, each by its own 95 % interval: {'; '.join(filter(None, told))}.")
    return said


def _told(parts: pd.DataFrame, how: str) -> str:
    each = [f"{_part(n)} {number(worth)} ({span(low, high, to=True)})" for n, worth, low, high in parts.itertuples()]
    return f"{how} with {names_of(each)}" if each else ""


def _part(name: str) -> str:
    return name.partition(ABLATION)[2].replace("_", " ")


def _table(
    name: str,
    title: str,
    head: str,
    pairs: Mapping[str, tuple[str, str]],
    scores: pd.DataFrame,
    failures: Mapping[str, str],
    note: str,
    subject: Subject = PAPERS,
) -> Table:
    """Rows: estimators, by name with how they are printed and whom they are set against."""
    against: dict[tuple[str, str, str], tuple[float, ...]] = {}
    metrics, known = _metrics(subject), definitions_of(subject)
    for metric in metrics:
        table = sequence_scores(scores, metric, failures)
        for whole in {whole for _, whole in pairs.values()} & set(table.estimators):
            found = differences(table, whole)[["estimator", "difference", "low", "high"]].to_numpy().tolist()
            against |= {(one, whole, metric): tuple(values) for one, *values in found}
    lines = []
    for one, (_, whole) in pairs.items():
        line: dict[str, Any] = {"estimator": one}
        for metric in metrics:
            values = against.get((one, whole, metric), (np.nan,) * 3)
            line |= dict(zip((metric, f"{metric}_low", f"{metric}_high"), values, strict=True))
        lines.append(line | {"failed": failures.get(one, "")})
    frame = pd.DataFrame(lines)
    rows = tuple((Cell(pairs[line["estimator"]][0]), *(_cell(line, metric) for metric in metrics)) for line in lines)
    columns = (Column(head), *(Column(metric, group) for metric, group in metrics.values()))
    definitions = tuple(f"{group} {metric}: {known[m]}" for m, (metric, group) in metrics.items())
    return Table(name, title, frame, columns, rows, (note,), definitions)


def _metrics(subject: Subject) -> dict[str, tuple[str, str]]:
    """By metric, its column and group: filtered states, forecasts, health, coverage."""
    return {
        **{m: (o.key, "filtered, %") for m, o in zip(subject.state_errors, subject.outputs, strict=True)},
        **{m: (o.key, "60 s ahead, %") for m, o in zip(subject.forecast_errors, subject.outputs, strict=True)},
        LIFE: ("health", "error, % of life"),
        PARAMETERS: ("parameters", "relative error, %"),
        "coverage95_pct": ("95 % interval", "inside, %"),
    }


def _says(name: str) -> str:
    return f"{label(name.partition(ABLATION)[0])}, {_part(name)}"


def _cell(line: Mapping[str, Any], metric: str) -> Cell:
    value, low, high = line[metric], line[f"{metric}_low"], line[f"{metric}_high"]
    if not np.isfinite(value):
        return Cell("failed" if line["failed"] else "–")
    sure = ideal(metric) is None and bool(low > 0.0 or high < 0.0)
    text = number(value)
    return Cell(f"{'+' if value > 0 and text != '0' else ''}{text}", span(low, high), best=sure)
