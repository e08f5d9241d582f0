"""How well a machine's health is known: errors in per cent of its life, and relative ones as the paper has them."""

from __future__ import annotations

import numpy as np
import pandas as pd

from twinbench.bench.statistics.ranked import ranked_from
from twinbench.bench.statistics.subject import Subject, subject_of
from twinbench.bench.statistics.tracking import MOVED_SHARE
from twinbench.data.batch import Array, Batch
from twinbench.data.population import COMMISSIONING_S
from twinbench.machines.machine import Machine

TERMINAL_S = 60.0
SUDDEN_SHARE = 0.05
"""A step: from one stored tick to the next a parameter of the machine moves by more than this share of its life. The
quickest ramp moves it by .5 % in the longest time between stored ticks, the smallest step by 40 %: between the two
the same recordings are found."""

_RANGE = "in % of the range that a machine's life moves it over"
_NUMBERS = ("none", "one", "two", "three", "four", "five", "six", "seven", "eight", "nine", "ten")


def in_words(number: int) -> str:
    """A small number in words, a large one in figures."""
    return _NUMBERS[number] if number < len(_NUMBERS) else str(number)


def absolute_metric(name: str) -> str:
    """Name of the mean absolute error of a parameter that goes through zero: ``T_bias_error_K`` of ``T_bias_K``."""
    stem, _, unit = name.rpartition("_")
    return f"{stem}_error_{unit}" if stem else f"{name}_error"


def health_definitions(subject: Subject) -> dict[str, str]:
    """Every metric that ``health_scores`` returns, in one sentence to print under a table."""
    relative = [subject.health[i] for i in subject.relative]
    names = [h.label for h in relative]
    listed = f"{', '.join(names[:-1])} and {names[-1]}" if len(names) > 1 else "".join(names)
    mean, all_of = f"the mean relative error of {listed}", f"all {in_words(len(subject.health))}"
    return {
        "health_life_pct": f"Mean absolute error of a health parameter {_RANGE}, mean of the "
        f"{in_words(len(subject.health))}.",
        **{f"{h.name}_life_pct": f"Mean absolute error of {h.name}, {_RANGE}, {h.span:g}." for h in subject.health},
        "health_moving_pct": f"Mean absolute error {_RANGE}, of the parameters that change in that recording.",
        "health_still_pct": f"Mean absolute error {_RANGE}, of the parameters that do not change in that recording.",
        "health_after_sudden_pct": f"The same as the error of {all_of}, in recordings in which "
        f"{listed.replace(' and ', ' or ')} changes within one tick.",
        "health_without_sudden_pct": f"The same as the error of {all_of}, in recordings without such a step.",
        "health_commissioning_pct": f"The same as the error of {all_of}, in the first {COMMISSIONING_S / 60:g} "
        "minutes, which are in no other score.",
        "parameter_error_pct": f"Over time, the mean of {mean}.",
        "parameter_median_pct": f"Over time, the median of {mean}.",
        "parameter_p90_pct": f"Over time, the 90th percentile of {mean}.",
        "parameter_terminal_pct": f"Over the last {TERMINAL_S:g} s, the mean of {mean}.",
        **{f"{h.name}_error_pct": f"Mean absolute error of {h.name}, in % of its true value." for h in relative},
        **{
            absolute_metric(h.name): f"Mean absolute error of the {h.label}, in its unit."
            for h in subject.health
            if not h.relative
        },
        **{
            f"{h.name}_range_pct": f"RMSE of {h.name}, in % of the range of {h.span:g} that degradation moves it over."
            for h in subject.health
        },
        "parameter_range_pct": f"Mean over the {in_words(len(subject.health))} health parameters of the RMSE in % of "
        "their ranges.",
    }


