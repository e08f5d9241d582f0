"""When a machine's health changed, how late the estimate followed and when it had recovered."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import pandas as pd

from twinbench.data.batch import Array, Batch
from twinbench.machines.machine import Machine

MOVED_SHARE = 0.01
"""A health parameter has changed if it moved by more than this share of its range."""
RAMP_EDGE = 0.005
"""A change starts and ends where this share of it is done and left to do."""
LONGEST_DELAY_S = 120.0
AROUND_CHANGE_S = 60.0
RECOVERED = 0.2
STILL_SHARE = 1e-9
"""From one sample to the next less than this share of its range is no movement. A ramp over hours moves more, and the
round-off of a value that is held moves less: nothing depends on it in between."""


class HealthChange(NamedTuple):
    """A change of one sequence.

    Attributes:
        parameter: where it stands among the machine's health.
        start_s, end_s: when it begins and is done.
        size: how far the parameter moves, in its own unit, positive.
        until_s: when the same parameter moves again; inf where it does not.
    """

    parameter: int
    start_s: float
    end_s: float
    size: float
    until_s: float = np.inf


def health_change(machine: Machine, time_s: Array, health: Array) -> HealthChange | None:
    """When a sequence's health changed, from its true health (N, nh); None if it did not.

    Start and end span every parameter that changed; ``parameter`` is the one that moved most of its range.

    Args:
        machine: whose health.
        time_s: (N,) seconds.
        health: (N, nh) true health, in the parameters' units.
    """
    moved = np.ptp(health, axis=0)
    changed = moved > MOVED_SHARE * machine.span
    if not changed.any():
        return None
    away = np.abs(health - health[0])[:, changed] > RAMP_EDGE * moved[changed]
    arriving = np.abs(health - health[-1])[:, changed] > RAMP_EDGE * moved[changed]
    start = int(away.any(axis=1).argmax())
    # The last sample that has not arrived yet is followed by the first that has.
    end = len(time_s) - int(arriving.any(axis=1)[::-1].argmax())
    parameter = int((moved / machine.span).argmax())
    return HealthChange(parameter, float(time_s[start]), float(time_s[end]), float(moved[parameter]))


def health_changes(machine: Machine, time_s: Array, health: Array) -> list[HealthChange]:
    """Every change of every parameter, by parameter and then in time.

    A change goes one way, pauses included; one that goes back is another.

    Args:
        machine: whose health.
        time_s: (N,) seconds.
        health: (N, nh) true health, in the parameters' units.
    """
    found = []
    for i, span in enumerate(machine.span):
        steps = np.diff(health[:, i])
        moving = np.flatnonzero(np.abs(steps) > STILL_SHARE * span)
        turns = np.flatnonzero(np.diff(np.sign(steps[moving]))) + 1
        own = []
        for ticks in np.split(moving, turns) if len(moving) else []:
            first, last = int(ticks[0]), int(ticks[-1]) + 1
            size = abs(float(health[last, i] - health[first, i]))
            if size > MOVED_SHARE * span:
                own.append(HealthChange(i, float(time_s[first + 1]), float(time_s[last]), size))
        ends = [*(change.start_s for change in own[1:]), np.inf][: len(own)]
        found += [change._replace(until_s=end) for change, end in zip(own, ends, strict=True)]
    return found


def change_scores(names: Sequence[str], time_s: Array, estimated: Array, truth: Batch) -> pd.DataFrame:
    """Delay, recovery and how long a recovery could be watched, for each change of health of each recording.

    Args:
        names: of the B recordings.
        time_s: (M,) seconds, the stored ticks.
        estimated: (B, M, nh) in the parameters' units.
        truth: recordings that hold those, with their truth.

    Returns:
        Columns ``sequence, metric, value``. The metrics are ``delay_capacity_1_s``, ``recovery_capacity_1_s`` and
        ``watched_capacity_1_s`` of a recording's first change of capacity, and so on; NaN: it never came.
    """
    assert truth.truth is not None
    rows, names_of = [], truth.machine.health_names
    ticks = np.searchsorted(truth.time_s, time_s - 1e-9).clip(max=len(truth.time_s) - 1)
    for b, name in enumerate(names):
        health = truth.truth.health[truth.names.index(name)]
        counts = dict.fromkeys(names_of, 0)
        for change in health_changes(truth.machine, truth.time_s, health):
            parameter = names_of[change.parameter]
            counts[parameter] += 1
            estimate, true = estimated[b, :, change.parameter], health[ticks, change.parameter]
            watched = max(min(float(time_s[-1]), change.until_s) - change.end_s, 0.0)
            for kind, value in (
                ("delay", effective_delay(time_s, estimate, true, change)),
                ("recovery", recovery_time(time_s, estimate, true, change)),
                ("watched", watched),
            ):
                rows.append((name, f"{kind}_{parameter}_{counts[parameter]}_s", value))
    return pd.DataFrame(rows, columns=["sequence", "metric", "value"])


def effective_delay(time_s: Array, estimate: Array, true: Array, change: HealthChange) -> float:
    """The lag at which the estimate, (M,), fits the truth, (M,), best around its change; NaN if none does.

    Resolved to one stored tick. The stretch that is compared reaches a minute past the change on
    either side, less where the recording ends or the parameter moves again, so that all lags are judged on the same
    truth.

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
    ticks = ticks[ticks + lags[-1] < (time_s < change.until_s).sum()]
    if not len(ticks):
        return np.nan
    misfit = np.array([np.sqrt(np.mean((estimate[ticks + lag] - true[ticks]) ** 2)) for lag in lags])
    # An estimate that stays put fits every lag alike: it has no delay, it does not follow.
    if not misfit.min() < np.std(true[ticks]):
        return np.nan
    return float(lags[misfit.argmin()] * period)


def recovery_time(time_s: Array, estimate: Array, true: Array, change: HealthChange) -> float:
    """Seconds from the end of the change until the error stays below a fifth of it; NaN if it never does.

    It has to stay there until the parameter moves again, or the recording ends.

    Args:
        time_s: (M,) seconds, the stored ticks.
        estimate: (M,) of the parameter that changed, in its unit.
        true: (M,) its true values, in its unit.
        change: as ``health_change`` found it.
    """
    after = (time_s >= change.end_s) & (time_s < change.until_s)
    if not after.any():
        return np.nan
    astray = np.flatnonzero(~(np.abs(estimate - true)[after] < RECOVERED * change.size))
    if not len(astray):
        return 0.0
    if astray[-1] + 1 == after.sum():
        return np.nan
    return float(time_s[after][astray[-1] + 1] - change.end_s)
