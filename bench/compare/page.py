"""What the comparison on a user's recordings says: a table, and the sentences that its intervals hold."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd

from twinbench.bench.compare.scores import DEFINITIONS, HEADLINE
from twinbench.bench.report.table_formats import Cell, Column, Table, number, span
from twinbench.bench.report.words import names_of
from twinbench.bench.roster import UNRANKED, label
from twinbench.bench.statistics.apart import complete, told_apart
from twinbench.bench.statistics.bootstrap import SequenceScores, differences, means, sequence_scores

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
    "Beside each mean, its 95 % interval over recordings; there is none for fewer than {least}.",
    "More than the first: the paired difference to the first row, recording by recording.",
)
BEHIND = Column("60 s, more than the first", "error over holding the last reading")
"""The paired difference, recording by recording, to who stands first."""
LEAST_RECORDINGS = 6
"""Recordings from which on means have intervals and estimators are told apart: with fewer even a sign test cannot reach
5 %, and a bootstrap gives back the recordings themselves."""


def table(scores: pd.DataFrame, machine: str) -> Table:
    """One row per estimator, the best in the headline first.

    Args:
        scores: columns ``estimator, seed, sequence, metric, value``.
        machine: its name.
    """
    found = {metric: means(sequence_scores(scores, metric)).set_index("estimator") for metric in HEADS}
    order = list(found[HEADLINE].sort_values("mean", kind="stable").index)
    found |= {"behind": _behind(sequence_scores(scores, HEADLINE), order[0])}
    n = scores["sequence"].nunique()
    if n < LEAST_RECORDINGS:
        found = {m: one.assign(low=np.nan, high=np.nan) for m, one in found.items()}
    rows = [(Cell(label(e)), *(_cell(one.loc[e]) for one in found.values())) for e in order]
    frame = pd.concat([one.loc[order].assign(metric=m).reset_index() for m, one in found.items()], ignore_index=True)
    title = f"Forecasts of {n} recording{'s' if n > 1 else ''} of {machine}"
    definitions = tuple(f"{HEADS[m].head}: {DEFINITIONS[m]}" for m in HEADS)
    columns = (Column("estimator"), *HEADS.values(), BEHIND)
    notes = tuple(note.format(least=LEAST_RECORDINGS) for note in NOTES)
    return Table("recordings", title, frame, columns, tuple(rows), notes, definitions)


def _behind(by_recording: SequenceScores, first: str) -> pd.DataFrame:
    """By estimator, how much more it errs than the first; columns as ``means`` has them."""
    found = differences(by_recording, first).rename(columns={"difference": "mean"})
    own = {
        "estimator": first,
        "mean": np.nan,
        "low": np.nan,
        "high": np.nan,
        "n_sequences": len(by_recording.sequences),
    }
    return pd.concat([found, pd.DataFrame([own | {"reason": ""}])]).set_index("estimator")


def _cell(row: Any) -> Cell:
    return Cell(number(row["mean"]), span(row["low"], row["high"]) if np.isfinite(row["low"]) else "")


def says(scores: pd.DataFrame) -> list[str]:
    """Who foretells best a minute ahead, from whom the tests tell it apart, and whether that is worth anything."""
    by_recording = sequence_scores(scores, HEADLINE)
    mean = means(by_recording).set_index("estimator")
    ranked = [e for e in complete(by_recording) if e not in UNRANKED]
    if not ranked:
        return ["No estimator has a forecast of every recording."]
    best, n = str(mean.loc[ranked, "mean"].idxmin()), len(by_recording.sequences)
    least, low, high = (float(v) for v in mean.loc[[best], ["mean", "low", "high"]].to_numpy(dtype=float)[0])
    within = f" (95 % interval {span(low, high, to=True)})" if n >= LEAST_RECORDINGS else ""
    sentences = [
        f"{label(best)} has the least error a minute ahead: {number(least)} times{within} that of holding the "
        "last reading."
    ]
    if n >= LEAST_RECORDINGS and not high < 1.0:
        sentences.append("Its interval does not show it to be better than holding the last reading.")
    if n < LEAST_RECORDINGS:
        return [*sentences, f"{n} recording{'s are' if n > 1 else ' is'} too few to tell estimators apart."]
    others = [e for e in ranked if e != best]
    told = [label(e) for e in others if told_apart(by_recording, best, e)]
    same = [label(e) for e in others if not told_apart(by_recording, best, e)]
    if told:
        sentences.append(f"Wilcoxon's test with Holm's correction tells it from {names_of(told)}.")
    if same:
        sentences.append(f"It is not told apart from {names_of(same)}.")
    return sentences
