"""The main table: health, states, forecast, honesty and cost of every estimator, side by side."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import pandas as pd

from twinbench.bench.report.measured import (
    INTERVALS,
    MARKS,
    TIMES,
    Measure,
    definitions,
    full,
    metric_cell,
    references,
    skill_cell,
)
from twinbench.bench.report.table_formats import Cell, Column, Table, number
from twinbench.bench.report.words import names_of
from twinbench.bench.roster import PROPOSED, WEIGHS_STEPS, label
from twinbench.bench.statistics.summary import FORECAST, LIFE, Summary

COMPARED = (
    Measure(LIFE, "health", "error, % of life"),
    Measure("p_nrmse_pct", "p", "filtered, %"),
    Measure("T_nrmse_pct", "T", "filtered, %"),
    Measure("m_nrmse_pct", "flow", "filtered, %"),
    Measure(FORECAST, "p, T, flow", "60 s ahead, %"),
)
"""As many as fit a page beside skill, coverage and cost; what else there is stands in the tables below it."""
SKILL = (
    "Skill: 1 - error of health / error of the best row that costs nothing, recording by recording; 0 is no better "
    "than knowing nothing of this machine."
)
COVERAGE = (
    "Coverage: of the 95 % interval of the quantity that is covered least, and most, of the ten{after}; 95 is right."
)
CALIBRATED = ", with each interval made wider or narrower by a factor from the calibration recordings"
COST = (
    "Training: processor time of one seed. Update: median of one update of one machine, by the quickest form of the "
    "filter that was timed; the form is the implementation's, not the method's."
)
STEPS = "What may have caused a sudden step of the readings is weighed by {names}, and by no other estimator."
OWN_FORM = (
    "All compiled: a filter of the same kind with ten states. {names} of this table carry more; in their own quickest "
    "form an update takes {times} µs."
)
CALLED = (
    "Of {names} a form with nothing left in Python was timed. All others are called from Python at every tick, as "
    "{proposed} can be: then an update of it takes {time} µs."
)
FORM_OF = {"numba_ekf": "nominal_ekf", "numba_ukf": "nominal_ukf"}
"""Filters that latency times beside the estimators, and whose quickest form they are: the same model and filter, with
nothing left in Python."""
COMMON_FORM, WITHOUT_PYTHON = "compiled", ("in place", "all compiled")
"""What the form is called that every estimator has, and those that do without Python."""


def comparison(summary: Summary, profile: str, latency: pd.DataFrame, cost: pd.DataFrame) -> Table:
    """Rows: the estimators. Arguments as of ``tables.build_tables``."""
    names, known = summary.estimators, {metric for _, metric in summary.values}
    measures = [m for m in COMPARED if m.metric in known]
    parts = [(Column(m.head, m.group), [metric_cell(summary, e, m.metric) for e in names]) for m in measures]
    if any(metric == LIFE for _, metric in summary.skills):
        parts.insert(1, (Column("skill", "health"), [skill_cell(summary, e, LIFE) for e in names]))
    prefix = "calibrated_coverage" if _has(summary, "calibrated_coverage") else "coverage"
    frame = full(measures, summary)
    for i, name in enumerate(("lowest", "highest")):
        found = [extremes(summary, e, prefix) for e in names]
        cells = [Cell(number(f[i][0]), f[i][1]) if f else Cell("–") for f in found]
        parts.append((Column(name, "coverage, %"), cells))
        frame[f"{prefix}_{name}_pct"] = [f[i][0] if f else np.nan for f in found]
        frame[f"{prefix}_{name}"] = [f[i][1] if f else "" for f in found]
    frame["training_min"], frame["update_us"], frame["form"] = _costs(summary, latency, cost)
    parts.append((Column("min", "training"), [Cell(number(v)) for v in frame["training_min"]]))
    forms = zip(frame["update_us"], frame["form"], strict=True)
    parts.append((Column("µs", "update"), [Cell(number(v), form) for v, form in forms]))
    for column in ("value", "low", "high"):
        frame[f"skill_{column}"] = [getattr(summary.skill(e, LIFE), column) for e in names]
    rows = zip([Cell(label(e)) for e in names], *(cells for _, cells in parts), strict=True)
    after = CALIBRATED if prefix.startswith("calibrated") else ""
    steps = [label(e) for e in names if e in WEIGHS_STEPS]
    weighed = [STEPS.format(names=names_of(steps))] if steps else []
    costs = (COST, *_own_forms(names, latency), *_called(names, latency), *weighed)
    notes = (*summary.notes, INTERVALS, TIMES, MARKS, SKILL, COVERAGE.format(after=after), *costs, *references(summary))
    columns = (Column("estimator"), *(column for column, _ in parts))
    title = f"Profile {profile}: comparison on the test recordings"
    return Table("comparison", title, frame, columns, tuple(rows), notes, definitions(measures))


def _costs(summary: Summary, latency: pd.DataFrame, cost: pd.DataFrame) -> tuple[list[float], list[float], list[str]]:
    """Minutes of training, microseconds of an update, and its quickest form, of each estimator."""
    fits = cost[cost["stage"] == "fit"].groupby("estimator")["cpu_s"].mean() / 60.0
    update, form = quickest(latency, "p50_us"), quickest_form(latency)
    names = summary.estimators
    return (
        [float(fits.get(e, np.nan)) for e in names],
        [update.get(e, np.nan) for e in names],
        [form.get(e, "") for e in names],
    )


def _own_forms(names: Sequence[str], latency: pd.DataFrame) -> list[str]:
    """What filters take that stand in the table with the time of another of their kind."""
    shown = [e for form, e in FORM_OF.items() if e in names and form in set(latency["estimator"])]
    times = latency[latency["estimator"].isin(shown)].groupby("estimator")["p50_us"].min()
    own = [e for e in shown if e in times.index]
    if not own:
        return []
    numbers = names_of(number(float(times[e])) for e in own)
    return [OWN_FORM.format(names=names_of(map(label, own)), times=numbers)]


def _called(names: Sequence[str], latency: pd.DataFrame) -> list[str]:
    """What an update of the proposed method takes in the form that all estimators have."""
    form = quickest_form(latency)
    without_python = [e for e in names if form.get(e) in WITHOUT_PYTHON]
    common = latency[(latency["estimator"] == PROPOSED) & (latency["implementation"] == COMMON_FORM)]["p50_us"]
    if PROPOSED not in without_python or common.empty:
        return []
    time = number(float(common.min()))
    return [CALLED.format(names=names_of(map(label, without_python)), proposed=label(PROPOSED), time=time)]


def _has(summary: Summary, prefix: str) -> bool:
    return any(extremes(summary, e, prefix) for e in summary.estimators)


def extremes(
    summary: Summary, estimator: str, prefix: str = "coverage"
) -> tuple[tuple[float, str], tuple[float, str]] | None:
    """Lowest and highest coverage over all quantities, in %, each with whose it is; None without any.

    Args:
        prefix: of the metrics: ``coverage``, or ``calibrated_coverage``.
    """
    means = {q.label: summary.value(estimator, f"{prefix}_{q.name}_pct").mean for q in summary.subject.quantities}
    known = [(value, name) for name, value in means.items() if math.isfinite(value)]
    return (min(known), max(known)) if known else None


def _by_time(latency: pd.DataFrame) -> pd.DataFrame:
    own = latency.assign(estimator=latency["estimator"].replace(FORM_OF))
    return own.sort_values("p50_us", kind="stable").drop_duplicates("estimator")


def quickest(latency: pd.DataFrame, column: str) -> dict[str, float]:
    """A column's value per estimator: of the form with the least median time where it has several."""
    rows = _by_time(latency)
    return {str(name): float(value) for name, value in zip(rows["estimator"], rows[column], strict=True)}


def quickest_form(latency: pd.DataFrame) -> dict[str, str]:
    """What that form is called."""
    rows = _by_time(latency)
    return {str(name): str(form) for name, form in zip(rows["estimator"], rows["implementation"], strict=True)}
