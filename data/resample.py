"""Means over equal times in the place of samples: fewer of them, less noise, and channels of all rates in every row."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from twinbench.common.errors import BadInput
from twinbench.data.clock import usual_period
from twinbench.data.table import tell
from twinbench.machines.coordinates import Array

_LOST_DIGITS = 1e-6
"""Of the time of a mean: a stamp that is short of the next by less belongs to that, as digits get lost in reckoning."""


def resampled(time_s: Array, values: Array, rate_Hz: float | None, path: Path) -> tuple[Array, Array, tuple[str, ...]]:
    """As ``means``, if a rate is asked for; and a sentence that says so, which is told on stderr, too.

    Args:
        time_s: (N,) seconds, increasing.
        values: (N, C) in the channels' units; NaN means missing.
    """
    if rate_Hz is None:
        return time_s, values, ()
    said = f"means over {1.0 / rate_Hz:.6g} s (rate_Hz = {rate_Hz:g}) stand for {len(time_s):,} samples"
    averaged = means(time_s, values, rate_Hz, path)
    tell(path, said)
    return *averaged, (said,)


def means(time_s: Array, values: Array, rate_Hz: float, path: Path) -> tuple[Array, Array]:
    """Times (M,) in seconds and means (M, C), each stamped in the middle of what it is the mean of.

    They go from one whole multiple of the period to the next, on the recording's clock. Where no channel was read there
    is no row; where one was not, its mean is missing.

    Args:
        time_s: (N,) seconds, increasing.
        values: (N, C) in the channels' units; NaN means missing.
        path: of the file, for the message.

    Raises:
        BadInput: the rate is no lower than the recording's own, or one mean is left.
    """
    usual_s = usual_period(time_s, values.T)
    if rate_Hz * usual_s > 1.0 + _LOST_DIGITS:
        raise BadInput(f"{path}: rate_Hz = {rate_Hz:g} is above its own rate, {1.0 / usual_s:.4g} Hz; give a lower one")
    bins = np.floor(time_s * rate_Hz + _LOST_DIGITS)
    starts = np.flatnonzero(np.diff(bins, prepend=-np.inf))
    if len(starts) < 2:
        raise BadInput(
            f"{path}: rate_Hz = {rate_Hz:g} leaves one mean; a recording needs at least two, give a higher one"
        )
    seen = ~np.isnan(values)
    sums = np.add.reduceat(np.where(seen, values, 0.0), starts, axis=0)
    counts = np.add.reduceat(seen, starts, axis=0, dtype=float)
    with np.errstate(invalid="ignore"):
        return (bins[starts] + 0.5) / rate_Hz, sums / counts
