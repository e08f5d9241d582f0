"""Tables of health: per parameter, while it moves and rests, what that is worth, and intervals once calibrated."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pandas as pd

from twinbench.bench.report.measured import INTERVALS, Measure, measured, references, skill_cell
from twinbench.bench.report.table_formats import Cell, Column, Table
from twinbench.bench.roster import QUANTITIES, label
from twinbench.bench.statistics.scores import STATE_ERRORS
from twinbench.bench.statistics.summary import FORECAST, LIFE, PARAMETERS, Summary
from twinbench.machines.compressor import ESTIMATED, HEALTH

KNOWN_OF = (
    Measure(LIFE, "mean of five", "error, % of life"),
    *(Measure(f"{h}_life_pct", QUANTITIES[h][0], "error, % of life") for h in HEALTH),
    Measure("health_moving_pct", "moving", "parameters, % of life"),
    Measure("health_still_pct", "still", "parameters, % of life"),
    Measure("health_after_sudden_pct", "with", "sudden steps, % of life"),
    Measure("health_without_sudden_pct", "without", "sudden steps, % of life"),
    Measure("health_commissioning_pct", "minutes 0 to 5", "commissioning, % of life"),
)
WORTH = {
    LIFE: Column("mean of five", "health"),
    **{f"{h}_life_pct": Column(QUANTITIES[h][0], "health") for h in HEALTH},
    **dict(zip(STATE_ERRORS, (Column(name, "filtered") for name in ("p", "T", "flow")), strict=True)),
    FORECAST: Column("p, T, flow", "60 s ahead"),
}
CALIBRATED = (
    *(Measure(f"calibrated_coverage_{q}_pct", QUANTITIES[q][0], "inside, %") for q in ESTIMATED),
    Measure("calibrated_coverage95_pct", "mean of ten", "inside, %"),
)
SINGLE = (
    Measure(PARAMETERS, "four parameters", "relative error, %"),
    Measure(LIFE, "health", "error, % of life"),
    Measure("p_nrmse_pct", "p", "filtered, %"),
    Measure("T_nrmse_pct", "T", "filtered, %"),
    Measure("m_nrmse_pct", "flow", "filtered, %"),
    Measure(FORECAST, "p, T, flow", "60 s ahead, %"),
    Measure("coverage95_pct", "inside, %", "95 % interval"),
)
SKILL = (
    "1 - error / error of the best row that costs nothing ({against}), recording by recording; in brackets its 95 % "
    "interval. 0 is no better than that row. Marked: the interval lies above 0."
)
FACTORS = (
    "Each quantity's interval is made wider or narrower by one factor, chosen on the calibration recordings (split "
    "conformal prediction, the recording as the unit)."
)
NOTHING = "This run has no such scores."


def health_tables(summary: Summary) -> list[Table]:
    """Errors of health, skill, and calibrated coverage."""
    calibrated = measured("calibrated", "Coverage of the 95 % intervals after calibration", CALIBRATED, summary)
    return [
        _or_nothing(measured("health", "Health", KNOWN_OF, summary)),
        _or_nothing(skill_table(summary)),
        _or_nothing(replace(calibrated, notes=(FACTORS, *calibrated.notes))),
    ]


def _or_nothing(table: Table) -> Table:
    """A table without a column beside the estimators says so instead."""
    return table if len(table.columns) > 1 else replace(table, rows=(), notes=(NOTHING,), definitions=())


def skill_table(summary: Summary) -> Table:
    """What every estimator is worth by each error."""
    metrics = [m for m in WORTH if any(metric == m for _, metric in summary.skills)]
    frame = pd.DataFrame({"estimator": summary.estimators})
    for metric in metrics:
        for column in ("value", "low", "high"):
            frame[f"{metric}_{column}"] = [getattr(summary.skill(e, metric), column) for e in summary.estimators]
    rows = tuple((Cell(label(e)), *(skill_cell(summary, e, m) for m in metrics)) for e in summary.estimators)
    rivals: dict[str, list[str]] = {}
    for metric in metrics:
        against = next(skill.against for (_, m), skill in summary.skills.items() if m == metric)
        rivals.setdefault(label(against), []).append(f"{WORTH[metric].group} {WORTH[metric].head}")
    of = "; ".join(f"{name} for {', '.join(heads)}" for name, heads in rivals.items())
    columns = (Column("estimator"), *(WORTH[m] for m in metrics))
    frame = frame.replace([np.inf, -np.inf], np.nan)
    notes = (SKILL.format(against=of), INTERVALS, *references(summary))
    return Table("skill", "Skill: what an estimator is worth", frame, columns, rows, notes)


def single_table(single: Summary | None) -> Table:
    """The comparison on the paper's own kind of recordings; None where a run has none."""
    title = "On the paper's kind of recordings: a healthy start, one change"
    if single is None:
        return Table("single", title, pd.DataFrame(), (Column("estimator"),), (), (NOTHING,))
    return measured("single", title, SINGLE, single)
