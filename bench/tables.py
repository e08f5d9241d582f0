"""The benchmark's tables: comparison, parameters, coverage, regimes, latency."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import pandas as pd

from bench.coverage import REGIMES
from bench.roster import FLOOR, QUANTITIES, is_ablation, label, ordered
from bench.scores import DEFINITIONS, IDEAL
from bench.summary import FORECAST, PARAMETERS, Summary, Value
from bench.table_formats import Cell, Column, Table, number
from data.batch import ESTIMATED, HEALTH


class Measure(NamedTuple):
    """One metric of scores.csv as a column."""

    metric: str
    head: str
    group: str = ""


COMPARED = (
    Measure("p_nrmse_pct", "p", "filtered, %"),
    Measure("T_nrmse_pct", "T", "filtered, %"),
    Measure("m_nrmse_pct", "m", "filtered, %"),
    Measure("p_open60_pct", "p", "60 s ahead, %"),
    Measure("T_open60_pct", "T", "60 s ahead, %"),
    Measure("m_open60_pct", "m", "60 s ahead, %"),
    Measure("parameter_error_pct", "mean", "parameters, %"),
    Measure("parameter_median_pct", "median", "parameters, %"),
    Measure("parameter_p90_pct", "p90", "parameters, %"),
    Measure("coverage95_pct", "inside, %", "95 % interval"),
    Measure("nis_ratio", "ratio", "NIS"),
)
TRACKED = (
    *(Measure(f"{h}_error_pct", QUANTITIES[h][0], "error, %") for h in HEALTH[:4]),
    Measure("T_bias_error_K", "T bias", "error, K"),
    *(Measure(f"{h}_range_pct", QUANTITIES[h][0], "% of range") for h in HEALTH[:4]),
    Measure("T_bias_K_range_pct", "T bias", "% of range"),
    Measure("parameter_range_pct", "mean of five", "% of range"),
    Measure("parameter_terminal_pct", "last 60 s", "error, %"),
    Measure("delay_s", "delay", "s"),
    Measure("recovery_s", "recovery", "s"),
)
COVERED = (
    *(Measure(f"coverage_{q}_pct", QUANTITIES[q][0], "inside, %") for q in ESTIMATED),
    Measure("coverage95_pct", "mean of ten", "inside, %"),
    Measure("nis_median_ratio", "NIS", "median"),
    Measure("nis_inside_pct", "NIS", "inside, %"),
    Measure("nis_ratio", "NIS", "ratio"),
    Measure("nees_ratio", "NEES", "ratio"),
)
INTERVALS = (
    "Beside or below each mean, the 95 % interval over test sequences: bootstrap over whole sequences, seeds averaged "
    "inside each first. × is the multiple of the floor: the oracle, which knows the exact plant. The best of each "
    "column, the oracle apart, is marked."
)
RANK = (
    "Rank: mean over the sequences, 1 is best, the oracle left out; by parameter error, and by the mean of the three "
    "60 s errors."
)
LATENCY = "Latency: median time of one update of one machine, in the estimator's fastest implementation."
MEMORY = "Memory: all that it has learnt, and what it says of one machine and carries from update to update."


def build_tables(
    summary: Summary, regimes: pd.DataFrame, latency: pd.DataFrame, cost: pd.DataFrame
) -> list[Table]:
    """All tables of a run.

    Args:
        regimes: what ``bench.coverage.coverage_table`` returns.
        latency: columns estimator, mode, implementation, window, p50_us, p95_us, p99_us, max_us, memory_kB.
        cost: columns estimator, seed, stage, cpu_s.
    """
    return [
        comparison(summary, latency),
        _measured("parameters", "Health parameters", TRACKED, summary),
        _measured("coverage", "Coverage of the 95 % intervals, and consistency", COVERED, summary),
        regime_table(regimes),
        latency_table(latency),
        cost_table(cost),
    ]


def comparison(summary: Summary, latency: pd.DataFrame) -> Table:
    """The main table: state, forecast and parameter errors, honesty, rank and speed of every estimator."""
    table = _measured("comparison", "Comparison on the test sequences", COMPARED, summary)
    ranks = {q: dict(zip(r.estimators, map(float, r.mean_ranks), strict=True)) for q, r in summary.rankings.items()}
    table = _with_column(table, summary, "mean_rank_parameters", Column("param.", "rank"), ranks.get(PARAMETERS, {}))
    table = _with_column(table, summary, "mean_rank_forecast", Column("60 s", "rank"), ranks.get(FORECAST, {}))
    table = _with_column(table, summary, "latency_p50_us", Column("p50, µs", "latency"), least(latency, "p50_us"))
    table = _with_column(table, summary, "memory_kB", Column("kB", "memory"), least(latency, "memory_kB"))
    return replace(table, notes=(*summary.notes, *table.notes),
                   definitions=(*table.definitions, RANK, LATENCY, MEMORY))  # fmt: skip


def _with_column(table: Table, summary: Summary, key: str, column: Column, values: Mapping[str, float]) -> Table:
    """The table with one more column, of which less is better."""
    numbers = [values.get(e, np.nan) for e in summary.estimators]
    best = min((values[e] for e in values if e != FLOOR), default=np.nan)
    cells = [
        Cell(number(value), best=value == best and e != FLOOR)
        for e, value in zip(summary.estimators, numbers, strict=True)
    ]
    return replace(
        table,
        frame=table.frame.assign(**{key: numbers}),
        columns=(*table.columns, column),
        rows=tuple((*row, cell) for row, cell in zip(table.rows, cells, strict=True)),
    )


def least(latency: pd.DataFrame, column: str) -> dict[str, float]:
    """A column's value per estimator: of its best implementation where it has several."""
    return {str(k): float(v) for k, v in latency.groupby("estimator")[column].min().items()}


