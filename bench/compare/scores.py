"""Scores of recordings without truth: forecasts against what was read later, innovations against what they should be.

A reading's noise is in every score, for all estimators alike: one tick ahead nobody errs less than the sensor.
"""

from __future__ import annotations

import numpy as np
import pandas as pd

from twinbench.bench.compare.watched import Watched
from twinbench.bench.statistics.coverage import nis_scores
from twinbench.bench.statistics.subject import LEADS_S
from twinbench.machines.coordinates import Array
from twinbench.methods.estimator import Z95

LEAST_SD = 1e-9
"""Of an output's spread: what forecasts promise at least. It matters to a simulation without noise alone."""
HEADLINE = "open60_ratio"
DEFINITIONS = {
    **{
        f"open{lead:g}_ratio": f"RMSE of the readings foretold {lead:g} s ahead (as many ticks, where a tick lasts "
        "longer than a second), over that of holding the last reading; geometric mean of the outputs. Less than 1 is "
        "worth something."
        for lead in LEADS_S
    },
    "log_score": "Mean log density of the readings under the forecasts' own intervals, less that of holding the last "
    "reading; mean of outputs and leads. More is better, below 0 is worth nothing.",
    "inside_pct": "Share of readings inside the forecasts' 95 % intervals, mean of outputs and leads; 95 is right.",
    "nis_ratio": "Mean normalised innovation squared over its degrees of freedom; 1 is right.",
    "autocorrelation": "Correlation of neighbouring innovations over their expected sd, mean of the outputs; 0 is "
    "right: what is left over would help to foretell the next.",
}
"""Every score in one sentence to print under a table. The forecasts' intervals are those that fit the calibration
recordings of the simulated machine: what an estimator promises before it sees the real one."""


def promised(known: Watched) -> tuple[Array, Array]:
    """sd (L, ny) of an estimator's forecast errors and of holding the last reading, in the outputs' units.

    Args:
        known: of the simulated calibration recordings.
    """
    floor = LEAST_SD * np.nanstd(known.held, axis=(0, 1))
    return tuple(np.maximum(np.sqrt(np.nanmean(e**2, axis=(0, 1))), floor) for e in (known.error, known.held))  # type: ignore[return-value]


def score(name: str, seen: Watched, sd: tuple[Array, Array]) -> pd.DataFrame:
    """Scores of one recording.

    Args:
        name: of the recording.
        seen: of that recording alone.
        sd: what ``promised`` gives: (L, ny) each, in the outputs' units.

    Returns:
        Columns ``sequence, metric, value``; metrics as in DEFINITIONS, NaN where there is no value.
    """
    error, held = seen.error[0], seen.held[0]
    with np.errstate(invalid="ignore", divide="ignore"):
        ratio = np.sqrt(np.nanmean(error**2, axis=0) / np.nanmean(held**2, axis=0))
        values = {f"open{lead:g}_ratio": _geometric(ratio[i]) for i, lead in enumerate(LEADS_S)}
    there = np.isfinite(error)
    log_score = _log_density(error, sd[0]) - _log_density(held, sd[1])
    values["log_score"] = float(np.nanmean(log_score)) if there.any() else np.nan
    inside = np.where(there, np.abs(error) <= Z95 * sd[0], np.nan)
    values["inside_pct"] = 100.0 * float(np.nanmean(inside)) if there.any() else np.nan
    values["nis_ratio"] = float(nis_scores(seen.nis, seen.dof)[0][0])
    values["autocorrelation"] = _autocorrelation(seen.off[0])
    return pd.DataFrame({"sequence": name, "metric": list(values), "value": list(values.values())})


def _log_density(error: Array, sd: Array) -> Array:
    """Of a normal distribution, but for the constant."""
    return -0.5 * (error / sd) ** 2 - np.log(sd)


def _geometric(ratios: Array) -> float:
    found = ratios[np.isfinite(ratios) & (ratios > 0.0)]
    return float(np.exp(np.mean(np.log(found)))) if len(found) else np.nan


def _autocorrelation(off: Array) -> float:
    """Lag-one correlation of (N, ny), over the neighbours that are both there; mean of the outputs."""
    first, second = off[:-1], off[1:]
    both = np.isfinite(first) & np.isfinite(second)
    found = []
    for a, b, m in zip(first.T, second.T, both.T, strict=True):
        size = np.sqrt(np.mean(a[m] ** 2) * np.mean(b[m] ** 2)) if m.any() else 0.0
        if size > 0.0:
            found.append(np.mean(a[m] * b[m]) / size)
    return float(np.mean(found)) if found else np.nan
