"""A Kalman filter whose gain is said by somebody else: its equations, compiled.

z is that of the nominal EKF (``baselines.augmented_model``), and so are the linearised model and outputs. The gain is
dimensionless, one entry per entry of z and output: K is it times the standard deviation of the entry over that of the
innovation. So a gain of one moves an entry by its standard deviation for an innovation of one of its own. The
covariance is Joseph's, which holds under any gain.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

from twinbench.baselines.augmented_model import Filter, bound
from twinbench.baselines.features import FEATURE_LIMIT
from twinbench.machines.coordinates import Array
from twinbench.methods.kalman import INNOVATION_CLIP_SD, bounded, symmetrise

SD_LIMIT = 3.0
"""No standard deviation is more than so many times what it was before the first sample: a gain that was never tried on
such readings may inflate the covariance without end. Results depend on it under faults alone."""
LOG_SPAN = 3.0
"""Logarithms of standard deviations are divided by this for the network: what it reads is of order one."""
GAIN_SPAN = 4.0
"""A gain is held within so many times the root mean square of the Kalman filter's own. Twice as much was not tried."""
NOISE_SPAN = 4.0
"""Logarithms of the noise's scales are held within this: a factor of fifty on variances, more than any model was seen
to ask for."""


class Rules(NamedTuple):
    """What the filter is told besides the gain.

    Attributes:
        model: the equations' constants.
        unit: (n,) standard deviation before the first sample, in the unit of each entry of z.
    """

    model: Filter
    unit: Array


def width(size: int, outputs: int, channels: int) -> int:
    """How many numbers ``seen`` gives, of z with so many entries."""
    return 2 * outputs + channels + size


@njit(cache=True, error_model="numpy")
def seen(rules, values, innovation, S, P):  # type: ignore[no-untyped-def]
    """What the network reads: innovations in their deviations, which are there, readings, deviations of z.

    The function takes plain arrays because it is compiled.

    Args:
        values: (nu + ny,) standardised readings.
        innovation: (ny,) in the outputs' units, NaN where missing.
        S: (ny, ny) its covariance.
        P: (n, n) covariance of z before the correction.
    """
    ny, channels = innovation.size, values.size
    out = np.zeros(2 * ny + channels + P.shape[0])
    for i in range(ny):
        if not np.isnan(innovation[i]):
            out[i] = min(max(innovation[i] / np.sqrt(S[i, i]), -INNOVATION_CLIP_SD), INNOVATION_CLIP_SD)
            out[ny + i] = 1.0
    for c in range(channels):
        out[2 * ny + c] = min(max(values[c], -FEATURE_LIMIT), FEATURE_LIMIT)
    for j in range(P.shape[0]):
        out[2 * ny + channels + j] = np.log(np.sqrt(P[j, j]) / rules.unit[j]) / LOG_SPAN
    return out


@njit(cache=True, error_model="numpy")
def correct(rules, z, P, innovation, H, R, S, G):  # type: ignore[no-untyped-def]
    """z (n,) and P (n, n) after a correction by the dimensionless gain G (n, ny); missing channels correct nothing.

    The function takes plain arrays because it is compiled.
    """
    K = np.zeros(G.shape)
    for i in range(innovation.size):
        if not np.isnan(innovation[i]):
            for j in range(z.size):
                K[j, i] = G[j, i] * np.sqrt(P[j, j] / S[i, i])
    z = z + K @ bounded(innovation, S, INNOVATION_CLIP_SD)
    A = np.eye(z.size) - K @ H
    P = A @ P @ A.T + K @ R @ K.T
    for j in range(z.size):
        share = min(1.0, SD_LIMIT * rules.unit[j] / np.sqrt(P[j, j]))
        P[j, :] *= share
        P[:, j] *= share
    symmetrise(P)
    bound(rules.model, z)
    return z, P
