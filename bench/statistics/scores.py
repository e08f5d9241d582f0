"""From estimates to scores: every metric of the benchmark, against clean truth, sequence by sequence.

Nothing here compares with noisy measurements: one step ahead, every model scores the sensors' noise.
"""

from __future__ import annotations

import numpy as np
import pandas as pd

from twinbench.bench.estimates import Estimates, ticks_ahead
from twinbench.bench.statistics.aligned import truth_at
from twinbench.bench.statistics.censored import CENSORED
from twinbench.bench.statistics.coverage import inside, nees, nis_scores
from twinbench.bench.statistics.health import health_definitions, health_scores, in_words, relative_errors
from twinbench.bench.statistics.ranked import cut_to, ranked_from
from twinbench.bench.statistics.subject import LEADS_S, PAPERS, Subject, subject_of
from twinbench.bench.statistics.tracking import LONGEST_DELAY_S, RECOVERED, change_scores
from twinbench.data.batch import Array, Batch, Truth
from twinbench.machines.machine import Machine

STATE_ERRORS, FORECAST_ERRORS = PAPERS.state_errors, PAPERS.forecast_errors
"""The compressor's errors of filtered pressure, temperature and mass flow, and of the same forecast a minute ahead."""
_WIDENED = "once every interval is made wider or narrower by the factor that fits the calibration recordings"


def definitions_of(subject: Subject) -> dict[str, str]:
    """Every metric that ``score`` returns, in one sentence to print under a table; of the times that CENSORED names it
    returns one for each change of health, as ``bench.statistics.tracking.change_scores`` names them."""
    names = [q.name for q in subject.quantities]
    states, health, all_of = (in_words(n) for n in (len(names) - len(subject.health), len(subject.health), len(names)))
    return {
        **{
            f"{o.key}_nrmse_pct": f"RMSE of the filtered {o.says} against clean truth, in % of {o.share_of}."
            for o in subject.outputs
        },
        **{
            f"{o.key}_mape_pct": f"Mean absolute error of the filtered {o.says}, in % of the true value at that time."
            for o in subject.outputs
        },
        **{
            f"{o.key}_open{lead}_pct": f"RMSE of the {o.reads} forecast {lead} s ahead with frozen parameters, one "
            f"origin a minute, against the sensor's noise-free reading, in % of {o.share_of}."
            for lead in LEADS_S
            for o in subject.outputs
        },
        **health_definitions(subject),
        "delay_s": "Effective delay after a change of health: the lag at which the estimate of that parameter fits its "
        f"truth best (least RMSE around the change; 0 to {LONGEST_DELAY_S:g} s); none if a constant fits no worse.",
        "recovery_s": "Time from the end of a change of health until the error of that parameter stays below "
        f"{100 * RECOVERED:g} % of the change, to its next change or the recording's end; none if it never does.",
        "coverage95_pct": f"Share of samples whose 95 % interval holds the truth, mean of the {states} states and the "
        f"{health} health parameters; 95 is right.",
        **{
            f"coverage_{name}_pct": f"Share of samples whose 95 % interval holds the true {name}; 95 is right."
            for name in names
        },
        "calibrated_coverage95_pct": f"The mean coverage of the {all_of} quantities, {_WIDENED}; 95 is right.",
        **{
            f"calibrated_coverage_{name}_pct": f"Share of samples whose interval holds the true {name}, {_WIDENED}; 95 "
            "is right."
            for name in names
        },
        "nis_ratio": "Mean normalised innovation squared over its mean degrees of freedom; 1 is right, but says "
        "nothing about the error of the state.",
        "nis_median_ratio": "Median normalised innovation squared, each over the median of its chi-square; 1 is right.",
        "nis_inside_pct": "Share of updates whose normalised innovation squared lies in its central 95 % "
        "chi-square band; 95 is right.",
        "nees_ratio": f"Mean normalised estimation error squared of all {all_of} quantities at the forecast origins, "
        f"over {len(names)}; 1 is right, more is overconfident.",
    }


def metrics_of(subject: Subject) -> tuple[str, ...]:
    """The metrics that every recording has one of."""
    return tuple(metric for metric in definitions_of(subject) if metric not in CENSORED)


DEFINITIONS = definitions_of(PAPERS)
METRICS = metrics_of(PAPERS)
"""Those of the compressor."""
CONSISTENCY = {"nis_inside_pct": 95.0, "nis_ratio": 1.0, "nis_median_ratio": 1.0, "nees_ratio": 1.0}


def ideal(metric: str) -> float | None:
    """What a calibration metric should be; None of every other, of which less is better."""
    return 95.0 if "coverage" in metric else CONSISTENCY.get(metric)


