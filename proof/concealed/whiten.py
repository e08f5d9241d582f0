"""From readings to innovations: what is new in them, in sds of what is new in the noise."""

from __future__ import annotations

import numpy as np
from scipy.signal import lfilter

from twinbench.physics.simulator import Array
from twinbench.proof.concealed.machine import Noise

_RICCATI_ROUNDS, _RICCATI_CLOSE = 2000, 1e-13
"""The filter's variance is iterated until it stays, so closely, and no longer than so."""


def whitened(noise: Noise, lsb: float, period_s: float, series: Array) -> Array:
    """Innovations (..., N) of series (..., N) under white and AR(1) noise and steps of quantisation.

    The steady filter of the coloured part: K its gain, P its variance ahead, S that of the innovation.

    Args:
        noise: the channel's.
        lsb: its step, in its unit.
        period_s: between samples.
        series: (..., N) in the channel's unit.
    """
    white = noise.white**2 + lsb**2 / 12.0
    if noise.coloured <= 0.0:
        return series / np.sqrt(white)
    keep = np.exp(-period_s / noise.tau_s)
    P = noise.coloured**2
    for _ in range(_RICCATI_ROUNDS):
        ahead = keep**2 * P * white / (P + white) + noise.coloured**2 * (1.0 - keep**2)
        if abs(ahead - P) < _RICCATI_CLOSE * P:
            break
        P = ahead
    K, S = P / (P + white), P + white
    predicted = lfilter([0.0, keep * K], [1.0, -keep * (1.0 - K)], series, axis=-1)
    return np.asarray((series - predicted) / np.sqrt(S))
