"""Which part of a recording is ranked: all that comes after commissioning.

In its first minutes every filter finds out what machine it has been put on. That time has a score of its own and is in
no other.
"""

from __future__ import annotations

from dataclasses import replace

from twinbench.bench.estimates import Estimates
from twinbench.data.batch import Array
from twinbench.data.population import commissioning_s


def ranked_from(time_s: Array, since_s: float | None = None) -> float:
    """The time, seconds, from which on a recording is ranked.

    Args:
        time_s: (M,) seconds, the stored ticks, from 0 on.
        since_s: the end of commissioning; that of the population if left out.
    """
    return commissioning_s(float(time_s[-1])) if since_s is None else since_s


def cut_to(estimates: Estimates, first_s: float) -> Estimates:
    """The estimates and forecasts from ``first_s`` on, seconds."""
    ticks, origins = estimates.time_s >= first_s, estimates.forecast_time_s >= first_s
    return replace(
        estimates,
        time_s=estimates.time_s[ticks],
        **{f: getattr(estimates, f)[:, ticks] for f in ("mean", "low", "high", "nis", "nis_dof", "flags")},
        forecast_time_s=estimates.forecast_time_s[origins],
        **{f: getattr(estimates, f)[:, origins] for f in ("forecast", "mean_at_origin", "cov_at_origin")},
    )
