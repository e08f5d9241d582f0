"""Who is better than whom: ranks, Friedman, Nemenyi, Wilcoxon with Holm, and what so few sequences can tell.

Demsar (2006), Statistical comparisons of classifiers over multiple data sets, JMLR 7, 1-30.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from itertools import combinations

import numpy as np
import pandas as pd
from scipy import stats
from scipy.optimize import brentq

from twinbench.bench.statistics.bootstrap import SequenceScores
from twinbench.bench.statistics.scores import ideal
from twinbench.data.batch import Array

POWER = 0.8
MOST_SIGNS = 13
"""Pairs up to which all signs are gone through, 2 to the power of it. Beyond it scipy's exact way cannot take ties."""


@dataclass(frozen=True)
class Resolution:
    """The smallest gaps that this many sequences can tell from chance, at the family-wise level.

    Attributes:
        rank_gap: mean-rank gap, Nemenyi's critical difference.
        paired_gap: mean paired difference, in the metric's unit, that is found with 80 % power; the
            median over the pairs.
        smallest_p: least Holm-adjusted p-value that Wilcoxon's test can reach.
        sequences_needed: fewest with which that p-value comes below the level.
    """

    n_sequences: int
    n_estimators: int
    rank_gap: float
    paired_gap: float
    smallest_p: float
    sequences_needed: int


@dataclass(frozen=True)
class Ranking:
    """E estimators ranked on S sequences, the best mean rank first.

    Attributes:
        ranks: (E, S) dimensionless, 1 is best, ties share their mean rank.
        mean_ranks: (E,) dimensionless, their means over the sequences, ascending.
        friedman_p: of all being alike; NaN with fewer than three estimators.
        cliques: groups whose mean ranks lie within the critical difference: the diagram's bars.
        pairs: columns ``first, second, rank_gap, nemenyi_p, median_difference`` (second minus first,
            of the distances to the ideal), ``wilcoxon_p, holm_p, effect_size`` (matched-pairs
            rank-biserial, positive where first is better), ``smallest_gap, resolved``.
        dropped: estimators that are not ranked, and why.
        notes: sentences to print with the ranking.
    """

    metric: str
    estimators: tuple[str, ...]
    sequences: tuple[str, ...]
    ranks: Array
    mean_ranks: Array
    friedman_statistic: float
    friedman_p: float
    critical_difference: float
    cliques: tuple[tuple[str, ...], ...]
    pairs: pd.DataFrame
    dropped: dict[str, str]
    resolution: Resolution
    notes: tuple[str, ...]


def rank(table: SequenceScores, alpha: float = 0.05) -> Ranking:
    """Rank the estimators that have a score on every sequence; the others are dropped with their reason.

    Calibration metrics are ranked by their distance to the ideal, all others as they are.

    Raises:
        ValueError: fewer than two estimators or sequences are left.
    """
    dropped = dict(table.reasons)
    kept = [i for i, name in enumerate(table.estimators) if name not in dropped]
    if len(kept) < 2 or len(table.sequences) < 2:
        raise ValueError(
            f"a ranking by {table.metric} takes two complete estimators and two sequences; there are "
            f"{len(kept)} and {len(table.sequences)}" + "".join(f"; {name}: {why}" for name, why in dropped.items())
        )
    right = ideal(table.metric)
    scores = table.values[kept] if right is None else np.abs(table.values[kept] - right)
    ranks = stats.rankdata(scores, axis=0)
    order = np.argsort(ranks.mean(axis=1), kind="stable")
    names = tuple(table.estimators[kept[i]] for i in order)
    scores, ranks = scores[order], ranks[order]
    mean_ranks = ranks.mean(axis=1)
    k, n = ranks.shape
    statistic, p = friedman(ranks)
    gap = critical_difference(k, n, alpha)
    # Where Friedman finds no difference at all there is none to locate (Demsar, section 3.2.2).
    bars = (names,) if p >= alpha else cliques(names, mean_ranks, gap)
    pairs = compare_pairs(names, scores, mean_ranks, alpha)
    resolution = Resolution(
        n, k, gap, float(pairs["smallest_gap"].median()), smallest_p(k, n), sequences_needed(k, alpha)
    )
    notes = [*_say(resolution, alpha), *(f"{name} is not ranked: {why}." for name, why in dropped.items())]
    return Ranking(
        table.metric,
        names,
        table.sequences,
        ranks,
        mean_ranks,
        statistic,
        p,
        gap,
        bars,
        pairs,
        dropped,
        resolution,
        tuple(notes),
    )


def friedman(ranks: Array) -> tuple[float, float]:
    """Friedman's statistic, corrected for ties, and its p-value, of ranks (k, n); NaN for k < 3.

    Args:
        ranks: (k, n) dimensionless ranks of k estimators on n sequences.
    """
    if len(ranks) < 3:
        return np.nan, np.nan
    if (ranks == ranks[0]).all():
        return 0.0, 1.0
    result = stats.friedmanchisquare(*ranks)
    return float(result.statistic), float(result.pvalue)


def critical_difference(k: int, n: int, alpha: float = 0.05) -> float:
    """Nemenyi's least significant mean-rank gap of k estimators on n sequences."""
    return float(stats.studentized_range.ppf(1 - alpha, k, np.inf) * _rank_sd(k, n))


def _rank_sd(k: int, n: int) -> float:
    return np.sqrt(k * (k + 1) / (12.0 * n))