def health_scores(
    machine: Machine, time_s: Array, estimated: Array, true: Array, since_s: float | None = None
) -> dict[str, Array]:
    """Metrics as ``health_definitions`` has them, (B,) each; NaN where a recording has none.

    Args:
        machine: whose health.
        time_s: (M,) seconds, the stored ticks.
        estimated: (B, M, nh) in the parameters' units; NaN where there is no estimate.
        true: (B, M, nh) likewise.
        since_s: the end of commissioning; that of the population if left out.
    """
    subject, span = subject_of(machine), machine.span
    ranked = time_s >= ranked_from(time_s, since_s)
    life = 100.0 * np.abs(estimated - true) / span
    before, after = life[:, ~ranked], life[:, ranked]
    each = after.mean(axis=1)
    health = each.mean(axis=1)
    moved = np.ptp(true[:, ranked], axis=1) > MOVED_SHARE * span
    acts = [i for i, h in enumerate(machine.health) if not h.on_readings]
    steps = np.abs(np.diff(true[:, ranked][..., acts], axis=1)) > SUDDEN_SHARE * span[acts]
    sudden = steps.any(axis=(1, 2))
    nothing = np.full(len(true), np.nan)
    return {
        "health_life_pct": health,
        **{f"{h.name}_life_pct": each[:, i] for i, h in enumerate(subject.health)},
        "health_moving_pct": _mean_of(each, moved),
        "health_still_pct": _mean_of(each, ~moved),
        "health_after_sudden_pct": np.where(sudden, health, np.nan),
        "health_without_sudden_pct": np.where(sudden, np.nan, health),
        "health_commissioning_pct": before.mean(axis=(1, 2)) if before.shape[1] else nothing,
        **_paper_scores(subject, time_s[ranked], estimated[:, ranked], true[:, ranked]),
    }


def _mean_of(each: Array, chosen: np.ndarray) -> Array:
    """(B,) means of the chosen of (B, nh); NaN where none is."""
    total = np.where(chosen, each, 0.0).sum(axis=1)
    return np.divide(total, chosen.sum(axis=1), out=np.full(len(each), np.nan), where=chosen.any(axis=1))


def _paper_scores(subject: Subject, time_s: Array, estimated: Array, true: Array) -> dict[str, Array]:
    """Relative errors and root mean squares, of the ranked ticks alone."""
    each = relative_errors(subject, estimated, true)
    together = each.mean(axis=-1)
    error = estimated - true
    percent_of_range = 100 * np.sqrt(np.mean(error**2, axis=1)) / subject.span
    last = time_s > time_s[-1] - TERMINAL_S
    names = [h.name for h in subject.health]
    signed = [i for i, h in enumerate(subject.health) if not h.relative]
    return {
        "parameter_error_pct": together.mean(axis=1),
        "parameter_median_pct": np.quantile(together, 0.5, axis=1),
        "parameter_p90_pct": np.quantile(together, 0.9, axis=1),
        "parameter_terminal_pct": together[:, last].mean(axis=1),
        **{f"{names[j]}_error_pct": each[..., i].mean(axis=1) for i, j in enumerate(subject.relative)},
        **{absolute_metric(names[i]): np.abs(error[..., i]).mean(axis=1) for i in signed},
        **{f"{name}_range_pct": percent_of_range[:, i] for i, name in enumerate(names)},
        "parameter_range_pct": percent_of_range.mean(axis=1),
    }


def relative_errors(subject: Subject, estimated: Array, true: Array) -> Array:
    """(B, M, n) per cent, of the parameters whose relative error means something.

    Args:
        subject: what the machine is.
        estimated: (B, M, nh) in the parameters' units.
        true: (B, M, nh) likewise.
    """
    kept = list(subject.relative)
    return 100 * np.abs(estimated[..., kept] - true[..., kept]) / np.abs(true[..., kept])


def true_start_held(truth: Batch, time_s: Array) -> pd.DataFrame:
    """Scores of a row that cannot be had: each recording's true health at minute 0, held to its end.

    Args:
        truth: the test recordings with their truth.
        time_s: (M,) seconds, the ticks to score at.

    Returns:
        Columns ``sequence, metric, value``, metrics as in ``health_definitions``.
    """
    assert truth.truth is not None
    ticks = np.searchsorted(truth.time_s, time_s).clip(max=len(truth.time_s) - 1)
    true = truth.truth.health[:, ticks]
    held = np.broadcast_to(truth.truth.health[:, :1], true.shape)
    frame = pd.DataFrame(health_scores(truth.machine, truth.time_s[ticks], held, true)).assign(sequence=truth.names)
    return frame.melt("sequence", var_name="metric", value_name="value")
