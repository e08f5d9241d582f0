"""A metric over the sequences: means, paired differences, multiples of the reference; 95 % intervals.

The sequence is the block: seeds are averaged inside it, and every interval comes from resampling whole
sequences, the same ones for every estimator, so that differences and ratios stay paired.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import pandas as pd
from scipy.stats import norm, t

from twinbench.bench.roster import REFERENCE, ordered
from twinbench.data.batch import Array

RESAMPLES = 10_000
BOOTSTRAP_SEED = 2_024
INTERVAL_LEVEL = 0.95
NOT_EVERYWHERE = (
    "delay_s", "recovery_s", "health_moving_pct", "health_still_pct", "health_after_sudden_pct",
    "health_without_sudden_pct", "health_commissioning_pct",
)  # fmt: skip
"""Metrics that have no value in some sequences: nothing moves there, or everything does, or nothing at once."""


@dataclass(frozen=True)
class SequenceScores:
    """One metric of E estimators on S sequences.

    Attributes:
        values: (E, S) in the metric's unit, seeds averaged; NaN where an estimator has no score.
        reasons: why an estimator's scores are incomplete; complete ones have no entry.
        undefined: sequences left out because the metric is one of NOT_EVERYWHERE and no estimator has a score there.
    """

    metric: str
    estimators: tuple[str, ...]
    sequences: tuple[str, ...]
    values: Array
    reasons: dict[str, str]
    undefined: tuple[str, ...]

    def row(self, estimator: str) -> Array:
        """(S,) scores of one estimator.

        Raises:
            ValueError: it has none here.
        """
        if estimator not in self.estimators:
            raise ValueError(f"{estimator!r} has no {self.metric}; these have: {', '.join(self.estimators)}")
        return self.values[self.estimators.index(estimator)]


def sequence_scores(scores: pd.DataFrame, metric: str, failed: Mapping[str, str] | None = None) -> SequenceScores:
    """One metric out of the long table, seeds averaged inside each sequence.

    Args:
        scores: columns ``estimator, seed, sequence, metric, value``; a failed cell is a NaN value.
        metric: of those in the table.
        failed: estimators with a failed cell and its reason. They appear even if ``scores`` has no
            row of theirs, and are never taken for complete.

    Raises:
        ValueError: no estimator has this metric, or a score is there twice.
    """
    return score_tables(scores, (metric,), failed)[metric]


def score_tables(
    scores: pd.DataFrame, metrics: Sequence[str], failed: Mapping[str, str] | None = None
) -> dict[str, SequenceScores]:
    """Several metrics, each as ``sequence_scores`` has it; what they share is looked up once.

    Args:
        scores: as there.
        metrics: of those in the table.
        failed: as there.

    Raises:
        ValueError: as there.
    """
    failed = dict(failed or {})
    # A row for every estimator and seed that has any score at all: what is missing shows as NaN.
    run = scores.groupby(["estimator", "seed"], sort=False, observed=True).ngroup().to_numpy()
    runs = scores[["estimator", "seed"]].iloc[np.unique(run, return_index=True)[1]]
    of_run, seeds = runs["estimator"].astype(str).to_numpy(), runs["seed"].to_numpy()
    estimators = tuple(ordered({*of_run, *failed}))
    sequence, names = pd.factorize(scores["sequence"], sort=True)
    value, rows = scores["value"].to_numpy(dtype=float), scores.groupby("metric", observed=True).indices
    tables = {}
    for metric in metrics:
        at = rows.get(metric)
        if at is None:
            raise ValueError(f"no scores of {metric!r}; there are: {', '.join(sorted(scores['metric'].unique()))}")
        if len(np.unique(run[at] * len(names) + sequence[at])) < len(at):
            raise ValueError(_twice(scores.iloc[at], metric))
        wide = np.full((len(runs), len(names)), np.nan)
        wide[run[at], sequence[at]] = np.where(np.isfinite(value[at]), value[at], np.nan)
        there = np.unique(sequence[at])
        undefined = np.isnan(wide[:, there]).all(axis=0) & (metric in NOT_EVERYWHERE)
        wide, kept = wide[:, there[~undefined]], tuple(names[there[~undefined]])
        values = pd.DataFrame(wide).groupby(of_run).mean().reindex(estimators).to_numpy()
        told = {estimator: [why] for estimator, why in failed.items()}
        for estimator in dict.fromkeys(of_run[np.isnan(wide).any(axis=1)]):
            own = of_run == estimator
            told.setdefault(estimator, []).append(_lacks(np.isnan(wide[own]), seeds[own], kept))
        reasons = {estimator: "; ".join(told[estimator]) for estimator in estimators if estimator in told}
        tables[metric] = SequenceScores(metric, estimators, kept, values, reasons, tuple(names[there[undefined]]))
    return tables


def _twice(chosen: pd.DataFrame, metric: str) -> str:
    """Which score of a metric is there a second time."""
    key = ["estimator", "seed", "sequence"]
    first = chosen[chosen.duplicated(key)].iloc[0]
    return f"two scores of {metric} for {', '.join(f'{k} {first[k]}' for k in key)}"


def _lacks(missing: np.ndarray, seeds: np.ndarray, names: Sequence[str]) -> str:
    """Where one estimator's scores, seeds by sequences, have no number."""
    seed = ", ".join(str(seed) for seed in seeds[missing.any(axis=1)])
    where = np.array(names)[missing.any(axis=0)]
    shown = ", ".join(where[:3]) + (", ..." if len(where) > 3 else "")
    return f"no score in {missing.sum()} of {missing.size} (seed {seed}; {shown})"


