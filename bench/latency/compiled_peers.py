"""The peers of ``bench.latency.peers`` wholly compiled: what is left for anybody's own method to beat."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numba import njit

from twinbench.baselines.unscented import correct, moments, sigma_points, weights
from twinbench.bench.latency.peers import ALPHA, DIFFERENCE_STEP, SIZE, Q, numba_move, numba_observe, start
from twinbench.data.batch import Array
from twinbench.methods.kalman import predict_covariance, update
from twinbench.methods.noise import output_sd_of

W_MEAN, W_COV = weights(SIZE, ALPHA)


@njit(error_model="numpy")
def _variance(readings):  # type: ignore[no-untyped-def]
    white, coloured = np.empty(3), np.empty(3)
    output_sd_of(readings, white, coloured)
    return white**2 + coloured**2


@njit(error_model="numpy")
def ekf(z, P, before, readings):  # type: ignore[no-untyped-def]
    """One tick of the extended Kalman filter: z (10,), P (10, 10), last inputs (4,), readings (7,)."""
    u, n = readings[:4].copy(), z.size
    ahead, F, H = numba_move(z, before), np.empty((n, n)), np.empty((3, n))
    for j in range(n):
        moved = z.copy()
        moved[j] += DIFFERENCE_STEP[j]
        F[:, j] = (numba_move(moved, before) - ahead) / DIFFERENCE_STEP[j]
    y = numba_observe(ahead, u)
    for j in range(n):
        moved = ahead.copy()
        moved[j] += DIFFERENCE_STEP[j]
        H[:, j] = (numba_observe(moved, u) - y) / DIFFERENCE_STEP[j]
    P = predict_covariance(P, F, Q)
    z, P, _, _ = update(ahead, P, readings[4:] - y, H, np.diag(_variance(readings)), np.inf)
    return z, P


@njit(error_model="numpy")
def ukf(z, P, before, readings):  # type: ignore[no-untyped-def]
    """One tick of the unscented Kalman filter, arguments as of ``ekf``."""
    u = readings[:4].copy()
    points = sigma_points(z.reshape(1, -1), P.reshape(1, z.size, -1), ALPHA)
    for k in range(points.shape[1]):
        points[0, k] = numba_move(points[0, k], before)
    mean, cov = moments(points, W_MEAN, W_COV, Q)
    points = sigma_points(mean, cov, ALPHA)
    read = np.empty((1, points.shape[1], 3))
    for k in range(points.shape[1]):
        read[0, k] = numba_observe(points[0, k], u)
    measured, R = readings[4:].copy().reshape(1, 3), _variance(readings).reshape(1, 3)
    mean, cov, _, _, _ = correct(mean, cov, points, read, measured, R, W_MEAN, W_COV, np.inf)
    return mean[0], cov[0]


class CompiledPeer:
    """One of the two, one call an update.

    Args:
        first: (7,) in the channels' units, order CHANNELS, none missing.
        tick: ``ekf`` or ``ukf``.
    """

    def __init__(self, first: Array, tick: Callable[..., tuple[Array, Array]]) -> None:
        self._tick, self._u = tick, first[:4].copy()
        self.mean, self.cov = start(first)

    def update(self, readings: Array) -> None:
        """One tick of readings (7,), none missing.

        Args:
            readings: (7,) in the channels' units, order CHANNELS, none missing.
        """
        self.mean, self.cov = self._tick(self.mean, self.cov, self._u, readings)
        self._u = readings[:4].copy()
