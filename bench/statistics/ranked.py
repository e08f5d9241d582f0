"""Which part of a recording is ranked: all that comes after commissioning.

In its first minutes every filter finds out what machine it has been put on. That time has a score of its own and is in
no other.
"""

from __future__ import annotations

from dataclasses import replace

from twinbench.bench.estimates import Estimates
from twinbench.data.batch import Array
from twinbench.data.population import COMMISSIONING_S

LEAST_RANKED_S = 60.0
"""Of a recording that ends sooner after commissioning all is ranked, so that short ones have scores, too. The
benchmark's are 20 minutes longer; anything from a few seconds to that ranks the same of them."""


def ranked_from(time_s: Array, since_s: float = COMMISSIONING_S) -> float:
    """The time, seconds, from which on a recording is ranked.

    Args:
        time_s: (M,) seconds, the stored ticks.
        since_s: the end of commissioning.
    """
    return since_s if time_s[-1] >= since_s + LEAST_RANKED_S else float(time_s[0])


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