def means(table: SequenceScores) -> pd.DataFrame:
    """Mean over the sequences; columns ``estimator, mean, low, high, n_sequences, reason``.

    An estimator that lacks some scores has the mean of those it has; ``reason`` says what is missing
    and belongs beside the number. With no score at all the mean is NaN.
    """
    nothing = np.zeros(len(table.sequences))
    return _over_sequences(table, "mean", nothing, lambda weights, values, _: weights @ values)


def differences(table: SequenceScores, reference: str) -> pd.DataFrame:
    """Paired difference, estimator minus ``reference``, over the sequences that both have.

    Returns:
        Columns ``estimator, difference, low, high, n_sequences, reason``, without the reference.
    """
    frame = _over_sequences(
        table,
        "difference",
        table.row(reference),
        lambda weights, values, others: weights @ (values - others),
    )
    return _without(frame, reference, table)


def ratios(table: SequenceScores, reference: str = REFERENCE) -> pd.DataFrame:
    """Multiples of the reference: mean of the estimator over mean of ``reference``, on the same sequences.

    Returns:
        Columns ``estimator, ratio, low, high, n_sequences, reason``, without the reference. Infinite
        where the reference is zero.
    """
    frame = _over_sequences(table, "ratio", table.row(reference), _ratio)
    return _without(frame, reference, table)


def _ratio(weights: Array, values: Array, others: Array) -> Array:
    above, below = weights @ values, weights @ others
    return np.divide(above, below, out=np.full_like(above, np.inf), where=below > 0)


def _without(frame: pd.DataFrame, reference: str, table: SequenceScores) -> pd.DataFrame:
    """Leave the reference's own row out, and carry what it lacks into everybody's reason."""
    frame = frame[frame["estimator"] != reference].reset_index(drop=True)
    if reference in table.reasons:
        lacks = f"{reference}: {table.reasons[reference]}"
        frame["reason"] = [f"{reason}; {lacks}" if reason else lacks for reason in frame["reason"]]
    return frame


def _over_sequences(
    table: SequenceScores, column: str, others: Array, statistic: Callable[[Array, Array, Array], Array]
) -> pd.DataFrame:
    """A weighted statistic of each estimator's scores and ``others``, (S,), with its interval.

    ``statistic`` takes weights (R, n) of the n sequences that both have, and the scores, (n,) each.
    """
    rows = []
    for estimator, values in zip(table.estimators, table.values, strict=True):
        both = np.isfinite(values) & np.isfinite(others)
        n = int(both.sum())
        value, low, high = np.nan, np.nan, np.nan
        if n:
            value = float(statistic(np.full((1, n), 1.0 / n), values[both], others[both])[0])
            low, high = interval(statistic(resample_weights(n), values[both], others[both]), n)
        rows.append((estimator, value, low, high, n, table.reasons.get(estimator, "")))
    return pd.DataFrame(rows, columns=["estimator", column, "low", "high", "n_sequences", "reason"])


@lru_cache
def resample_weights(n: int) -> Array:
    """(RESAMPLES, n): the share of each of n sequences in each resample; the same ones at every call."""
    weights = np.random.default_rng(BOOTSTRAP_SEED).multinomial(n, np.full(n, 1.0 / n), size=RESAMPLES) / n
    weights.flags.writeable = False
    return weights


def interval(resampled: Array, n: int) -> tuple[float, float]:
    """Central 95 % interval from a statistic's resamples, (R,), over n blocks; NaN if n is 1.

    The percentiles are moved out so that ten blocks get the width that Student's t gives them; plain
    ones cover some 90 %. Hesterberg (2015), The American Statistician 69(4), 371-386, expanded percentiles.

    Args:
        resampled: (R,) the statistic in each resample, in its own unit.
        n: how many blocks were resampled.
    """
    if n < 2:
        return np.nan, np.nan
    tail = _tail(n)
    # Nearest: no interpolation between infinities.
    low, high = np.quantile(resampled, [tail, 1.0 - tail], method="nearest")
    return float(low), float(high)


@lru_cache
def _tail(n: int) -> float:
    """The share of resamples beyond either end of the interval over n blocks."""
    return float(norm.cdf(-np.sqrt(n / (n - 1)) * t.ppf(0.5 + INTERVAL_LEVEL / 2, n - 1)))
