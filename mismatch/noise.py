"""What a sensor scatters from reading to reading, whatever the machine does."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from twinbench.physics.simulator import Array


def noise_floor(means: Sequence[Array]) -> Array:
    """Standard deviation (ny,) of block means by their second differences, median over windows of twenty.

    A signal that moves smoothly leaves nothing in second differences; the noise leaves six times its
    variance. White noise is assumed, so coloured noise is underrated: a floor, no estimate.

    Args:
        means: block means, (B, ny) per recording, in the outputs' units.
    """
    n_channels = means[0].shape[1]
    out = np.empty(n_channels)
    for c in range(n_channels):
        squares = []
        for y in means:
            second = y[2:, c] - 2.0 * y[1:-1, c] + y[:-2, c]
            windows = np.array_split(second**2, max(1, len(second) // 20))
            squares += [np.nanmean(w) for w in windows if np.isfinite(w).any()]
        out[c] = np.sqrt(np.median(squares) / 6.0) if squares else 0.0
    return out
