"""What the study of delays and slopes shows, as tables."""

from __future__ import annotations

import pandas as pd

from twinbench.bench.benchmarks.multiples import INTERVALS, compared
from twinbench.bench.benchmarks.slopes import CORRECTED, NO_SLOPE
from twinbench.bench.report.table_formats import Cell, Column, Table
from twinbench.bench.roster import PROPOSED, REFERENCE, label
from twinbench.bench.statistics.subject import PAPERS

HEALTH_ERRORS = {"health_life_pct": "mean of five", **{f"{h.name}_life_pct": h.label for h in PAPERS.health}}
"""Metrics of health, and what their columns are called."""
LATER = " s later"
"""What the names of rows with a delay end with."""
OF_THE_FIRST = INTERVALS.format(of="the first row")


def delay_table(scores: pd.DataFrame) -> Table:
    """Health with each delay, and the oracle with and without hindsight.

    Args:
        scores: what ``judge_delays`` returns of all.
    """
    ours = [PROPOSED, *(row for row in scores["row"].unique() if row.endswith(LATER))]
    frame, columns = compared(scores, HEALTH_ERRORS, ours, PROPOSED)
    others = [REFERENCE, *sorted(set(scores["row"]) - {*ours, REFERENCE})]
    beside, more = compared(scores, HEALTH_ERRORS, others, REFERENCE)
    says = [label(PROPOSED), *ours[1:], *map(label, others)]
    coverage = [_lowest(scores, row) for row in [*ours, *others]]
    cells = [[Cell(text) for text in says], *(own + other for own, other in zip(columns, more, strict=True)), coverage]
    heads = (
        Column("estimate"),
        *(Column(says, "health, % of life") for says in HEALTH_ERRORS.values()),
        Column("coverage, %"),
    )
    notes = (
        INTERVALS.format(of="what is known at once"),
        "Coverage: of calibrated 95 % intervals of health, the parameter that has least. Their factors were found "
        "without a delay.",
    )
    title = "Health as it is known later"
    both = pd.concat([frame, beside], ignore_index=True)
    return Table("delays", title, both, heads, tuple(zip(*cells, strict=True)), notes)


def _lowest(scores: pd.DataFrame, row: str) -> Cell:
    """The coverage of the health parameter that has least."""
    wanted = {f"calibrated_coverage_{h.name}_pct": h.label for h in PAPERS.health}
    own = scores[(scores["row"] == row) & scores["metric"].isin(list(wanted))].groupby("metric")["value"].mean()
    return Cell(f"{own.min():.1f}", wanted[str(own.idxmin())])


def forecast_table(scores: pd.DataFrame) -> Table:
    """Forecasts a minute ahead, with health as it is and along its slope.

    Args:
        scores: what ``judge_slopes`` returns.
    """
    names = [row for row in scores["row"].unique() if row != CORRECTED]
    metrics = {m: o.says for m, o in zip(PAPERS.forecast_errors, PAPERS.outputs, strict=True)}
    frame, columns = compared(scores, metrics, names, NO_SLOPE)
    heads = (Column("forecast"), *(Column(says, "60 s ahead, %") for says in metrics.values()))
    cells = [[Cell(name) for name in names], *columns]
    title = "Forecasts of DeepONet-Kalman a minute ahead"
    return Table("slope_forecasts", title, frame, heads, tuple(zip(*cells, strict=True)), (OF_THE_FIRST,))


def slope_table(scores: pd.DataFrame) -> Table:
    """Health as the filter has it, and corrected by what its own slopes say of its error.

    Args:
        scores: what ``judge_slopes`` returns.
    """
    names = (NO_SLOPE, CORRECTED)
    frame, columns = compared(scores, HEALTH_ERRORS, names, NO_SLOPE)
    says = (label(PROPOSED), "corrected by its own slopes")
    heads = (Column("estimate"), *(Column(text, "health, % of life") for text in HEALTH_ERRORS.values()))
    cells = [[Cell(text) for text in says], *columns]
    title = "Health corrected by what its slopes say of its error on other recordings"
    return Table(
        "slope_corrections",
        title,
        frame,
        heads,
        tuple(zip(*cells, strict=True)),
        (OF_THE_FIRST,),
    )
