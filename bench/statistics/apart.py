"""Whether two estimators are told apart: paired tests over the sequences, corrected for how many are made."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations

import numpy as np
from scipy import stats

from twinbench.bench.roster import UNRANKED
from twinbench.bench.statistics.bootstrap import SequenceScores
from twinbench.bench.statistics.ranks import holm, rank_biserial, wilcoxon_p
from twinbench.bench.statistics.scores import ideal
from twinbench.data.batch import Array

FAMILY_LEVEL = 0.05
"""Family-wise level of all tests. A smaller one tells fewer estimators apart, and marks more of them."""

EXACT_UP_TO = 50
"""Pairs up to which scipy tests exactly. It says so itself: another number would only be slower or wrong."""


def complete(table: SequenceScores) -> list[str]:
    """The estimators with a score on every sequence."""
    return [name for name in table.estimators if name not in table.reasons] if table.sequences else []


def distance(table: SequenceScores, name: str) -> Array:
    """(S,) what counts against an estimator: its score, or how far a calibration metric is from what is right."""
    return np.abs(table.row(name) - (ideal(table.metric) or 0.0))


def adjusted(table: SequenceScores, pairs: Sequence[tuple[str, str]]) -> dict[frozenset[str], float]:
    """Wilcoxon's p-value of each pair, Holm-adjusted over all of ``pairs``."""
    if not pairs:
        return {}
    off = {name: distance(table, name) for pair in pairs for name in pair}
    p = holm(_wilcoxon(np.stack([off[b] - off[a] for a, b in pairs])))
    return {frozenset(pair): float(value) for pair, value in zip(pairs, p, strict=True)}


def _wilcoxon(differences: Array) -> Array:
    """(k,) p-values of differences (k, n): all at once where scipy takes its normal approximation anyway."""
    at_once = (differences != 0.0).all(axis=1) & (differences.shape[1] > EXACT_UP_TO)
    p = np.array([np.nan if quick else wilcoxon_p(row) for quick, row in zip(at_once, differences, strict=True)])
    if at_once.any():
        p[at_once] = stats.wilcoxon(differences[at_once], axis=1).pvalue
    return p


def family(table: SequenceScores, first: str, second: str) -> list[tuple[str, str]]:
    """The pairs that are tested together with these two.

    All pairs of ranked estimators; of a reference row, it against every ranked estimator; of two, all reference rows.
    """
    whole = complete(table)
    ranked, others = [n for n in whole if n not in UNRANKED], [n for n in whole if n in UNRANKED]
    beside = [name for name in (first, second) if name in others]
    if len(beside) == 1:
        return [(beside[0], name) for name in ranked]
    return list(combinations(others if beside else ranked, 2))


def told_apart(table: SequenceScores, first: str, second: str, alpha: float = FAMILY_LEVEL) -> bool:
    """Do paired tests tell them apart, and do the means and the ranks of the differences agree on who is better?"""
    if len(table.sequences) < 2 or not {first, second} <= set(complete(table)) or first == second:
        return False
    p = adjusted(table, family(table, first, second))[frozenset((first, second))]
    difference = distance(table, second) - distance(table, first)
    return p < alpha and bool(np.sign(difference.mean()) == np.sign(rank_biserial(difference)))
