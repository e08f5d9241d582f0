"""Times until something happens, some of which had not come when the recording ended.

A change that nobody recovered from is no missing value: it says that recovery takes longer than could be watched.
Such a time is censored on the right, and the median over the runs is Kaplan and Meier's (1958), Journal
of the American Statistical Association 53(282), 457-481. Without it the slowest look quick, because only
their successes count.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pandas as pd

from twinbench.bench.statistics.bootstrap import interval, resample_weights
from twinbench.bench.statistics.tracking import LONGEST_DELAY_S
from twinbench.data.batch import Array

CENSORED = ("delay_s", "recovery_s")
OF_ONE_CHANGE = r"^(delay|recovery|watched)_(.+_\d+)_s$"
"""The metrics of one change of health, ``delay_capacity_1_s``: what was timed, and of which change."""
LEAST_WATCHED = 0.2
"""Share of the runs that must still be watched where a median is read off: beyond it two or three long recordings speak
for all. 10 to 20 % is the advice of Pocock, Clayton and Altman (2002), The Lancet 359(9318), 1686-1689; with less,
estimators that recovered in three runs of thirty would have a median."""
RESAMPLES_OF_TIMES = 2_000
"""Fewer than of other statistics: each goes through all changes of all runs. Ten times as many move the ends of an
interval by less than the times lie apart."""
EDGE_S = 1.0
"""A delay nearer than this to the longest that is searched lies at the edge: it is no shorter, and may be longer.
Stored ticks are 0.2 s apart; anything from one tick to a few seconds finds the same delays at the edge."""


class Waiting(NamedTuple):
    """One estimator's times over the changes of health of all its runs.

    Attributes:
        median_s: Kaplan-Meier; inf where more than half outlast what was watched.
        low_s, high_s: its 95 % interval over the sequences; NaN with fewer than two.
        happened: after how many of the ``runs``, changes that were watched, it happened; after the others it never did.
    """

    median_s: float
    low_s: float
    high_s: float
    happened: int
    runs: int


def watched(scores: pd.DataFrame, metric: str) -> pd.DataFrame:
    """The time after every change of health in every run, or the time until which it was watched.

    Args:
        scores: columns ``estimator, seed, sequence, metric, value``, metrics of single changes among them.
        metric: of CENSORED.

    Returns:
        Columns ``estimator, seed, sequence, change, time_s, seen``; seeds that repeat another one's scores, as of who
        draws nothing at random, are left out.
    """
    parts = scores["metric"].str.extract(OF_ONE_CHANGE)
    timed = scores.assign(kind=parts[0], change=parts[1])
    where = ["sequence", "change"]
    limit_s = timed[timed["kind"] == "watched"].groupby(where)["value"].max()
    runs = _distinct(scores) if len(limit_s) else []
    names = ["estimator", "seed", *where]
    index = pd.MultiIndex.from_tuples([(*run, *at) for run in runs for at in limit_s.index], names=names)
    chosen = timed[timed["kind"] == metric.removesuffix("_s")].set_index(names)["value"]
    times_s = chosen.reindex(index).rename("time_s").reset_index()
    if metric == "delay_s":
        times_s["seen"] = times_s["time_s"] < LONGEST_DELAY_S - EDGE_S
        until_s = pd.Series(LONGEST_DELAY_S, index=times_s.index)
    else:
        times_s["seen"] = times_s["time_s"].notna()
        until_s = limit_s.reindex(pd.MultiIndex.from_frame(times_s[where])).reset_index(drop=True)
    times_s["time_s"] = times_s["time_s"].where(times_s["seen"], until_s)
    return times_s


def restricted(times_s: pd.DataFrame, metric: str) -> pd.DataFrame:
    """Scores for paired tests: a run's mean over its changes of the times, cut off at what was watched.

    Who never got there comes last, and each recording counts once.
    """
    mean_s = times_s.groupby(["estimator", "seed", "sequence"])["time_s"].mean().rename("value")
    return mean_s.reset_index().assign(metric=metric)


def waiting(times_s: pd.DataFrame) -> Waiting:
    """The median time of one estimator's rows of ``watched``, its interval, and how often it happened."""
    names = sorted(times_s["sequence"].unique())
    if not names:
        return Waiting(np.nan, np.nan, np.nan, 0, 0)
    block = times_s["sequence"].map(names.index).to_numpy()
    time_s, seen = times_s["time_s"].to_numpy(dtype=float), times_s["seen"].to_numpy(dtype=bool)
    middle = float(median(time_s, seen, np.ones((1, len(time_s))))[0])
    weights = resample_weights(len(names))[:RESAMPLES_OF_TIMES, block]
    low_s, high_s = interval(median(time_s, seen, weights), len(names))
    return Waiting(middle, low_s, high_s, int(seen.sum()), len(seen))


def survival(time_s: Array, seen: np.ndarray, weights: Array) -> tuple[Array, Array]:
    """Kaplan and Meier's estimate of the share that still waits.

    Args:
        time_s: (n,) seconds, when it happened or until when it was watched.
        seen: (n,) bool, whether it happened then.
        weights: (R, n) dimensionless shares of the runs in each of R resamples.

    Returns:
        (n,) the times in order, and (R, n) the share that waits longer than each.
    """
    # Where both fall on one time, what was only watched until then was still waiting.
    order = np.lexsort((~seen, time_s))
    w = weights[:, order]
    at_risk = np.cumsum(w[:, ::-1], axis=1)[:, ::-1]
    gone = np.divide(w * seen[order], at_risk, out=np.zeros_like(w), where=at_risk > 0)
    return time_s[order], np.cumprod(1.0 - gone, axis=1)


def median(time_s: Array, seen: np.ndarray, weights: Array) -> Array:
    """(R,) the first time by which at most half still wait; inf where that is not seen while enough are watched.

    Args:
        time_s: (n,) seconds, when it happened or until when it was watched.
        seen: (n,) bool, whether it happened then.
        weights: (R, n) dimensionless shares of the runs in each of R resamples.
    """
    ordered_s, waits = survival(time_s, seen, weights)
    w = weights[:, np.lexsort((~seen, time_s))]
    watched_share = np.cumsum(w[:, ::-1], axis=1)[:, ::-1] / w.sum(axis=1, keepdims=True)
    half = (waits <= 0.5 + 1e-12) & (watched_share >= LEAST_WATCHED - 1e-12)
    return np.where(half.any(axis=1), ordered_s[half.argmax(axis=1)], np.inf)


def _distinct(scores: pd.DataFrame) -> list[tuple[str, int]]:
    """Estimators and seeds that finished, without the seeds whose every score repeats another seed's."""
    wide = scores.pivot(index=["estimator", "seed"], columns=["sequence", "metric"], values="value")
    wide = wide.dropna(how="all").fillna(np.inf)
    # Rows as bytes: pandas compares them a hundred times slower.
    first = {(run[0], row.tobytes()): run for run, row in zip(wide.index[::-1], wide.to_numpy()[::-1], strict=True)}
    return sorted(first.values())
