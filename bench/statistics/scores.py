"""From estimates to scores: every metric of the benchmark, against clean truth, sequence by sequence.

Nothing here compares with noisy measurements: one step ahead, every model scores the sensors' noise.
"""

from __future__ import annotations

import numpy as np
import pandas as pd

from twinbench.bench.estimates import Estimates
from twinbench.bench.statistics.aligned import truth_at
from twinbench.bench.statistics.coverage import inside, nees, nis_scores
from twinbench.bench.statistics.tracking import (
    LONGEST_DELAY_S,
    RECOVERED,
    effective_delay,
    health_change,
    recovery_time,
)
from twinbench.data.batch import ESTIMATED, HEALTH, STATES, Array, Batch, Truth
from twinbench.physics.health import SPAN

ZERO_C_IN_K = 273.15
TERMINAL_S = 60.0
RELATIVE = HEALTH[:4]
"""The health parameters whose relative error means something; the bias is zero when healthy."""
LEADS_S = (1, 10, 60)
STATE_ERRORS = ("p_nrmse_pct", "T_nrmse_pct", "m_nrmse_pct")
"""Errors of the filtered pressure, temperature and mass flow."""
FORECAST_ERRORS = ("p_open60_pct", "T_open60_pct", "m_open60_pct")
"""Errors of the same three, forecast a minute ahead."""

_CLEAN = {"p": "exhaust pressure", "T": "gas temperature in degC", "m": "mass flow"}
_READ = {"p": "discharge pressure", "T": "discharge temperature in degC", "m": "mass flow"}
_FOUR = "the mean relative error of capacity, efficiency, leakage and heat transfer"

DEFINITIONS = {
    **{
        f"{key}_nrmse_pct": f"RMSE of the filtered {name} against clean truth, in % of its mean value."
        for key, name in _CLEAN.items()
    },
    **{
        f"{key}_mape_pct": f"Mean absolute error of the filtered {name}, in % of the true value at that time."
        for key, name in _CLEAN.items()
    },
    **{
        f"{key}_open{lead}_pct": f"RMSE of the {name} forecast {lead} s ahead with frozen parameters, one "
        "origin a minute, against the sensor's noise-free reading, in % of its mean value."
        for lead in LEADS_S
        for key, name in _READ.items()
    },
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
    "delay_s": "Effective delay: the lag at which the estimate of the parameter that changes fits its truth "
    f"best (least RMSE around the change; 0 to {LONGEST_DELAY_S:g} s); none if a constant fits no worse.",
    "recovery_s": "Time from the end of a health change until the error of that parameter stays below "
    f"{100 * RECOVERED:g} % of the change; none if it never does.",
    "recovery_limit_s": "Time from the end of a health change to the end of the recording: how long a recovery could "
    "be watched.",
    "coverage95_pct": "Share of samples whose 95 % interval holds the truth, mean of the five states and the "
    "five health parameters; 95 is right.",
    **{
        f"coverage_{name}_pct": f"Share of samples whose 95 % interval holds the true {name}; 95 is right."
        for name in ESTIMATED
    },
    "nis_ratio": "Mean normalised innovation squared over its mean degrees of freedom; 1 is right, but says "
    "nothing about the error of the state.",
    "nis_median_ratio": "Median normalised innovation squared, each over the median of its chi-square; 1 is right.",
    "nis_inside_pct": "Share of updates whose normalised innovation squared lies in its central 95 % "
    "chi-square band; 95 is right.",
    "nees_ratio": "Mean normalised estimation error squared of all ten quantities at the forecast origins, "
    "over 10; 1 is right, more is overconfident.",
}
"""Every metric that ``score`` returns, in one sentence to print under a table."""

IDEAL = {
    **{metric: 95.0 for metric in DEFINITIONS if metric.startswith("coverage")},
    "nis_inside_pct": 95.0,
    "nis_ratio": 1.0,
    "nis_median_ratio": 1.0,
    "nees_ratio": 1.0,
}
"""What a calibration metric should be. Of every other metric less is better."""


def score(estimates: Estimates, truth: Batch) -> pd.DataFrame:
    """All metrics of one cell.

    Args:
        truth: recordings that hold the estimates' sequences and times, with their truth.

    Returns:
        Columns ``sequence, metric, value``, metrics as in DEFINITIONS; NaN where there is no value:
        an estimate or interval that is not finite, nothing to recover from.

    Raises:
        ValueError: ``truth`` has no truth, or lacks a sequence or a time.
    """
    at = truth_at(truth, estimates.names, estimates.time_s)
    columns = _state_scores(estimates, at) | _open_loop_scores(estimates, truth)
    columns |= _parameter_scores(estimates, at) | _tracking_scores(estimates, truth, at)
    columns |= _calibration_scores(estimates, truth, at)
    frame = pd.DataFrame({metric: columns[metric] for metric in DEFINITIONS})
    frame = frame.where(np.isfinite(frame)).assign(sequence=estimates.names)
    return frame.melt("sequence", var_name="metric", value_name="value")


