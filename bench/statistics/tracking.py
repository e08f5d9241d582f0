"""When a machine's health changed, how late the estimate followed and when it had recovered."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from twinbench.data.batch import Array
from twinbench.physics.health import SPAN

MOVED_SHARE = 0.01
"""A health parameter has changed if it moved by more than this share of its range."""
RAMP_EDGE = 0.005
"""A change starts and ends where this share of it is done and left to do."""
LONGEST_DELAY_S = 120.0
AROUND_CHANGE_S = 60.0
RECOVERED = 0.2


class HealthChange(NamedTuple):
    """The change of one sequence. ``parameter`` indexes HEALTH: the one that moved most of its range."""

    parameter: int
    start_s: float
    end_s: float
    size: float  # how far the parameter moved, its own unit, positive


def health_change(time_s: Array, health: Array) -> HealthChange | None:
    """When a sequence's health changed, from its true health (N, 5); None if it did not.

    Start and end span every parameter that changed.

    Args:
        time_s: (N,) seconds.
        health: (N, 5) true health, in the parameters' units, order HEALTH.
    """
    moved = np.ptp(health, axis=0)
    changed = moved > MOVED_SHARE * SPAN
    if not changed.any():
        return None
    away = np.abs(health - health[0])[:, changed] > RAMP_EDGE * moved[changed]
    arriving = np.abs(health - health[-1])[:, changed] > RAMP_EDGE * moved[changed]
    start = int(away.any(axis=1).argmax())
    # The last sample that has not arrived yet is followed by the first that has.
    end = len(time_s) - int(arriving.any(axis=1)[::-1].argmax())
    parameter = int((moved / SPAN).argmax())
    return HealthChange(parameter, float(time_s[start]), float(time_s[end]), float(moved[parameter]))


def effective_delay(time_s: Array, estimate: Array, true: Array, change: HealthChange) -> float:
    """The lag at which the estimate, (M,), fits the truth, (M,), best around its change; NaN if none does.

    Resolved to one stored tick. The stretch that is compared reaches a minute past the change on
    either side, less where the recording ends, so that all lags are judged on the same truth.

    Args:
        time_s: (M,) seconds, the stored ticks.
        estimate: (M,) of the parameter that changed, in its unit.
        true: (M,) its true values, in its unit.
        change: as ``health_change`` found it.
    """
    if len(time_s) < 2:
        return np.nan
    period = float(np.median(np.diff(time_s)))
    lags = np.arange(int(LONGEST_DELAY_S / period) + 1)
    around = (time_s >= change.start_s - AROUND_CHANGE_S) & (time_s <= change.end_s + AROUND_CHANGE_S)
    ticks = np.flatnonzero(around)
    ticks = ticks[ticks + lags[-1] < len(time_s)]
    if not len(ticks):
        return np.nan
    misfit = np.array([np.sqrt(np.mean((estimate[ticks + lag] - true[ticks]) ** 2)) for lag in lags])
    # An estimate that stays put fits every lag alike: it has no delay, it does not follow.
    if not misfit.min() < np.std(true[ticks]):
        return np.nan
    return float(lags[misfit.argmin()] * period)


def recovery_time(time_s: Array, estimate: Array, true: Array, change: HealthChange) -> float:
    """Seconds from the end of the change until the error stays below a fifth of it; NaN if it never does.

    Args:
        time_s: (M,) seconds, the stored ticks.
        estimate: (M,) of the parameter that changed, in its unit.
        true: (M,) its true values, in its unit.
        change: as ``health_change`` found it.
    """
    after = time_s >= change.end_s
    if not after.any():
        return np.nan
    astray = np.flatnonzero(~(np.abs(estimate - true)[after] < RECOVERED * change.size))
    if not len(astray):
        return 0.0
    if astray[-1] + 1 == after.sum():
        return np.nan
    return float(time_s[after][astray[-1] + 1] - change.end_s)
