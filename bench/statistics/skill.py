"""What an estimator is worth: how much less it errs than the best of the rows that cost nothing."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from twinbench.bench.roster import TRIVIAL
from twinbench.bench.statistics.bootstrap import SequenceScores, ratios


class Skill(NamedTuple):
    """1 - error / error of ``against``, with its 95 % interval over whole sequences; NaN: none.

    1 is no error, 0 no better than the best row that costs nothing, and less than 0 is worse.
    """

    value: float = np.nan
    low: float = np.nan
    high: float = np.nan
    against: str = ""


def best_trivial(table: SequenceScores, trivial: Sequence[str] = TRIVIAL) -> str:
    """Of the rows that cost nothing the one with the least mean over the sequences; empty where there is none."""
    there = [name for name in trivial if name in table.estimators and name not in table.reasons]
    return min(there, key=lambda name: float(table.row(name).mean()), default="") if table.sequences else ""


def skills(table: SequenceScores, trivial: Sequence[str] = TRIVIAL) -> dict[str, Skill]:
    """By estimator; paired by sequence, so that a hard recording counts for both. The best trivial row has none.

    Args:
        table: an error, of which less is better.
        trivial: names of the rows that cost nothing.
    """
    best = best_trivial(table, trivial)
    if not best:
        return {}
    rows = ratios(table, best)[["estimator", "ratio", "low", "high"]].to_numpy().tolist()
    return {str(name): Skill(1.0 - ratio, 1.0 - high, 1.0 - low, best) for name, ratio, low, high in rows}