def parameter_error_series(estimates: Estimates, truth: Batch) -> Array:
    """(B, M) per cent: at each stored tick the mean relative error of the four parameters."""
    at = truth_at(truth, estimates.names, estimates.time_s)
    return _relative_errors(_finite(estimates.mean), at).mean(axis=-1)


def _finite(values: np.ndarray) -> Array:
    """In double precision, and NaN for whatever is no number: one NaN then makes its score NaN."""
    values = values.astype(np.float64)
    return np.where(np.isfinite(values), values, np.nan)


def _rms(error: Array) -> Array:
    return np.sqrt(np.mean(error**2, axis=1))


def _state_scores(estimates: Estimates, at: Truth) -> dict[str, Array]:
    mean = _finite(estimates.mean)
    scores: dict[str, Array] = {}
    for key, state, zero in (("p", "p_exh_bar", 0), ("T", "T_gas_K", ZERO_C_IN_K), ("m", "flow_memory", 0)):
        i = STATES.index(state)
        true = at.states[..., i] - zero
        error = mean[..., i] - at.states[..., i]
        scores[f"{key}_nrmse_pct"] = 100 * _rms(error) / true.mean(axis=1)
        scores[f"{key}_mape_pct"] = 100 * np.mean(np.abs(error) / true, axis=1)
    return scores


def _open_loop_scores(estimates: Estimates, truth: Batch) -> dict[str, Array]:
    assert truth.truth is not None
    rows = [truth.names.index(name) for name in estimates.names]
    base = truth.truth.outputs[rows].mean(axis=1) - np.array([0.0, ZERO_C_IN_K, 0.0])
    leads = [float(lead) for lead in estimates.leads_s]
    scores: dict[str, Array] = {}
    for lead in LEADS_S:
        target_s = estimates.forecast_time_s + lead
        known = target_s <= truth.time_s[-1] + 1e-9
        percent = np.full(base.shape, np.nan)
        if known.any() and float(lead) in leads:
            clean = truth_at(truth, estimates.names, target_s[known]).outputs
            forecast = _finite(estimates.forecast[:, known, leads.index(float(lead))])
            percent = 100 * _rms(forecast - clean) / base
        scores |= {f"{key}_open{lead}_pct": percent[:, i] for i, key in enumerate("pTm")}
    return scores


def _relative_errors(mean: Array, at: Truth) -> Array:
    """(B, M, 4) per cent."""
    true = at.health[..., : len(RELATIVE)]
    first = len(STATES)
    return 100 * np.abs(mean[..., first : first + len(RELATIVE)] - true) / np.abs(true)


def _parameter_scores(estimates: Estimates, at: Truth) -> dict[str, Array]:
    mean = _finite(estimates.mean)
    each = _relative_errors(mean, at)
    four = each.mean(axis=-1)
    error = mean[..., len(STATES) :] - at.health
    percent_of_range = 100 * _rms(error) / SPAN
    last = estimates.time_s > estimates.time_s[-1] - TERMINAL_S
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


def _tracking_scores(estimates: Estimates, truth: Batch, at: Truth) -> dict[str, Array]:
    assert truth.truth is not None
    mean = _finite(estimates.mean)
    delay, recovery, limit = (np.full(len(estimates.names), np.nan) for _ in range(3))
    for b, name in enumerate(estimates.names):
        change = health_change(truth.time_s, truth.truth.health[truth.names.index(name)])
        if change is not None:
            estimate, true = mean[b, :, len(STATES) + change.parameter], at.health[b, :, change.parameter]
            delay[b] = effective_delay(estimates.time_s, estimate, true, change)
            recovery[b] = recovery_time(estimates.time_s, estimate, true, change)
            limit[b] = max(float(estimates.time_s[-1]) - change.end_s, 0.0)
    return {"delay_s": delay, "recovery_s": recovery, "recovery_limit_s": limit}


def _calibration_scores(estimates: Estimates, truth: Batch, at: Truth) -> dict[str, Array]:
    covered = 100 * inside(estimates, at).mean(axis=1)
    ratio, median, within = nis_scores(estimates.nis.astype(np.float64), estimates.nis_dof)
    error = estimates.mean_at_origin - truth_at(truth, estimates.names, estimates.forecast_time_s).estimated
    squared = nees(error, estimates.cov_at_origin)
    return {
        "coverage95_pct": covered.mean(axis=1),
        **{f"coverage_{name}_pct": covered[:, i] for i, name in enumerate(ESTIMATED)},
        "nis_ratio": ratio,
        "nis_median_ratio": median,
        "nis_inside_pct": within,
        "nees_ratio": squared.sum(axis=1) / (len(ESTIMATED) * (squared.shape[1] or np.nan)),
    }