def regime_table(regimes: pd.DataFrame) -> Table:
    """Coverage of the ten quantities' mean in each operating regime."""
    title = "Coverage of the 95 % intervals by regime, % (mean of the ten quantities; 95 is right)"
    if not len(regimes):
        return Table("regimes", title, regimes, (Column("estimator"),), (), ("No estimates in the store.",))
    mean = regimes[regimes["quantity"] == "mean"]
    values = {
        (name, regime): Value(*numbers)
        for name, regime, *numbers in mean[["estimator", "regime", "coverage_pct", "low", "high"]].to_numpy()
    }
    shown = [regime for regime in REGIMES if regime in set(mean["regime"])]
    rows = [
        (Cell(label(name)), *(_cell(values.get((name, regime), Value())) for regime in shown))
        for name in ordered(mean["estimator"].unique())
    ]
    columns = (Column("estimator"), *(_regime_column(regime) for regime in shown))
    notes = [f"{regime.replace('_', ', ')}: {REGIMES[regime]}." for regime in shown]
    return Table("regimes", title, regimes.reset_index(drop=True), columns, tuple(rows), tuple(notes))


def latency_table(latency: pd.DataFrame) -> Table:
    """Percentiles of the time of one update."""
    names = ordered(latency["estimator"].unique())
    place = {name: i for i, name in enumerate(names)}
    frame = latency.assign(place=latency["estimator"].map(place))
    frame = frame.sort_values(["place", "mode", "implementation", "window"]).drop(columns="place")
    times = [c for c in frame.columns if c.endswith("_us")]
    about = [c for c in ("mode", "implementation", "window") if c in frame.columns]
    columns = (
        Column("estimator"), *(Column(c) for c in about),
        *(Column(c.removesuffix("_us"), "µs") for c in times),
    )  # fmt: skip
    rows = tuple(
        (Cell(label(row["estimator"])), *(Cell(str(row[c])) for c in about), *(Cell(number(row[c])) for c in times))
        for row in frame.to_dict("records")
    )
    notes = (
        "One update of one machine, measured alone on the machine; budget at 20 Hz: 50,000 µs."
        if len(rows) else "No latency was measured in this run.",
    )  # fmt: skip
    return Table("latency", "Time of one update", frame.reset_index(drop=True), columns, rows, notes)


