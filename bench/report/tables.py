"""The benchmark's tables: comparison, parameters, coverage, regimes, latency."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pandas as pd

from twinbench.bench.report.health_tables import health_tables
from twinbench.bench.report.main_table import comparison, quickest
from twinbench.bench.report.measured import Measure, measured, value_cell
from twinbench.bench.report.table_formats import Cell, Column, Table, number, span
from twinbench.bench.report.words import names_of
from twinbench.bench.roster import QUANTITIES, is_ablation, label, ordered
from twinbench.bench.statistics.regimes import REGIMES
from twinbench.bench.statistics.subject import PAPERS
from twinbench.bench.statistics.summary import FORECAST, LIFE, Summary, Value
from twinbench.machines.compressor import ESTIMATED, HEALTH

FORETOLD = (
    Measure("p_open60_pct", "p", "60 s ahead, %"),
    Measure("T_open60_pct", "T", "60 s ahead, %"),
    Measure("m_open60_pct", "flow", "60 s ahead, %"),
    Measure("p_open10_pct", "p", "10 s ahead, %"),
    Measure("T_open10_pct", "T", "10 s ahead, %"),
    Measure("m_open10_pct", "flow", "10 s ahead, %"),
)
TRACKED = (
    *(Measure(f"{h}_error_pct", QUANTITIES[h][0], "error, %") for h in HEALTH[:4]),
    Measure("T_bias_error_K", "T bias", "error, K"),
    Measure("parameter_median_pct", "median", "mean of four, %"),
    Measure("parameter_p90_pct", "90th percentile", "mean of four, %"),
    Measure("parameter_terminal_pct", "last 60 s", "mean of four, %"),
)
FOLLOWED = (
    *(Measure(f"{h}_range_pct", QUANTITIES[h][0], "% of range") for h in HEALTH[:4]),
    Measure("T_bias_K_range_pct", "T bias", "% of range"),
    Measure("parameter_range_pct", "mean of five", "% of range"),
    Measure("delay_s", "delay", "after a change, s"),
    Measure("recovery_s", "recovery", "after a change, s"),
)
COVERED = (
    *(Measure(f"coverage_{q}_pct", QUANTITIES[q][0], "inside, %") for q in ESTIMATED),
    Measure("coverage95_pct", "mean of ten", "inside, %"),
)
CONSISTENT = (
    Measure("nis_median_ratio", "median", "NIS"),
    Measure("nis_inside_pct", "inside, %", "NIS"),
    Measure("nis_ratio", "ratio", "NIS"),
    Measure("nees_ratio", "ratio", "NEES"),
)
RANK = (
    "Rank: mean over the sequences, 1 is best, the reference rows left out; by error of health in % of life, and by "
    "the mean of the three 60 s errors."
)
LATENCY = "Time: median of one update of one machine, by the quickest form of the filter that was timed."
STAGES = {"fit": "training", "estimate": "evaluation"}
"""Stages of a run as ``cost.csv`` has them, and in words."""
MEMORY = "Memory: all that it has learnt, and what it says of one machine and carries from update to update."


def build_tables(
    summary: Summary, regimes: pd.DataFrame, latency: pd.DataFrame, cost: pd.DataFrame, profile: str
) -> list[Table]:
    """All tables of a run.

    Args:
        regimes: what ``bench.statistics.coverage.coverage_table`` returns.
        latency: columns estimator, mode, implementation, window, p50_us, p95_us, p99_us, max_us, memory_kB.
        cost: columns estimator, seed, stage, cpu_s.
        profile: the run's name.
    """
    return [
        comparison(summary, profile, latency, cost),
        *health_tables(summary),
        measured("forecast", "Forecasts", FORETOLD, summary),
        measured("parameters", "Health parameters", TRACKED, summary),
        measured("following", "Following a change of health", FOLLOWED, summary),
        measured("coverage", "Coverage of the 95 % intervals", COVERED, summary),
        measured("consistency", "Consistency of the innovations and errors", CONSISTENT, summary),
        regime_table(regimes),
        calibrated_regimes(regimes),
        rank_table(summary, latency),
        latency_table(latency),
        cost_table(cost),
    ]


def rank_table(summary: Summary, latency: pd.DataFrame) -> Table:
    """Mean ranks, and what an update takes; nothing is marked: ranks have a figure, times are of one machine."""
    ranks = {q: dict(zip(r.estimators, map(float, r.mean_ranks), strict=True)) for q, r in summary.rankings.items()}
    columns = {
        "mean_rank_parameters": (Column("health", "mean rank"), ranks.get(LIFE, {})),
        "mean_rank_forecast": (Column("60 s ahead", "mean rank"), ranks.get(FORECAST, {})),
        "latency_p50_us": (Column("median, µs", "one update"), quickest(latency, "p50_us")),
        "memory_kB": (Column("kB", "memory"), quickest(latency, "memory_kB")),
    }
    frame = pd.DataFrame({"estimator": summary.estimators})
    for key, (_, values) in columns.items():
        frame[key] = [values.get(e, np.nan) for e in summary.estimators]
    rows = tuple(
        (Cell(label(e)), *(Cell(number(values.get(e, np.nan))) for _, values in columns.values()))
        for e in summary.estimators
    )
    heads = (Column("estimator"), *(column for column, _ in columns.values()))
    return Table("ranks", "Ranks, time and memory", frame, heads, rows, (RANK, LATENCY, MEMORY))


def regime_table(regimes: pd.DataFrame, known: Mapping[str, str] = REGIMES) -> Table:
    """Coverage in each operating regime, mean of all quantities.

    Args:
        regimes: what ``bench.statistics.coverage.coverage_table`` returns.
        known: what each regime is.
    """
    title = "Coverage of the 95 % intervals by regime, % (mean of all quantities; 95 is right)"
    if not len(regimes):
        return Table("regimes", title, regimes, (Column("estimator"),), (), ("No estimates in the store.",))
    mean = regimes[regimes["quantity"] == "mean"]
    values = {
        (name, regime): Value(*numbers)
        for name, regime, *numbers in mean[["estimator", "regime", "coverage_pct", "low", "high"]].to_numpy()
    }
    shown = [regime for regime in known if regime in set(mean["regime"])]
    rows = [
        (Cell(label(name)), *(value_cell(values.get((name, regime), Value())) for regime in shown))
        for name in ordered(mean["estimator"].unique())
    ]
    columns = (Column("estimator"), *(_regime_column(regime) for regime in shown))
    notes = [f"{_said(regime)}: {known[regime]}." for regime in shown]
    return Table("regimes", title, regimes.reset_index(drop=True), columns, tuple(rows), tuple(notes))


def calibrated_regimes(regimes: pd.DataFrame, known: Mapping[str, str] = REGIMES) -> Table:
    """Coverage after calibration in each regime, of the quantity that is covered least and of that which is most.

    Args:
        regimes: what ``bench.statistics.coverage.coverage_table`` returns.
        known: what each regime is.
    """
    name, title = (
        "regimes_calibrated",
        "Coverage after calibration by regime, %: the least and the most of all quantities",
    )
    found = regimes.reindex(columns=["estimator", "regime", "quantity", "calibrated_pct"]).dropna()
    found = found[found["quantity"] != "mean"]
    if found.empty:
        return Table(name, title, pd.DataFrame(), (Column("estimator"),), (), ("No calibrated intervals.",))
    ends = found.groupby(["estimator", "regime"])["calibrated_pct"].agg(["min", "max"]).reset_index()
    spans = {(e, r): span(low, high) for e, r, low, high in ends.itertuples(index=False)}
    shown = [regime for regime in known if regime in set(found["regime"])]
    names = [e for e in ordered(found["estimator"].unique()) if not is_ablation(e)]
    rows = [(Cell(label(e)), *(Cell(spans.get((e, r), "–")) for r in shown)) for e in names]
    columns = (Column("estimator"), *(_regime_column(regime) for regime in shown))
    notes = tuple(f"{_said(regime)}: {known[regime]}." for regime in shown)
    return Table(name, title, ends, columns, tuple(rows), notes)


def latency_table(latency: pd.DataFrame, period_s: float = PAPERS.period_s) -> Table:
    """Percentiles of the time of one update.

    Args:
        latency: columns estimator, mode, implementation, window, p50_us, p95_us, p99_us, max_us, memory_kB.
        period_s: from tick to tick, which is what an update may take.
    """
    names = ordered(latency["estimator"].unique())
    place = {name: i for i, name in enumerate(names)}
    frame = latency.assign(place=latency["estimator"].map(place))
    frame = frame.sort_values(["place", "mode", "implementation", "window"]).drop(columns="place")
    times = [c for c in frame.columns if c.endswith("_us")]
    about = [c for c in ("mode", "implementation", "window") if c in frame.columns]
    columns = (
        Column("estimator"),
        *(Column(c) for c in about),
        *(Column(c.removesuffix("_us"), "µs") for c in times),
    )
    rows = tuple(
        (Cell(label(row["estimator"])), *(Cell(str(row[c])) for c in about), *(Cell(number(row[c])) for c in times))
        for row in frame.to_dict("records")
    )
    notes = (
        f"One update of one machine, measured alone on the machine; budget at {1.0 / period_s:g} Hz: "
        f"{1e6 * period_s:,.0f} µs."
        if len(rows)
        else "No latency was measured in this run.",
    )
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
    heads = [
        Column(key.split("_", 1)[1].removesuffix("_s").replace("_", " "), f"{key.split('_')[0]}, s")
        for key in frame.columns[1:]
    ]
    rows = tuple(
        (Cell(label(row["estimator"])), *(Cell(number(row[key])) for key in frame.columns[1:]))
        for row in frame.to_dict("records")
    )
    notes = (
        "Processor time; evaluation is one pass over all test recordings with its forecasts, and the first one in a "
        "fresh checkout compiles. In all: over the seeds; who draws nothing at random is trained and evaluated once.",
        _together(cost),
    )
    return Table("cost", "What training and evaluation cost", frame, (Column("estimator"), *heads), rows, notes)


def _together(cost: pd.DataFrame) -> str:
    """What everything took, in hours."""
    hours = cost.groupby("stage")["cpu_s"].sum() / 3600.0
    parts = [f"{number(hours[stage])} h of {said}" for stage, said in STAGES.items() if stage in hours]
    return f"Together: {names_of(parts)}."


def _said(regime: str) -> str:
    """``speed, low``."""
    return ", ".join(filter(None, regime.rpartition("_")[::2]))


def _regime_column(regime: str) -> Column:
    group, _, head = regime.rpartition("_")
    return Column(head, group)