def cliques(names: tuple[str, ...], mean_ranks: Array, gap: float) -> tuple[tuple[str, ...], ...]:
    """Largest runs of two or more neighbours whose mean ranks, ascending, span no more than ``gap``.

    Args:
        names: of the estimators, the best first.
        mean_ranks: (k,) dimensionless, ascending.
        gap: the critical difference of mean ranks.
    """
    found: list[tuple[str, ...]] = []
    reached = 0
    for i in range(len(names)):
        end = int(np.searchsorted(mean_ranks, mean_ranks[i] + gap + 1e-12, side="right"))
        if end - i > 1 and end > reached:
            found.append(names[i:end])
            reached = end
    return tuple(found)


def compare_pairs(names: tuple[str, ...], scores: Array, mean_ranks: Array, alpha: float) -> pd.DataFrame:
    """Every pair of estimators, as ``Ranking.pairs`` describes; scores (k, n), less is better.

    Args:
        scores: (k, n) in the metric's unit, of k estimators on n sequences.
        mean_ranks: (k,) dimensionless, ascending.
        alpha: family-wise level.
    """
    k, n = scores.shape
    rows = []
    for i, j in combinations(range(k), 2):
        difference = scores[j] - scores[i]
        rank_gap = float(mean_ranks[j] - mean_ranks[i])
        nemenyi = float(stats.studentized_range.sf(rank_gap / _rank_sd(k, n), k, np.inf))
        level = alpha / (k * (k - 1) / 2)
        rows.append(
            (
                names[i],
                names[j],
                rank_gap,
                nemenyi,
                float(np.median(difference)),
                wilcoxon_p(difference),
                rank_biserial(difference),
                smallest_gap(float(np.std(difference, ddof=1)), n, level),
            )
        )
    columns = ["first", "second", "rank_gap", "nemenyi_p", "median_difference", "wilcoxon_p", "effect_size"]
    pairs = pd.DataFrame(rows, columns=[*columns, "smallest_gap"])
    pairs.insert(6, "holm_p", holm(pairs["wilcoxon_p"].to_numpy()))
    return pairs.assign(resolved=pairs["holm_p"] < alpha)


def wilcoxon_p(difference: Array) -> float:
    """Two-sided p-value of Wilcoxon's signed-rank test of paired differences (n,); 1 if all are zero.

    Exact up to ``MOST_SIGNS`` pairs by going through all signs, and without ties up to 50 by scipy.

    Args:
        difference: (n,) in any unit, one per sequence.
    """
    moved = difference[difference != 0]
    if not len(moved):
        return 1.0
    if len(moved) > MOST_SIGNS:
        return float(stats.wilcoxon(difference).pvalue)
    # scipy gives the same, many times slower.
    ranks = stats.rankdata(np.abs(moved))
    sums = _signs(len(moved)) @ ranks
    seen = ranks[moved > 0].sum()
    return float(min(1.0, 2.0 * min(np.mean(sums <= seen), np.mean(sums >= seen))))


@lru_cache
def _signs(n: int) -> Array:
    """(2^n, n): which of n differences are positive, every way there is."""
    return ((np.arange(2**n)[:, None] >> np.arange(n)) & 1).astype(float)


def holm(p: Array) -> Array:
    """Step-down Holm: family-wise adjusted p-values, in the order given.

    Args:
        p: (n,) dimensionless p-values.
    """
    order = np.argsort(p, kind="stable")
    steps = np.arange(len(p), 0, -1) * p[order]
    adjusted = np.empty(len(p))
    adjusted[order] = np.minimum(np.maximum.accumulate(steps), 1.0)
    return adjusted


def rank_biserial(difference: Array) -> float:
    """Matched-pairs rank-biserial correlation, -1 to 1: share of the rank sum that is positive less negative.

    Kerby (2014), Comprehensive Psychology 3, 11.IT.3.1. Zero differences are left out; 0 if all are.

    Args:
        difference: (n,) in any unit, one per sequence.
    """
    moved = difference[difference != 0]
    if not len(moved):
        return 0.0
    ranks = stats.rankdata(np.abs(moved))
    return float((np.sign(moved) * ranks).sum() / ranks.sum())


def smallest_gap(sd: float, n: int, alpha: float, power: float = POWER) -> float:
    """Mean of n paired differences of this sd that a two-sided t test at ``alpha`` finds with ``power``.

    Wilcoxon's test needs some 5 % more pairs for the same.
    """
    critical = stats.t.ppf(1 - alpha / 2, n - 1)
    # Power by the noncentral t; the far tail on the wrong side is nil at any power worth having.
    noncentrality = brentq(lambda d: stats.nct.sf(critical, n - 1, d) - power, 0.0, 2 * critical + 10)
    return float(noncentrality * sd / np.sqrt(n))


def smallest_p(k: int, n: int) -> float:
    """Least Holm-adjusted p-value of k estimators on n sequences: all n differences of one sign."""
    return min(1.0, 2.0 ** (1 - n) * k * (k - 1) / 2)


def sequences_needed(k: int, alpha: float = 0.05) -> int:
    """Fewest sequences with which one pair of k estimators can come below ``alpha`` at all."""
    return next(n for n in range(2, 100) if smallest_p(k, n) < alpha)


def _say(r: Resolution, alpha: float) -> list[str]:
    floor = (
        f"Resolution floor of {r.n_sequences} sequences and {r.n_estimators} estimators: mean ranks closer "
        f"than {r.rank_gap:.2f} are not told apart; a mean paired gap below {r.paired_gap:.3g} (median over "
        f"the pairs) has less than {100 * POWER:.0f} % chance to be found at the family-wise level {alpha:g}."
    )
    notes = [floor]
    if r.rank_gap > r.n_estimators - 1:
        notes.append(f"No mean-rank gap can be resolved: the largest possible is {r.n_estimators - 1}.")
    if r.smallest_p >= alpha:
        notes.append(
            f"Wilcoxon with Holm cannot resolve any pair (least p {r.smallest_p:.2g}): that takes "
            f"{r.sequences_needed} sequences."
        )
    return notes
