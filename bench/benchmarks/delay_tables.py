"""What the study of delays and slopes shows, as tables."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import pandas as pd

from twinbench.bench.benchmarks.slopes import CORRECTED, NO_SLOPE
from twinbench.bench.report.table_formats import Cell, Column, Table, number, span
from twinbench.bench.roster import PROPOSED, REFERENCE, label
from twinbench.bench.statistics.bootstrap import SequenceScores, means, ratios
from twinbench.bench.statistics.subject import PAPERS

HEALTH_ERRORS = {"health_life_pct": "mean of five", **{f"{h.name}_life_pct": h.label for h in PAPERS.health}}
"""Metrics of health, and what their columns are called."""
LATER = " s later"
"""What the names of rows with a delay end with."""
INTERVALS = "In brackets: the 95 % interval over recordings. ×: the paired multiple of {of}, with its interval."
OF_THE_FIRST = INTERVALS.format(of="the first row")


def _of(scores: pd.DataFrame, metric: str, names: Sequence[str]) -> SequenceScores:
    wide = scores[scores["metric"] == metric].pivot(index="row", columns="sequence", values="value").loc[list(names)]
    return SequenceScores(metric, tuple(names), tuple(wide.columns), wide.to_numpy(), {}, ())


def _compared(
    scores: pd.DataFrame, metrics: Mapping[str, str], names: Sequence[str], first: str
) -> tuple[pd.DataFrame, list[list[Cell]]]:
    """By name, the mean of each metric, and its multiple of that of the ``first`` row: all numbers, and cells."""
    frames, columns = [], []
    for metric in metrics:
        table = _of(scores, metric, names)
        mean, times = means(table).set_index("estimator"), ratios(table, first).set_index("estimator")
        times = times[["ratio", "low", "high"]].add_prefix("times_")
        frame = mean[["mean", "low", "high"]].join(times)
        frames.append(frame.assign(metric=metric).reset_index(names="row"))
        columns.append([_cell(*row) for row in frame.to_numpy().tolist()])
    return pd.concat(frames, ignore_index=True), columns


def _cell(mean: float, low: float, high: float, times: float, times_low: float, times_high: float) -> Cell:
    more = f"×{times:.2f} [{times_low:.2f}–{times_high:.2f}]" if math.isfinite(times) else ""
    return Cell(number(mean), span(low, high), more)


def delay_table(scores: pd.DataFrame) -> Table:
    """Health with each delay, and the oracle with and without hindsight.

    Args:
        scores: what ``judge_delays`` returns of all.
    """
    ours = [PROPOSED, *(row for row in scores["row"].unique() if row.endswith(LATER))]
    frame, columns = _compared(scores, HEALTH_ERRORS, ours, PROPOSED)
    others = [REFERENCE, *sorted(set(scores["row"]) - {*ours, REFERENCE})]
    beside, more = _compared(scores, HEALTH_ERRORS, others, REFERENCE)
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
    frame, columns = _compared(scores, metrics, names, NO_SLOPE)
    heads = (Column("forecast"), *(Column(says, "60 s ahead, %") for says in metrics.values()))
    cells = [[Cell(name) for name in names], *columns]
    title = "Forecasts of DeepONet-Kalman a minute ahead"
    return Table(
        "slope_forecasts", title, frame, heads, tuple(zip(*cells, strict=True)), (INTERVALS.format(of="the first row"),)
    )


def slope_table(scores: pd.DataFrame) -> Table:
    """Health as the filter has it, and corrected by what its own slopes say of its error.

    Args:
        scores: what ``judge_slopes`` returns.
    """
    names = (NO_SLOPE, CORRECTED)
    frame, columns = _compared(scores, HEALTH_ERRORS, names, NO_SLOPE)
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
        (INTERVALS.format(of="the first row"),),
    )
