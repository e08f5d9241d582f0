"""How often a recording was read: ticks between readings, inputs between them, and the same for other recordings.

Estimators are trained on a reading of every channel each tick. Where a recording has fewer, its inputs
are joined by straight lines between readings: an estimator that holds the last one instead takes every ramp
for a stair. Outputs are left missing there, since each reading is to count once.
"""

from __future__ import annotations

import numpy as np

from twinbench.data.batch import INPUTS, SAMPLE_PERIOD_S, Array

Manner = tuple[int, ...]
"""(7,) ticks between readings of each channel, order CHANNELS; 0: it lacks, all of it or more than half."""
LONGEST_JOIN = 1.5
"""Of a channel's usual spacing: a longer gap is a gap, and is not bridged. Dropped samples at 20 Hz stay missing."""


def manner_of(measured: Array) -> Manner:
    """The median spacing of each channel's readings in (N, C), in ticks.

    Args:
        measured: (N, C) readings in the channels' units; NaN means missing.
    """
    spacings = []
    for values in measured.T:
        read = np.flatnonzero(~np.isnan(values))
        spacing = round(float(np.median(np.diff(read)))) if len(read) > 1 else 0
        spacings.append(spacing if 2 * len(read) * spacing >= len(values) else 0)
    return tuple(spacings)


def period_s(manner: Manner) -> float:
    """Of the channel that is read most seldom."""
    return max(manner) * SAMPLE_PERIOD_S


def joined(measured: Array, manner: Manner) -> Array:
    """Readings (B, N, 7) with inputs on every tick, by straight lines between two readings of one channel.

    Args:
        measured: (B, N, 7) readings in the channels' units, order CHANNELS; NaN means missing.
        manner: of these readings.
    """
    filled = measured.copy()
    for c in range(len(INPUTS)):
        if manner[c] > 1:
            for row in filled:
                _join(row[:, c], LONGEST_JOIN * manner[c])
    return filled


def _join(values: Array, longest: float) -> None:
    """Fill gaps (N,) of at most that many ticks, in place."""
    read = np.flatnonzero(~np.isnan(values))
    if len(read) < 2:
        return
    ticks = np.arange(len(values))
    after = np.searchsorted(read, ticks).clip(1, len(read) - 1)
    near = (ticks >= read[0]) & (ticks <= read[-1]) & (read[after] - read[after - 1] <= longest)
    values[near] = np.interp(ticks[near], read, values[read])


def read_as(measured: Array, manner: Manner) -> Array:
    """Other readings (B, N, 7), of every tick, as seldom as ``manner`` says.

    Args:
        measured: (B, N, 7) readings in the channels' units, order CHANNELS; NaN means missing.
        manner: to be read in.
    """
    thinned = np.full_like(measured, np.nan)
    for c, every in enumerate(manner):
        if every:
            thinned[:, ::every, c] = measured[:, ::every, c]
    return thinned
