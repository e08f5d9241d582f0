"""A metric over the sequences: means, paired differences, multiples of the reference; 95 % intervals.

The sequence is the block: seeds are averaged inside it, and every interval comes from resampling whole
sequences, the same ones for every estimator, so that differences and ratios stay paired.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
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
        failed: estimators with a failed cell and its reason. They appear even if ``scores`` has no
            row of theirs, and are never taken for complete.

    Raises:
        ValueError: no estimator has this metric, or a score is there twice.
    """
    chosen = scores[scores["metric"] == metric]
    if chosen.empty:
        known = ", ".join(sorted(scores["metric"].unique()))
        raise ValueError(f"no scores of {metric!r}; there are: {known}")
    key = ["estimator", "seed", "sequence"]
    if chosen.duplicated(key).any():
        twice = chosen[chosen.duplicated(key)].iloc[0]
        raise ValueError(f"two scores of {metric} for {', '.join(f'{k} {twice[k]}' for k in key)}")
    # A row for every estimator and seed that has any score at all: what is missing shows as NaN.
    cells = pd.MultiIndex.from_frame(scores[["estimator", "seed"]].drop_duplicates())
    wide = chosen.pivot(index=["estimator", "seed"], columns="sequence", values="value")
    wide = wide.astype(float).reindex(cells)
    wide = wide.where(np.isfinite(wide))
    undefined = wide.isna().all(axis=0) & (metric in NOT_EVERYWHERE)
    wide = wide.loc[:, ~undefined]
    failed = dict(failed or {})
    estimators = tuple(ordered({*wide.index.get_level_values("estimator"), *failed}))
    values = wide.groupby(level="estimator").mean().reindex(estimators).to_numpy()
    reasons = {}
    for estimator in estimators:
        told = [failed[estimator]] if estimator in failed else []
        if estimator in wide.index.get_level_values("estimator"):
            told += _gaps(wide.loc[[estimator]])
        if told:
            reasons[estimator] = "; ".join(told)
    return SequenceScores(metric, estimators, tuple(wide.columns), values, reasons, tuple(undefined.index[undefined]))


def _gaps(wide: pd.DataFrame) -> list[str]:
    """Where one estimator's scores, seeds by sequences, have no number."""
    missing = wide.isna()
    if not missing.to_numpy().any():
        return []
    seeds = ", ".join(str(seed) for _, seed in missing.index[missing.any(axis=1)])
    sequences = missing.columns[missing.any(axis=0)]
    shown = ", ".join(sequences[:3]) + (", ..." if len(sequences) > 3 else "")
    return [f"no score in {missing.to_numpy().sum()} of {missing.size} (seed {seeds}; {shown})"]


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
    tail = float(norm.cdf(-np.sqrt(n / (n - 1)) * t.ppf(0.5 + INTERVAL_LEVEL / 2, n - 1)))
    # Nearest: no interpolation between infinities.
    low, high = np.quantile(resampled, [tail, 1.0 - tail], method="nearest")
    return float(low), float(high)