def score(estimates: Estimates, truth: Batch, since_s: float | None = None) -> pd.DataFrame:
    """All metrics of one cell.

    Args:
        truth: recordings that hold the estimates' sequences and times, with their truth.
        since_s: the end of commissioning, before which nothing is ranked; that of the population if left out.

    Returns:
        Columns ``sequence, metric, value``, metrics as in ``metrics_of`` and, for each change of health, its times; NaN
        where there is no value: an estimate or interval that is not finite, nothing that moves.

    Raises:
        ValueError: ``truth`` has no truth, or lacks a sequence or a time.
    """
    everything = truth_at(truth, estimates.names, estimates.time_s)
    first_s = ranked_from(estimates.time_s, since_s)
    ranked = cut_to(estimates, first_s)
    at = truth_at(truth, ranked.names, ranked.time_s)
    machine = truth.machine
    health = _finite(estimates.mean[..., len(machine.estimated) :])
    columns = _state_scores(machine, ranked, at) | _open_loop_scores(ranked, truth, first_s)
    columns |= health_scores(machine, estimates.time_s, health, everything.health, since_s)
    columns |= _calibration_scores(ranked, truth, at)
    frame = pd.DataFrame({metric: columns[metric] for metric in metrics_of(subject_of(machine))})
    frame = frame.where(np.isfinite(frame)).assign(sequence=estimates.names)
    long = frame.melt("sequence", var_name="metric", value_name="value")
    times = change_scores(estimates.names, estimates.time_s, health, truth)
    return pd.concat([long, times], ignore_index=True) if len(times) else long


def parameter_error_series(estimates: Estimates, truth: Batch) -> Array:
    """(B, M) per cent: at each ranked tick the mean relative error of the parameters that have one."""
    ranked = cut_to(estimates, ranked_from(estimates.time_s))
    at = truth_at(truth, ranked.names, ranked.time_s)
    health = _finite(ranked.mean[..., len(truth.machine.estimated) :])
    return relative_errors(subject_of(truth.machine), health, at.health).mean(axis=-1)


def _finite(values: np.ndarray) -> Array:
    """In double precision, and NaN for whatever is no number: one NaN then makes its score NaN."""
    values = values.astype(np.float64)
    return np.where(np.isfinite(values), values, np.nan)


def _rms(error: Array) -> Array:
    return np.sqrt(np.mean(error**2, axis=1))


def _state_scores(machine: Machine, estimates: Estimates, at: Truth) -> dict[str, Array]:
    mean = _finite(estimates.mean)
    follows = {lag.state: lag.follows for lag in machine.lags}
    rms, mape = {}, {}
    for r in machine.readings:
        i = machine.estimated.index(follows.get(r.state, r.state))
        true = at.states[..., i] - r.zero
        error = mean[..., i] - at.states[..., i]
        rms[f"{r.key}_nrmse_pct"] = 100 * _rms(error) / (r.size or true.mean(axis=1))
        mape[f"{r.key}_mape_pct"] = 100 * np.mean(np.abs(error) / (r.size or true), axis=1)
    return rms | mape


def _open_loop_scores(estimates: Estimates, truth: Batch, first_s: float) -> dict[str, Array]:
    assert truth.truth is not None
    readings, period_s = truth.machine.readings, truth.machine.sample_period_s
    rows = [truth.names.index(name) for name in estimates.names]
    base = truth.truth.outputs[rows][:, truth.time_s >= first_s].mean(axis=1) - np.array([r.zero for r in readings])
    sizes = np.array([abs(r.gain) * r.size for r in readings])
    base = np.where(sizes > 0.0, sizes, base)
    leads = [float(lead) for lead in estimates.leads_s]
    scores: dict[str, Array] = {}
    for lead in LEADS_S:
        target_s = estimates.forecast_time_s + period_s * ticks_ahead(np.array(lead), period_s)
        known = target_s <= truth.time_s[-1] + 1e-9
        percent = np.full(base.shape, np.nan)
        if known.any() and float(lead) in leads:
            clean = truth_at(truth, estimates.names, target_s[known]).outputs
            forecast = _finite(estimates.forecast[:, known, leads.index(float(lead))])
            percent = 100 * _rms(forecast - clean) / base
        scores |= {f"{r.key}_open{lead}_pct": percent[:, i] for i, r in enumerate(readings)}
    return scores


def _calibration_scores(estimates: Estimates, truth: Batch, at: Truth) -> dict[str, Array]:
    names = truth.machine.quantities
    covered = 100 * inside(estimates, at).mean(axis=1)
    calibrated = 100 * inside(estimates.calibrated(), at).mean(axis=1)
    ratio, median, within = nis_scores(estimates.nis.astype(np.float64), estimates.nis_dof)
    error = estimates.mean_at_origin - truth_at(truth, estimates.names, estimates.forecast_time_s).estimated
    squared = nees(error, estimates.cov_at_origin)
    return {
        "coverage95_pct": covered.mean(axis=1),
        **{f"coverage_{name}_pct": covered[:, i] for i, name in enumerate(names)},
        "calibrated_coverage95_pct": calibrated.mean(axis=1),
        **{f"calibrated_coverage_{name}_pct": calibrated[:, i] for i, name in enumerate(names)},
        "nis_ratio": ratio,
        "nis_median_ratio": median,
        "nis_inside_pct": within,
        "nees_ratio": squared.sum(axis=1) / (len(names) * (squared.shape[1] or np.nan)),
    }
