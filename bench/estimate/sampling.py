"""How often a recording was read: ticks between readings, inputs between them, and the same for other recordings.

Estimators are trained on a reading of every channel each tick. Where a recording has fewer, its inputs
are joined by straight lines between readings: an estimator that holds the last one instead takes every ramp
for a stair. Outputs are left missing there, since each reading is to count once.
"""

from __future__ import annotations

import numpy as np

from twinbench.machines.coordinates import Array

Manner = tuple[int, ...]
"""(nu + ny,) ticks between readings of each channel; 0: it lacks, all of it or more than half."""
LONGEST_JOIN = 1.5
"""Of a channel's usual spacing: a longer gap is one, and is not bridged. What drops out at every tick stays missing."""


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


def joined(measured: Array, manner: Manner, inputs: int) -> Array:
    """Readings (B, N, nu + ny) with inputs on every tick, by straight lines between two readings of one channel.

    Args:
        measured: (B, N, nu + ny) readings in the channels' units; NaN means missing.
        manner: of these readings.
        inputs: how many there are, nu.
    """
    filled = measured.copy()
    for c in range(inputs):
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
    """Other readings (B, N, nu + ny), of every tick, as seldom as ``manner`` says.

    Args:
        measured: (B, N, nu + ny) readings in the channels' units; NaN means missing.
        manner: to be read in.
    """
    thinned = np.full_like(measured, np.nan)
    for c, every in enumerate(manner):
        if every:
            thinned[:, ::every, c] = measured[:, ::every, c]
    return thinned
