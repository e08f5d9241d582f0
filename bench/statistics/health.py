"""How well a machine's health is known: errors in per cent of its life, and relative ones as the paper has them."""

from __future__ import annotations

import numpy as np
import pandas as pd

from twinbench.bench.statistics.ranked import ranked_from
from twinbench.bench.statistics.tracking import MOVED_SHARE
from twinbench.data.batch import HEALTH, Array, Batch
from twinbench.data.population import COMMISSIONING_S
from twinbench.physics.health import SPAN

TERMINAL_S = 60.0
RELATIVE = HEALTH[:4]
"""The health parameters whose relative error means something; the bias is zero when healthy. They are also those of
the machine itself: the bias is the sensor's."""
SUDDEN_SHARE = 0.05
"""A step: from one stored tick to the next a parameter of the machine moves by more than this share of its life. The
quickest ramp moves it by .5 % in the longest time between stored ticks, the smallest step by 40 %: between the two
the same recordings are found."""

_RANGE = "in % of the range that a machine's life moves it over"
_FOUR = "the mean relative error of capacity, efficiency, leakage and heat transfer"
HEALTH_DEFINITIONS = {
    "health_life_pct": f"Mean absolute error of a health parameter {_RANGE}, mean of the five.",
    **{
        f"{name}_life_pct": f"Mean absolute error of {name}, {_RANGE}, {span:g}."
        for name, span in zip(HEALTH, SPAN, strict=True)
    },
    "health_moving_pct": f"Mean absolute error {_RANGE}, of the parameters that change in that recording.",
    "health_still_pct": f"Mean absolute error {_RANGE}, of the parameters that do not change in that recording.",
    "health_after_sudden_pct": "The same as the error of all five, in recordings in which capacity, efficiency, "
    "leakage or heat transfer changes within one tick.",
    "health_without_sudden_pct": "The same as the error of all five, in recordings without such a step.",
    "health_commissioning_pct": f"The same as the error of all five, in the first {COMMISSIONING_S / 60:g} minutes, "
    "which are in no other score.",
    "parameter_error_pct": f"Over time, the mean of {_FOUR}.",
    "parameter_median_pct": f"Over time, the median of {_FOUR}.",
    "parameter_p90_pct": f"Over time, the 90th percentile of {_FOUR}.",
    "parameter_terminal_pct": f"Over the last {TERMINAL_S:g} s, the mean of {_FOUR}.",
    **{f"{name}_error_pct": f"Mean absolute error of {name}, in % of its true value." for name in RELATIVE},
    "T_bias_error_K": "Mean absolute error of the temperature sensor's bias, in K.",
    **{
        f"{name}_range_pct": f"RMSE of {name}, in % of the range of {span:g} that degradation moves it over."
        for name, span in zip(HEALTH, SPAN, strict=True)
    },
    "parameter_range_pct": "Mean over the five health parameters of the RMSE in % of their ranges.",
}
"""Every metric that ``health_scores`` returns, in one sentence to print under a table."""


def health_scores(time_s: Array, estimated: Array, true: Array, since_s: float | None = None) -> dict[str, Array]:
    """Metrics as in HEALTH_DEFINITIONS, (B,) each; NaN where a recording has none.

    Args:
        time_s: (M,) seconds, the stored ticks.
        estimated: (B, M, 5) in the parameters' units, order HEALTH; NaN where there is no estimate.
        true: (B, M, 5) likewise.
        since_s: the end of commissioning; that of the population if left out.
    """
    ranked = time_s >= ranked_from(time_s, since_s)
    life = 100.0 * np.abs(estimated - true) / SPAN
    before, after = life[:, ~ranked], life[:, ranked]
    each = after.mean(axis=1)
    health = each.mean(axis=1)
    moved = np.ptp(true[:, ranked], axis=1) > MOVED_SHARE * SPAN
    machine = slice(0, len(RELATIVE))
    steps = np.abs(np.diff(true[:, ranked, machine], axis=1)) > SUDDEN_SHARE * SPAN[machine]
    sudden = steps.any(axis=(1, 2))
    nothing = np.full(len(true), np.nan)
    return {
        "health_life_pct": health,
        **{f"{name}_life_pct": each[:, i] for i, name in enumerate(HEALTH)},
        "health_moving_pct": _mean_of(each, moved),
        "health_still_pct": _mean_of(each, ~moved),
        "health_after_sudden_pct": np.where(sudden, health, np.nan),
        "health_without_sudden_pct": np.where(sudden, np.nan, health),
        "health_commissioning_pct": before.mean(axis=(1, 2)) if before.shape[1] else nothing,
        **_paper_scores(time_s[ranked], estimated[:, ranked], true[:, ranked]),
    }


def _mean_of(each: Array, chosen: np.ndarray) -> Array:
    """(B,) means of the chosen of (B, 5); NaN where none is."""
    total = np.where(chosen, each, 0.0).sum(axis=1)
    return np.divide(total, chosen.sum(axis=1), out=np.full(len(each), np.nan), where=chosen.any(axis=1))


def _paper_scores(time_s: Array, estimated: Array, true: Array) -> dict[str, Array]:
    """Relative errors and root mean squares, of the ranked ticks alone."""
    each = relative_errors(estimated, true)
    four = each.mean(axis=-1)
    error = estimated - true
    percent_of_range = 100 * np.sqrt(np.mean(error**2, axis=1)) / SPAN
    last = time_s > time_s[-1] - TERMINAL_S
    return {
        "parameter_error_pct": four.mean(axis=1),
        "parameter_median_pct": np.quantile(four, 0.5, axis=1),
        "parameter_p90_pct": np.quantile(four, 0.9, axis=1),
        "parameter_terminal_pct": four[:, last].mean(axis=1),
        **{f"{name}_error_pct": each[..., i].mean(axis=1) for i, name in enumerate(RELATIVE)},
        "T_bias_error_K": np.abs(error[..., HEALTH.index("T_bias_K")]).mean(axis=1),
        **{f"{name}_range_pct": percent_of_range[:, i] for i, name in enumerate(HEALTH)},
        "parameter_range_pct": percent_of_range.mean(axis=1),
    }


def relative_errors(estimated: Array, true: Array) -> Array:
    """(B, M, 4) per cent, order RELATIVE.

    Args:
        estimated: (B, M, 5) in the parameters' units, order HEALTH.
        true: (B, M, 5) likewise.
    """
    kept = slice(0, len(RELATIVE))
    return 100 * np.abs(estimated[..., kept] - true[..., kept]) / np.abs(true[..., kept])


def true_start_held(truth: Batch, time_s: Array) -> pd.DataFrame:
    """Scores of a row that cannot be had: each recording's true health at minute 0, held to its end.

    Args:
        truth: the test recordings with their truth.
        time_s: (M,) seconds, the ticks to score at.

    Returns:
        Columns ``sequence, metric, value``, metrics as in HEALTH_DEFINITIONS.
    """
    assert truth.truth is not None
    ticks = np.searchsorted(truth.time_s, time_s).clip(max=len(truth.time_s) - 1)
    true = truth.truth.health[:, ticks]
    held = np.broadcast_to(truth.truth.health[:, :1], true.shape)
    frame = pd.DataFrame(health_scores(truth.time_s[ticks], held, true)).assign(sequence=truth.names)
    return frame.melt("sequence", var_name="metric", value_name="value")
