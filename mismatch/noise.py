"""What a sensor scatters from reading to reading, whatever the machine does."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from twinbench.physics.simulator import Array

BEYOND_DOUBT = 10.0
"""Nats from which on something small is told from noise: twenty thousand to one."""
FLOOR_WINDOW = 20
"""Blocks of a window: a step falls into one of them, and the median leaves it out."""


def noise_floor(means: Sequence[Array]) -> Array:
    """Standard deviation (ny,) of block means by their second differences, median over windows of twenty.

    A signal that moves smoothly leaves nothing in second differences; the noise leaves six times its
    variance. White noise is assumed, so coloured noise is underrated: a floor, no estimate.

    Args:
        means: block means, (B, ny) per recording, in the outputs' units.
    """
    squares = np.concatenate([_windowed(np.diff(y, n=2, axis=0) ** 2) for y in means])
    there = [windows[np.isfinite(windows)] for windows in squares.T]
    return np.array([np.sqrt(np.median(windows) / 6.0) if len(windows) else 0.0 for windows in there])


def _windowed(squares: Array) -> Array:
    """Means (W, ny) over windows of twenty rows; NaN where a window has none.

    Args:
        squares: (B, ny) in the outputs' units squared; NaN where nothing was read.
    """
    if not len(squares):
        return squares
    many = max(1, len(squares) // FLOOR_WINDOW)
    starts = np.arange(many) * (len(squares) // many) + np.minimum(np.arange(many), len(squares) % many)
    sums, counts = summed(squares, starts)
    with np.errstate(invalid="ignore"):
        return sums / counts


def summed(values: Array, starts: np.ndarray) -> tuple[Array, Array]:
    """Sums (B, n) over rows from one start to the next, in the values' units, and of how many that are there, (B, n).

    Args:
        values: (N, n) in any unit; NaN means missing.
        starts: (B,) positions of the first rows.
    """
    seen = ~np.isnan(values)
    sums = np.add.reduceat(np.where(seen, values, 0.0), starts, axis=0)
    return np.asarray(sums), np.asarray(np.add.reduceat(seen, starts, axis=0, dtype=float))
