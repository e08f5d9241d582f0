"""How much wider intervals must be to hold what they promise: split-conformal calibration by whole recordings.

Ticks of one recording are not exchangeable, recordings are: they are the unit. The score of a tick is its error over
the half-width of its interval on that side, and the factor is the quantile of these scores, every recording weighing
the same. A quantile of few recordings fits them a little too well. So each recording is judged by the factor of the
others, and the level is raised until these judgements have the promised mean: what is right for a left-out recording
is right for a new one, but for one recording in n. No such factor can promise anything for a single recording.

Vovk, Gammerman and Shafer (2005), Algorithmic Learning in a Random World; Barber, Candes, Ramdas and Tibshirani
(2021), Predictive inference with the jackknife+, Annals of Statistics 49(1), 486-507.
"""

from __future__ import annotations

import numpy as np
from scipy.optimize import brentq

from twinbench.bench.estimates import Estimates
from twinbench.bench.statistics.aligned import truth_at
from twinbench.bench.statistics.bootstrap import INTERVAL_LEVEL
from twinbench.bench.statistics.ranked import cut_to, ranked_from
from twinbench.data.batch import Array, Batch

FACTORS = np.geomspace(0.02, 50.0, 2_000)
"""Factors that are tried, .4 % apart, in units of the median score. Beyond them an interval says nothing; a finer grid
moves coverage by less than a hundredth of a per cent."""


def factors(estimates: Estimates, truth: Batch) -> Array:
    """(n,) dimensionless: by how much each quantity's intervals are to be stretched about their estimates.

    Args:
        estimates: of the calibration recordings.
        truth: these recordings with their truth.
    """
    ranked = cut_to(estimates, ranked_from(estimates.time_s))
    at = truth_at(truth, ranked.names, ranked.time_s)
    mean, low, high = (values.astype(np.float64) for values in (ranked.mean, ranked.low, ranked.high))
    misses = nonconformity(mean, low, high, at.estimated)
    return np.array([stretch(misses[..., q]) for q in range(misses.shape[-1])])


def nonconformity(mean: Array, low: Array, high: Array, true: Array) -> Array:
    """Errors over the half-width on their side, dimensionless; inf where that is no positive number.

    Args:
        mean: (..., N) estimates, in any unit.
        low: lower bounds of their intervals, likewise.
        high: upper bounds of their intervals, likewise.
        true: likewise.
    """
    half = np.where(true > mean, high - mean, mean - low)
    usable = np.isfinite(half) & (half > 0.0) & np.isfinite(mean)
    found = np.divide(np.abs(true - mean), half, out=np.full(mean.shape, np.inf), where=usable)
    return np.where(true == mean, 0.0, found)


def stretch(misses: Array, level: float = INTERVAL_LEVEL) -> float:
    """The factor with which intervals hold the truth of a further recording for a share ``level`` of its time.

    Args:
        misses: (n, M) dimensionless, ``nonconformity`` of n recordings.
        level: the mean share of time, over recordings, that is to be inside.
    """
    seen = misses[np.isfinite(misses) & (misses > 0.0)]
    unit = float(np.median(seen)) if len(seen) else 1.0  # so that errors twice as large need just twice the factor
    tried = unit * FACTORS
    shares = np.stack([np.searchsorted(np.sort(own), tried, side="right") for own in misses]) / misses.shape[1]
    return unit * _calibrated(shares, level)


def _calibrated(shares: Array, level: float) -> float:
    """Of FACTORS, between them, the one that is right for a recording left out; shares (n, len(FACTORS)) are inside."""
    n = len(shares)
    together = shares.mean(axis=0)
    if n == 1 or together[-1] <= level:
        return _reaching(together, level)
    others = (n * together - shares) / (n - 1)

    def left_out(raised: float) -> float:
        found = [np.interp(_reaching(row, raised), FACTORS, own) for row, own in zip(others, shares, strict=True)]
        return float(np.mean(found)) - level

    if left_out(level) >= 0.0 or left_out(1.0) <= 0.0:
        return _reaching(together, level if left_out(level) >= 0.0 else 1.0)
    return _reaching(together, float(brentq(left_out, level, 1.0, xtol=1e-5)))


def _reaching(shares: Array, level: float) -> float:
    """The least factor at which a share of time, ascending over FACTORS, reaches a level; the largest if none does."""
    if shares[-1] < level:
        return float(FACTORS[-1])
    first = np.concatenate([[True], np.diff(shares) > 0.0])
    return float(np.interp(level, shares[first], FACTORS[first]))
