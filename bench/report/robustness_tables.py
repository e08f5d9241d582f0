"""What harder conditions cost: tables by condition, of the time after sensor faults, of noise and missing samples."""

from __future__ import annotations

import numpy as np
import pandas as pd

from twinbench.bench.report.table_formats import Cell, Column, Table, number, span
from twinbench.bench.roster import condition_label, is_ablation, label, ordered
from twinbench.bench.statistics.bootstrap import ratios, sequence_scores
from twinbench.data.disturb import CONDITIONS, DISTURBED_MINUTES, FAULT_BEGINS_S, UNDISTURBED

NOTE = (
    "Mean absolute error of the five health parameters, % of a life, mean over fresh recordings of "
    f"{DISTURBED_MINUTES:g} minutes that no rule was made with, seeds averaged. × is the multiple of the error without "
    "the condition, in brackets its 95 % interval: bootstrap over whole recordings."
)
PRESSURE = NOTE.replace("Mean absolute error of the five health parameters, % of a life", "RMSE of the pressure, %")
AFTER = (
    f"Each fault begins after {FAULT_BEGINS_S:g} s. What counts is the time from a minute after the longest of them on."
)
GROUPS = {g: [c.name for c in CONDITIONS if c.group == g] for g in dict.fromkeys(c.group for c in CONDITIONS)}


def robustness_tables(scores: pd.DataFrame) -> list[Table]:
    """Of ``robustness.csv``; none where it is empty."""
    if scores.empty:
        return []
    noise = GROUPS["noise and dropout"]
    return [
        _table(scores, "harder", GROUPS["pace"] + GROUPS["envelope"], "health_life_pct", (NOTE,)),
        _table(scores, "faults", GROUPS["fault"], "health_after_fault_pct", (NOTE, AFTER)),
        _table(scores, "noise_pressure", noise, "p_nrmse_pct", (PRESSURE,)),
        _table(scores, "noise_health", noise, "health_life_pct", (NOTE,)),
    ]


TITLES = {
    "harder": "Under faster wear and loads beyond the envelope",
    "faults": "After sensor faults",
    "noise_pressure": "Pressure under noise and missing samples",
    "noise_health": "Health under noise and missing samples",
}


def _table(scores: pd.DataFrame, name: str, conditions: list[str], metric: str, notes: tuple[str, ...]) -> Table:
    chosen = scores[(scores["metric"] == metric) & scores["condition"].isin([UNDISTURBED.name, *conditions])]
    names = [n for n in ordered(scores["estimator"].unique()) if not is_ablation(n)]
    columns = {n: _multiples(chosen[chosen["estimator"] == n]) for n in names}
    rows, lines = [], []
    for condition in (UNDISTURBED.name, *conditions):
        cells = [columns[n].get(condition, NOTHING) for n in names]
        lines.append({"condition": condition, **{n: c[0] for n, c in zip(names, cells, strict=True)}})
        rows.append((Cell(condition_label(condition)), *(_cell(*c) for c in cells)))
    heads = (Column("condition"), *(Column(label(n)) for n in names))
    return Table(name, TITLES[name], pd.DataFrame(lines), heads, tuple(rows), notes)


NOTHING = (np.nan, np.nan, np.nan, np.nan)


def _multiples(scores: pd.DataFrame) -> dict[str, tuple[float, float, float, float]]:
    """By condition, one estimator's mean and its multiple of the mean without the condition, with an interval."""
    if scores.empty:
        return {}
    mean = scores.groupby("condition")["value"].mean()
    found = {str(c): (float(v), np.nan, np.nan, np.nan) for c, v in mean.items()}
    if UNDISTURBED.name in found:
        # Conditions take the place of estimators: what is paired are the recordings.
        paired = sequence_scores(scores.assign(estimator=scores["condition"]), str(scores["metric"].iloc[0]))
        for condition, times, low, high in ratios(paired, UNDISTURBED.name).iloc[:, :4].itertuples(index=False):
            found[condition] = (found[condition][0], times, low, high)
    return found


def _cell(value: float, times: float, low: float, high: float) -> Cell:
    if not np.isfinite(value):
        return Cell("–")
    if not np.isfinite(times):
        return Cell(number(value))
    return Cell(number(value), times=f"×{number(times, 2)} [{span(low, high)}]")