def cost_table(cost: pd.DataFrame) -> Table:
    """Processor time of training and of all test recordings; ablations are left out."""
    cost = cost[~cost["estimator"].map(is_ablation)]
    names = ordered(cost["estimator"].unique())
    by = {stage: own.groupby("estimator")["cpu_s"] for stage, own in cost.groupby("stage")}
    frame = pd.DataFrame({"estimator": names})
    for stage, column in (("fit", "train"), ("estimate", "evaluate")):
        if stage in by:
            times = {"once": by[stage].mean(), "in_all": by[stage].sum(min_count=1)}
            for key, seconds in times.items():
                frame[f"{column}_{key}_s"] = [seconds.get(name, np.nan) for name in names]
    heads = [Column(key.split("_", 1)[1].removesuffix("_s").replace("_", " "), f"{key.split('_')[0]}, s")
             for key in frame.columns[1:]]  # fmt: skip
    rows = tuple(
        (Cell(label(row["estimator"])), *(Cell(number(row[key])) for key in frame.columns[1:]))
        for row in frame.to_dict("records")
    )
    notes = (
        "Processor time; evaluation is one pass over all test recordings with its forecasts, and the first one in a "
        "fresh checkout compiles. In all: over the seeds; who draws nothing at random is trained and evaluated once.",
    )
    return Table("cost", "What training and evaluation cost", frame, (Column("estimator"), *heads), rows, notes)


def _measured(name: str, title: str, measures: Sequence[Measure], summary: Summary) -> Table:
    """Rows: the estimators. Columns: metrics with interval and multiple of the floor."""
    best = {m.metric: _best(m.metric, summary) for m in measures}
    rows = tuple(
        (Cell(label(e)), *(_metric_cell(summary, e, m.metric, best[m.metric]) for m in measures))
        for e in summary.estimators
    )
    frame = pd.DataFrame({"estimator": summary.estimators})
    for m in measures:
        for column in Value._fields:
            key = m.metric if column == "mean" else f"{m.metric}_{column}"
            frame[key] = [getattr(summary.value(e, m.metric), column) for e in summary.estimators]
    frame["failed"] = [summary.failures.get(e, "") for e in summary.estimators]
    columns = (Column("estimator"), *(Column(m.head, m.group) for m in measures))
    return Table(name, title, frame.dropna(axis=1, how="all"), columns, rows, (INTERVALS,), _definitions(measures))


def _best(metric: str, summary: Summary) -> str | None:
    """Whose mean comes nearest to the ideal, the floor apart."""
    off = {e: abs(summary.value(e, metric).mean - IDEAL.get(metric, 0.0)) for e in summary.estimators if e != FLOOR}
    off = {e: distance for e, distance in off.items() if np.isfinite(distance)}
    return min(off, key=lambda e: off[e]) if len(off) > 1 else None


def _metric_cell(summary: Summary, estimator: str, metric: str, best: str | None) -> Cell:
    value = summary.value(estimator, metric)
    if not np.isfinite(value.mean):
        return Cell("failed" if estimator in summary.failures else "–")
    return _cell(value, estimator == best)


def _cell(value: Value, best: bool = False) -> Cell:
    interval = f"{number(value.low)}–{number(value.high)}" if np.isfinite(value.low) else ""
    return Cell(number(value.mean), interval, f"×{number(value.times, 2)}" if np.isfinite(value.times) else "", best)


def _definitions(measures: Sequence[Measure]) -> tuple[str, ...]:
    """One line per metric; that of the mean coverage stands for the ten quantities'."""
    return tuple(
        f"{m.group} {m.head}: {DEFINITIONS[m.metric]}".strip()
        for m in measures
        if not m.metric.startswith("coverage_")
    )


def _regime_column(regime: str) -> Column:
    group, _, head = regime.partition("_")
    return Column(head or group, group if head else "")
