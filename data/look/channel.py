"""What one channel of a recording shows."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from twinbench.data.look.stretches import WIDE, Stretch, gaps, still
from twinbench.machines.coordinates import Array

_HALF_NORMAL = 0.6745
"""Median of the size of a normal number of variance 1."""


@dataclass(frozen=True)
class Channel:
    """One channel; values are in its unit, and None where too little was read.

    Attributes:
        column: what the file calls it; empty for a constant of the sidecar.
        unit: as the file or the mapping states it; empty where nobody does.
        readings: how many there are.
        period_s: usual time between two of them.
        lost: share of the readings that are missing at that period, between the first and the last.
        low, median, high: of the readings.
        distinct: how many values it shows.
        noise: standard deviation from reading to reading, by second differences. White noise is assumed, so slow noise
            does not count, and of values that are rounded coarsely it is 0.
        moves: standard deviation of what is no such noise.
        swings: how often it goes from more than half a standard deviation below its mean to as much above, or back.
        gaps: where nothing was read.
        stuck: where it shows one value, though it moves elsewhere.
        clipped: the same at its highest or lowest value.
    """

    column: str
    unit: str
    readings: int
    period_s: float | None
    lost: float | None
    low: float | None
    median: float | None
    high: float | None
    distinct: int
    noise: float | None
    moves: float | None
    swings: int
    gaps: tuple[Stretch, ...]
    stuck: tuple[Stretch, ...]
    clipped: tuple[Stretch, ...]


def look_at(time_s: Array, values: Array, column: str, unit: str) -> Channel:
    """Facts of one channel.

    Args:
        time_s: (N,) seconds, increasing.
        values: (N,) in its unit; NaN means missing.
    """
    there = ~np.isnan(values)
    time_s, values = time_s[there], values[there]
    n = len(values)
    if n < 2:
        only = float(values[0]) if n else None
        return Channel(column, unit, n, None, None, only, only, only, n, None, None, 0, (), (), ())
    usual_s = float(np.median(np.diff(time_s)))
    flat = still(time_s, values)
    moving = ~np.any([(time_s >= s.begin_s) & (time_s <= s.end_s) for s in flat], axis=0) if flat else slice(None)
    low, high, noise = float(values.min()), float(values.max()), noise_of(time_s[moving], values[moving])
    return Channel(
        column,
        unit,
        n,
        usual_s,
        max(0.0, 1.0 - n / (round((time_s[-1] - time_s[0]) / usual_s) + 1)),
        low,
        float(np.median(values)),
        high,
        len(np.unique(values)),
        noise,
        float(np.sqrt(max(float(np.var(values)) - (noise or 0.0) ** 2, 0.0))),
        _swings(values),
        tuple(gaps(time_s, usual_s)),
        tuple(stretch for stretch in flat if stretch.value not in (low, high)),
        tuple(stretch for stretch in flat if stretch.value in (low, high)),
    )


def noise_of(time_s: Array, values: Array) -> float | None:
    """Standard deviation from reading to reading; None of fewer than three readings in a row.

    What moves smoothly leaves nothing in second differences, noise leaves six times its variance. The median of their
    size leaves steps out.

    Args:
        time_s: (n,) seconds at which it was read.
        values: (n,) in its unit, none missing.
    """
    steps_s = np.diff(time_s)
    near = steps_s <= WIDE * np.median(steps_s)
    second = np.abs(np.diff(values, n=2))[near[1:] & near[:-1]]
    return float(np.median(second) / (_HALF_NORMAL * np.sqrt(6.0))) if len(second) else None


def _swings(values: Array) -> int:
    """How often it goes from well below its mean to well above, or back."""
    away = values - values.mean()
    side = np.sign(away) * (np.abs(away) > 0.5 * away.std())
    side = side[side != 0.0]
    return int((np.diff(side) != 0.0).sum())
