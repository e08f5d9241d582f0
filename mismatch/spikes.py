"""Single readings that jump away and return at once: taken out, unless the simulator follows them."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pandas as pd

from twinbench.physics.simulator import Array

SIGMAS, SPIKE_WINDOW = 6.0, 31
"""Robust standard deviations that a spike lies off the middle of its neighbours, and the readings whose spread that
is; of as many Gaussian readings as anybody records none lies so far off."""
RETURNS = 0.2
"""Share of the jump, beside half of its least size for noise, by which the readings before and after a spike may
differ: more is a step or a transient, which a larger share would take out."""
FOLLOWED_SHARE = 0.5
"""Share of a jump that the simulator must show to follow it; noise does not make a simulator jump."""


class Spike(NamedTuple):
    """A reading that was taken out; ``sample`` and ``column`` are its place in the track."""

    recording: str
    channel: str
    time_s: float
    value: float
    sample: int
    column: int


def find_spikes(values: Array) -> np.ndarray:
    """Samples (K,) of readings (N,) that jump away from both neighbours and are back at the next.

    The jump is held against the robust spread of all such jumps, around it and over the whole record, and against
    the step that the sensor reads in.

    Args:
        values: (N,) readings in the channel's unit; NaN means missing.
    """
    seen = np.flatnonzero(~np.isnan(values))
    y = values[seen]
    if len(y) < SPIKE_WINDOW:
        return seen[:0]
    away = np.abs(_off(y))
    around = pd.Series(away).rolling(SPIKE_WINDOW, center=True, min_periods=SPIKE_WINDOW // 2).median().to_numpy()
    steps = np.diff(np.unique(y))
    quiet = max(1.4826 * float(np.median(away)), float(steps.min()) if len(steps) else 0.0)
    spread = np.maximum(1.4826 * around, quiet)
    there_and_back = (y[1:-1] > np.maximum(y[:-2], y[2:])) | (y[1:-1] < np.minimum(y[:-2], y[2:]))
    returned = np.abs(y[2:] - y[:-2]) < RETURNS * away + 0.5 * SIGMAS * quiet
    # Between two spikes a good reading looks like one itself.
    far = np.abs(y - pd.Series(y).rolling(7, center=True, min_periods=1).median().to_numpy())
    furthest = far[1:-1] >= np.maximum(far[:-2], far[2:])
    return np.asarray(seen[1 + np.flatnonzero(there_and_back & returned & furthest & (away > SIGMAS * spread))])


def is_followed(values: Array, simulated: Array, sample: int) -> bool:
    """Does the simulator jump at a sample as the readings do, whatever its level?

    Args:
        values: (N,) readings in the channel's unit, the jump itself among them; NaN means missing.
        simulated: (N,) in the same unit.
        sample: where they jump.
    """
    near = np.flatnonzero(~np.isnan(values))
    place = int(np.searchsorted(near, sample))
    three = near[place - 1 : place + 2]
    measured, says = _off(values[three])[0], _off(simulated[three])[0]
    return bool(says * np.sign(measured) > FOLLOWED_SHARE * abs(measured))


def _off(y: Array) -> Array:
    """How far readings lie off the middle of their neighbours, (N - 2,)."""
    return np.asarray(y[1:-1] - 0.5 * (y[:-2] + y[2:]))
