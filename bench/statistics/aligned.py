"""Truth brought to the times at which a cell stored its estimates."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from twinbench.data.batch import Array, Batch, Truth


def truth_at(truth: Batch, names: Sequence[str], time_s: Array) -> Truth:
    """The truth of some sequences at some times, in the order asked for; shapes (B, M, ...).

    Args:
        time_s: (M,) seconds, each within half a period of a tick of ``truth``.

    Raises:
        ValueError: ``truth`` carries no truth, or lacks a sequence or a time.
    """
    if truth.truth is None:
        raise ValueError("these recordings carry no truth; score against the simulated ones")
    missing = sorted(set(names) - set(truth.names))
    if missing:
        raise ValueError(f"no truth for sequence {missing[0]!r}; there is of: {', '.join(truth.names)}")
    rows = [truth.names.index(name) for name in names]
    time_s = np.asarray(time_s, dtype=np.float64)
    ticks = _nearest(truth.time_s, time_s)
    half_period = 0.5 * float(np.diff(truth.time_s).max(initial=0.0))
    off = np.abs(truth.time_s[ticks] - time_s) > half_period + 1e-9
    if off.any():
        raise ValueError(f"no truth at {time_s[off][0]:g} s; it spans {truth.time_s[0]:g} to {truth.time_s[-1]:g} s")
    fields = (truth.truth.states, truth.truth.health, truth.truth.outputs, truth.truth.inputs)
    return Truth(*(field[rows][:, ticks] for field in fields), machine=truth.machine)


def _nearest(grid: Array, values: Array) -> np.ndarray:
    right = np.searchsorted(grid, values).clip(1, len(grid) - 1)
    return np.where(values - grid[right - 1] <= grid[right] - values, right - 1, right)
