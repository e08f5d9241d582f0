"""What the harder conditions cost: one table by condition, one for the time after sensor faults."""

from __future__ import annotations

import numpy as np
import pandas as pd

from twinbench.bench.report.table_formats import Cell, Column, Table, number
from twinbench.bench.roster import condition_label, is_ablation, label, ordered
from twinbench.data.disturb import CONDITIONS, FAULT_BEGINS_S, UNDISTURBED

NOTE = (
    "Mean relative error of capacity, efficiency, leakage and heat transfer, %, mean over the test sequences, "
    "shortened to ten minutes. First seed."
)


def robustness_tables(scores: pd.DataFrame) -> list[Table]:
    """Of ``robustness.csv``; none where it is empty."""
    if scores.empty:
        return []
    names = [n for n in ordered(scores["estimator"].unique()) if not is_ablation(n)]
    harder = [c.name for c in CONDITIONS if c.group in ("pace", "envelope")]
    faults = [c.name for c in CONDITIONS if c.group == "fault"]
    after = (
        f"Each fault begins after {FAULT_BEGINS_S:g} s; what counts is the time from a minute after the longest of "
        "them on. × is the multiple of the error of that time without any fault.",
    )
    return [
        _table(
            "harder",
            "Under faster wear and loads beyond the envelope",
            harder,
            names,
            scores,
            "parameter_error_pct",
            (NOTE,),
        ),
        _table("faults", "After sensor faults", faults, names, scores, "parameter_after_pct", (NOTE, *after)),
    ]


def _table(
    name: str,
    title: str,
    conditions: list[str],
    names: list[str],
    scores: pd.DataFrame,
    metric: str,
    notes: tuple[str, ...],
) -> Table:
    chosen = scores[scores["metric"] == metric]
    means = chosen.groupby(["condition", "estimator"])["value"].mean()
    rows, lines = [], []
    usual = [float(means.get((UNDISTURBED.name, n), np.nan)) for n in names]
    for condition in (UNDISTURBED.name, *conditions):
        values = [float(means.get((condition, n), np.nan)) for n in names]
        lines.append({"condition": condition, **dict(zip(names, values, strict=True))})
        rows.append((Cell(condition_label(condition)), *map(_cell, values, usual)))
    columns = (Column("condition"), *(Column(label(n)) for n in names))
    return Table(name, title, pd.DataFrame(lines), columns, tuple(rows), notes)


def _cell(value: float, usual: float) -> Cell:
    if not np.isfinite(value):
        return Cell("–")
    return Cell(number(value), times=f"×{number(value / usual, 2)}" if usual > 0.0 else "")
