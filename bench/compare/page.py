"""What the comparison on a user's recordings says: a table, and the sentences that its intervals hold."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd

from twinbench.bench.compare.scores import DEFINITIONS, HEADLINE
from twinbench.bench.report.table_formats import Cell, Column, Table, number, span
from twinbench.bench.report.words import names_of
from twinbench.bench.roster import label
from twinbench.bench.statistics.bootstrap import differences, means, sequence_scores

HEADS = {
    "open1_ratio": Column("1 s", "error over holding the last reading"),
    "open10_ratio": Column("10 s", "error over holding the last reading"),
    "open60_ratio": Column("60 s", "error over holding the last reading"),
    "log_score": Column("gained", "log score"),
    "inside_pct": Column("inside, %", "forecast intervals"),
    "nis_ratio": Column("NIS", "innovations"),
    "autocorrelation": Column("lag one", "innovations"),
}
NOTES = (
    "Nobody knows the truth of these recordings: forecasts are held against what was read later, noise included.",
    "Forecast intervals are those that fit the simulated calibration recordings of the machine.",
    "Beside each mean, its 95 % interval over recordings; there is none for a single recording.",
)
FEWEST = 6
"""Recordings from which on estimators are told apart: with fewer even a sign test cannot reach 5 %."""


def table(scores: pd.DataFrame, machine: str) -> Table:
    """One row per estimator, the best in the headline first.

    Args:
        scores: columns ``estimator, seed, sequence, metric, value``.
        machine: its name.
    """
    found = {metric: means(sequence_scores(scores, metric)).set_index("estimator") for metric in HEADS}
    order = list(found[HEADLINE].sort_values("mean", kind="stable").index)
    rows = [(Cell(label(e)), *(_cell(found[m].loc[e]) for m in HEADS)) for e in order]
    frame = pd.concat([found[m].loc[order].assign(metric=m).reset_index() for m in HEADS], ignore_index=True)
    n = scores["sequence"].nunique()
    title = f"Forecasts of {n} recording{'s' if n > 1 else ''} of {machine}"
    definitions = tuple(f"{HEADS[m].head}: {DEFINITIONS[m]}" for m in HEADS)
    return Table("recordings", title, frame, (Column("estimator"), *HEADS.values()), tuple(rows), NOTES, definitions)


def _cell(row: Any) -> Cell:
    return Cell(number(row["mean"]), span(row["low"], row["high"]) if np.isfinite(row["low"]) else "")


def says(scores: pd.DataFrame) -> list[str]:
    """Who foretells best a minute ahead, from whom it is told apart, and whether that is worth anything."""
    by_recording = sequence_scores(scores, HEADLINE)
    mean = means(by_recording).set_index("estimator")
    whole = mean[mean["mean"].notna() & (mean["reason"] == "")]
    if whole.empty:
        return ["No estimator has a forecast of every recording."]
    best, n = str(whole["mean"].idxmin()), len(by_recording.sequences)
    row = whole.loc[best]
    within = f" (95 % interval {span(row['low'], row['high'], to=True)})" if np.isfinite(row["low"]) else ""
    sentences = [
        f"{label(best)} foretells best a minute ahead: its error is {number(row['mean'])} times{within} that of holding "
        "the last reading."
    ]
    if n < FEWEST:
        return [*sentences, f"{n} recording{'s are' if n > 1 else ' is'} too few to tell estimators apart."]
    gaps = differences(by_recording, best).set_index("estimator")
    told = [label(str(e)) for e in gaps.index if gaps.loc[e, "low"] > 0.0]
    same = [label(str(e)) for e in gaps.index if gaps.loc[e, "low"] <= 0.0]
    if told:
        sentences.append(f"By the paired 95 % interval over {n} recordings it errs less than {names_of(told)}.")
    if same:
        sentences.append(f"It is not told apart from {names_of(same)}.")
    if not row["high"] < 1.0:
        sentences.append("That is not shown to be better than holding the last reading.")
    return sentences
