"""What slow, late, worn or stuck devices make of a record; time stamps may be uneven.

Readings are points of a smooth signal. Inputs are steps: the value at t_k holds until t_(k+1), and
what comes out is the mean over that time. So lag and delay go continuously to none at all.
"""

from __future__ import annotations

import numpy as np
from numba import njit, types

from twinbench.physics.jit import VECTOR
from twinbench.physics.simulator import Array

NOISES_APART = 3.0
"""Standard deviations of the noise by which a sample may differ from its neighbours and be of one level with them."""


def held(values: Array) -> Array:
    """Values with the last one held over NaN; a leading gap takes the first value there is.

    Args:
        values: (N,) in the channel's unit, or (N, C) columns in their units; NaN means missing.
    """
    if values.ndim == 2:
        out = np.array(values, dtype=float, order="C")
        for column in out.T:
            column[:] = held(column)
        return out
    seen = np.flatnonzero(~np.isnan(values))
    if len(seen) in (0, len(values)):
        return values
    last = np.searchsorted(seen, np.arange(len(values)), side="right") - 1
    return np.asarray(values[seen[np.maximum(last, 0)]])


def lag_reading(time_s: Array, values: Array, tau_s: float) -> Array:
    """First-order lag of readings joined by straight lines, settled at the first.

    Args:
        time_s: (N,) seconds.
        values: (N,) in the channel's unit.
        tau_s: time constant.
    """
    return values if tau_s <= 0.0 else np.asarray(_lag_lines(np.diff(time_s), values, tau_s))


def lag_steps(time_s: Array, values: Array, tau_s: float) -> Array:
    """First-order lag of steps, settled at the first; its mean over each step.

    Args:
        time_s: (N,) seconds.
        values: (N,) in the channel's unit.
        tau_s: time constant.
    """
    if tau_s <= 0.0:
        return values
    gaps_s = _gaps(time_s)
    kept = np.exp(-gaps_s / tau_s)
    behind = _behind(values, kept)
    return np.asarray(values + behind * (1.0 - kept) * tau_s / gaps_s)


def delay_reading(time_s: Array, values: Array, delay_s: float) -> Array:
    """Readings ``delay_s`` late, joined by straight lines; the first holds before the record.

    Args:
        time_s: (N,) seconds.
        values: (N,) in the channel's unit.
        delay_s: how late.
    """
    return values if delay_s <= 0.0 else np.interp(time_s - delay_s, time_s, values)


def delay_steps(time_s: Array, values: Array, delay_s: float) -> Array:
    """Steps ``delay_s`` late, as their mean over each step of the record; the first holds before it.

    Args:
        time_s: (N,) seconds.
        values: (N,) in the channel's unit.
        delay_s: how late.
    """
    if delay_s <= 0.0:
        return values
    gaps_s = _gaps(time_s)
    before = time_s[0] - delay_s - 1.0
    edges = np.concatenate(([before], time_s, [time_s[-1] + gaps_s[-1]]))
    area = np.concatenate(
        ([0.0, values[0] * (time_s[0] - before)], values[0] * (time_s[0] - before) + np.cumsum(values * gaps_s))
    )
    passed = np.interp(edges[1:] - delay_s, edges, area)
    return np.diff(passed) / gaps_s


def play(values: Array, gap: float) -> Array:
    """Backlash: what follows moves only when the gap (full width) is used up; it starts centred.

    Args:
        values: (N,) in the channel's unit.
        gap: in the channel's unit.
    """
    return values if gap <= 0.0 else np.asarray(_play(values, 0.5 * gap))


def steadied(values: Array, noise: float, window: float) -> Array:
    """(N,) means over samples that are near in time and differ by no more than noise, so that steps stay (Tomasi 1998).

    Args:
        values: (N,) in the channel's unit.
        noise: standard deviation, likewise.
        window: samples over which the mean goes (sd of its weights).
    """
    return np.asarray(_bilateral(values, NOISES_APART * noise, window))


def stuck_from(time_s: Array, values: Array, share: float) -> Array:
    """The last ``share`` of the record stands at the value it had when that began.

    Args:
        time_s: (N,) seconds.
        values: (N,) in the channel's unit.
        share: of the record's time.
    """
    if share <= 0.0:
        return values
    since_s = time_s[-1] - share * (time_s[-1] - time_s[0])
    return np.where(time_s > since_s, np.interp(since_s, time_s, values), values)


def _gaps(time_s: Array) -> Array:
    """Seconds that each sample holds, (N,); the last as long as the one before."""
    gaps = np.diff(time_s)
    return np.append(gaps, gaps[-1] if len(gaps) else 1.0)


@njit(VECTOR(VECTOR, VECTOR, types.float64), cache=True, error_model="numpy")
def _lag_lines(gaps_s, values, tau_s):  # type: ignore[no-untyped-def]
    out = values.copy()
    for k in range(gaps_s.size):
        trail = tau_s * (values[k + 1] - values[k]) / gaps_s[k]  # how far a ramp is followed behind
        out[k + 1] = values[k + 1] - trail + np.exp(-gaps_s[k] / tau_s) * (out[k] - values[k] + trail)
    return out


@njit(VECTOR(VECTOR, VECTOR), cache=True, error_model="numpy")
def _behind(values, kept):  # type: ignore[no-untyped-def]
    """How far the lagged signal is from each step as it begins."""
    out = np.zeros(values.size)
    for k in range(values.size - 1):
        out[k + 1] = values[k] + kept[k] * out[k] - values[k + 1]
    return out


@njit(VECTOR(VECTOR, types.float64, types.float64), cache=True, error_model="numpy")
def _bilateral(values, apart, window):  # type: ignore[no-untyped-def]
    out, reach = values.copy(), int(np.ceil(3.0 * window))
    near = np.exp(-0.5 * (np.arange(reach + 1) / window) ** 2)
    for k in range(values.size):
        total = weights = 0.0
        for j in range(max(0, k - reach), min(values.size, k + reach + 1)):
            w = near[abs(j - k)] * np.exp(-0.5 * ((values[j] - values[k]) / apart) ** 2)
            total += w * values[j]
            weights += w
        out[k] = total / weights
    return out


@njit(VECTOR(VECTOR, types.float64), cache=True, error_model="numpy")
def _play(values, half):  # type: ignore[no-untyped-def]
    out = values.copy()
    for k in range(1, values.size):
        out[k] = min(max(out[k - 1], values[k] - half), values[k] + half)
    return out
