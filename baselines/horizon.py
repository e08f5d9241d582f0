"""Least squares over a window of time, compiled: one Gauss-Newton step is one sweep of a smoother (Bell, 1994).

A window has K stages. The state z (n,) at the start of a stage leads to the state at its end and to what the sensors
read in between; both together are the stage's outcome (n + m,). Each stage is linear about a path, and its process
noise reaches both parts of the outcome. No matrix but that of the readings is inverted: the way back is that of Bryson
and Frazier.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from twinbench.methods.kalman import bounded, cholesky_solve, gain, joseph, symmetrise


@njit(cache=True, error_model="numpy")
def compose(T, Q, ticks):  # type: ignore[no-untyped-def]
    """The map (s, s) and the noise (s, s) of so many equal ticks, by doubling."""
    whole, noise = np.eye(len(T)), np.zeros_like(Q)
    while ticks > 0:
        if ticks % 2 == 1:
            noise = T @ noise @ T.T + Q
            whole = T @ whole
        Q = T @ Q @ T.T + Q
        T = T @ T
        ticks //= 2
    symmetrise(noise)
    return whole, noise


@njit(cache=True, error_model="numpy")
def sweep(start, P, path, outcome, A, Q, measured, variance, clip):  # type: ignore[no-untyped-def]
    """One Gauss-Newton step over a window of K stages. Plain arrays, because it is compiled.

    Args:
        start: (n,) the arrival cost's mean, in the filter's coordinates.
        P: (n, n) its covariance.
        path: (K, n) where each stage was linearised, at its start; is moved by the step.
        outcome: (K, n + m) what followed there: the state at the end, what the sensors read without white noise.
        A: (K, n + m, n) slope of the outcome.
        Q: (K, n + m, n + m) covariance of what the stage's process noise does to the outcome.
        measured: (K, m) in the sensors' units; NaN means missing.
        variance: (K, m) of the measurement noise, those units squared.
        clip: innovations are bounded to this many standard deviations.

    Returns:
        Mean (K + 1, n) and covariance (K + 1, n, n) at every node, given the readings up to there; the last is the
        estimate.
    """
    count, n = path.shape
    size, m = outcome.shape[1], measured.shape[1]
    z, covs = np.empty((count + 1, n)), np.empty((count + 1, n, n))
    z[0], covs[0] = start, P
    gains, told = np.empty((count, size, m)), np.zeros((count, m))
    H = np.zeros((m, size))
    H[:, n:] = np.eye(m)
    for i in range(count):
        ahead = outcome[i] + A[i] @ (z[i] - path[i])
        wide = A[i] @ covs[i] @ A[i].T + Q[i]
        symmetrise(wide)
        innovation, R = measured[i] - ahead[n:], np.diag(variance[i])
        gains[i], S, nis = gain(wide, innovation, H, R)
        if not np.isnan(nis):
            r = bounded(innovation, S, clip)
            ahead += gains[i] @ r
            wide = joseph(wide, gains[i], H, R)
            for c in range(m):
                if np.isnan(innovation[c]):
                    S[c, :] = 0.0
                    S[:, c] = 0.0
                    S[c, c] = 1.0
            told[i] = cholesky_solve(S, r.reshape(-1, 1))[:, 0]
        z[i + 1], covs[i + 1] = ahead[:n], wide[:n, :n]
    pull = np.zeros(n)
    for i in range(count - 1, -1, -1):
        back = np.zeros(size)
        back[:n] = pull
        back[n:] = -told[i] - gains[i][:n].T @ pull
        pull = A[i].T @ back
        path[i] = z[i] - covs[i] @ pull
    return z, covs
