"""Columns of metrics: how one is described, and the table of every estimator's values in a few of them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import pandas as pd

from twinbench.bench.report.table_formats import Cell, Column, Table, number, span
from twinbench.bench.roster import UNRANKED, label
from twinbench.bench.statistics.censored import CENSORED
from twinbench.bench.statistics.scores import definitions_of
from twinbench.bench.statistics.subject import PAPERS, Subject
from twinbench.bench.statistics.summary import FORECAST, Summary, Value


class Measure(NamedTuple):
    """One metric of scores.csv as a column."""

    metric: str
    head: str
    group: str = ""


INTERVALS = (
    "Beside or below each mean, the 95 % interval over test sequences: bootstrap over whole sequences, seeds averaged "
    "inside each first."
)
TIMES = "× is the multiple of the reference: the oracle, which knows the exact plant. It is no bound."
MARKS = (
    "Marked: the best mean of a column and all that cannot be told from it (Wilcoxon's test over the sequences, Holm's "
    "correction for all pairs, 5 %). No mark: nobody is told from the best."
)
CENSORING = (
    "Delay and recovery: Kaplan-Meier median over the changes of health in all runs, and after how many of them it was "
    "seen at all. One after which it was not counts as one that takes longer than was watched. Seeds that repeat one "
    "another count once."
)
OF_FORECASTS = "Mean of the outputs' errors forecast 60 s ahead, as the table of forecasts has them."


def measured(name: str, title: str, measures: Sequence[Measure], summary: Summary) -> Table:
    """Rows: the estimators. Columns: metrics with interval and multiple of the reference; none that nobody has."""
    known = {metric for _, metric in summary.values}
    measures = [m for m in measures if m.metric in known]
    rows = tuple((Cell(label(e)), *(metric_cell(summary, e, m.metric) for m in measures)) for e in summary.estimators)
    columns = (Column("estimator"), *(Column(m.head, m.group) for m in measures))
    cells = [cell for row in rows for cell in row]
    notes = [INTERVALS, *([TIMES] if any(c.times.startswith("×") for c in cells) else []), MARKS]
    notes += [CENSORING] if any(m.metric in CENSORED for m in measures) else []
    return Table(
        name,
        title,
        full(measures, summary),
        columns,
        rows,
        (*notes, *references(summary)),
        definitions(measures, summary.subject),
    )


def full(measures: Sequence[Measure], summary: Summary) -> pd.DataFrame:
    """The full numbers behind a table of metrics."""
    frame = pd.DataFrame({"estimator": summary.estimators})
    for m in measures:
        for column in Value._fields:
            key = m.metric if column == "mean" else f"{m.metric}_{column}"
            frame[key] = [getattr(summary.value(e, m.metric), column) for e in summary.estimators]
    frame["failed"] = [summary.failures.get(e, "") for e in summary.estimators]
    return frame.dropna(axis=1, how="all")


def references(summary: Summary) -> list[str]:
    """A note on the rows that are shown and not ranked, if there are any."""
    shown = [label(e) for e in summary.estimators if e in UNRANKED]
    return [f"Shown to compare with, not ranked and not marked: {', '.join(shown)}."] if shown else []


def metric_cell(summary: Summary, estimator: str, metric: str) -> Cell:
    """What one estimator's cell of a metric says."""
    value = summary.value(estimator, metric)
    if np.isnan(value.mean):
        return Cell("failed" if estimator in summary.failures else "–")
    return value_cell(value, estimator in summary.marked.get(metric, ()))


def value_cell(value: Value, best: bool = False) -> Cell:
    """A value with its interval and its multiple of the reference, or in how many runs it was seen."""
    text = number(value.mean) if np.isfinite(value.mean) else "not reached"
    known = np.isfinite(value.low)
    interval = span(value.low, value.high) if known else ""
    beside = f"×{number(value.times, 2)}" if np.isfinite(value.times) else ""
    if np.isfinite(value.runs):
        beside = f"{value.happened:.0f} of {value.runs:.0f}"
    return Cell(text, interval, beside, best)


def skill_cell(summary: Summary, estimator: str, metric: str) -> Cell:
    """What an estimator is worth by one error; marked where its interval leaves no doubt that it is worth something."""
    skill = summary.skill(estimator, metric)
    if not np.isfinite(skill.value):
        return Cell("0" if estimator and estimator == _against(summary, metric) else "–")
    interval = span(skill.low, skill.high) if np.isfinite(skill.low) else ""
    return Cell(number(skill.value, 2), interval, best=bool(skill.low > 0.0) and estimator not in UNRANKED)


def _against(summary: Summary, metric: str) -> str:
    return next((s.against for (_, m), s in summary.skills.items() if m == metric), "")


def definitions(measures: Sequence[Measure], subject: Subject = PAPERS) -> tuple[str, ...]:
    """One line per metric; that of the mean coverage stands for all quantities'."""
    known = definitions_of(subject) | {FORECAST: OF_FORECASTS}
    return tuple(
        f"{m.group} {m.head}: {known[m.metric]}".strip()
        for m in measures
        if m.metric in known and "coverage_" not in m.metric
    )
