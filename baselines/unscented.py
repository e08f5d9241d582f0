"""Unscented Kalman filter, compiled: sigma points, their moments, the correction. B machines at once.

Merwe's scaled sigma points (van der Merwe, 2004) with beta = 2 and kappa = 0, redrawn after the
prediction as filterpy does.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numba import njit

from twinbench.machines.coordinates import Array
from twinbench.methods.kalman import cholesky_solve


def weights(size: int, alpha: float) -> tuple[Array, Array]:
    """Weights (2 size + 1,) of the mean and of the covariance."""
    spread = alpha**2 * size
    mean = np.full(2 * size + 1, 0.5 / spread)
    mean[0] = 1.0 - size / spread
    cov = mean.copy()
    cov[0] += 1.0 - alpha**2 + 2.0
    return mean, cov


@njit(cache=True, error_model="numpy")
def sigma_points(z, P, alpha):  # type: ignore[no-untyped-def]
    """(B, 2n + 1, n) of means (B, n) and covariances (B, n, n): the centre, then plus, then minus."""
    batch, n = z.shape
    out = np.empty((batch, 2 * n + 1, n))
    for b in range(batch):
        L = np.linalg.cholesky(alpha**2 * n * P[b])
        out[b, 0] = z[b]
        for k in range(n):
            out[b, 1 + k] = z[b] + L[:, k]
            out[b, 1 + n + k] = z[b] - L[:, k]
    return out


@njit(cache=True, error_model="numpy")
def moments(points, w_mean, w_cov, Q):  # type: ignore[no-untyped-def]
    """Mean (B, n) and covariance (B, n, n) plus Q (n, n) of weighted points (B, 2n + 1, n)."""
    batch, count, n = points.shape
    mean, cov = np.zeros((batch, n)), np.empty((batch, n, n))
    for b in range(batch):
        for k in range(count):
            mean[b] += w_mean[k] * points[b, k]
        apart = points[b] - mean[b]
        weighted = np.empty_like(apart)
        for k in range(count):
            weighted[k] = w_cov[k] * apart[k]
        P = apart.T @ weighted + Q
        cov[b] = 0.5 * (P + P.T)
    return mean, cov


@njit(cache=True, error_model="numpy")
def correct(z, P, points, readings, measured, variance, w_mean, w_cov, clip):  # type: ignore[no-untyped-def]
    """Correct by the measurements that are there. Plain arrays, because it is compiled.

    Args:
        z: (B, n) prior mean, each in the filter's own coordinate.
        P: (B, n, n) its covariance.
        points: (B, 2n + 1, n), the prior's sigma points, as z.
        readings: (B, 2n + 1, m), what each would read, in the sensors' units.
        measured: (B, m), in the same units; NaN means missing.
        variance: (B, m) of the measurement noise, those units squared.
        w_mean: (2n + 1,) dimensionless weights of the points in a mean.
        w_cov: (2n + 1,) dimensionless weights of the points in a covariance.
        clip: innovations are bounded to this many standard deviations.

    Returns:
        z, P, innovation (B, m), S (B, m, m), NIS (B,) over the channels that are there.
    """
    batch, count, n = points.shape
    m = measured.shape[1]
    z_out, P_out = z.copy(), P.copy()
    innovation, S, nis = np.empty((batch, m)), np.empty((batch, m, m)), np.full(batch, np.nan)
    for b in range(batch):
        expected = np.zeros(m)
        for k in range(count):
            expected += w_mean[k] * readings[b, k]
        cross = np.zeros((n, m))
        S[b] = np.diag(variance[b])
        for k in range(count):
            y = readings[b, k] - expected
            for i in range(m):
                for j in range(m):
                    S[b, i, j] += w_cov[k] * y[i] * y[j]
                for j in range(n):
                    cross[j, i] += w_cov[k] * (points[b, k, j] - z[b, j]) * y[i]
        innovation[b] = measured[b] - expected
        r, bounded, solved, there = np.zeros((m, 1)), np.zeros(m), S[b].copy(), 0
        for i in range(m):
            if np.isnan(innovation[b, i]):  # a channel that nothing depends on
                solved[i, :] = 0.0
                solved[:, i] = 0.0
                solved[i, i] = 1.0
                cross[:, i] = 0.0
            else:
                limit = clip * np.sqrt(S[b, i, i])
                r[i, 0] = innovation[b, i]
                bounded[i] = min(max(innovation[b, i], -limit), limit)
                there += 1
        if there == 0:
            continue
        nis[b] = (r.T @ cholesky_solve(solved, r))[0, 0]
        K = cholesky_solve(solved, cross.T.copy()).T.copy()
        z_out[b] += K @ bounded
        P_b = P[b] - K @ solved @ K.T
        P_b = 0.5 * (P_b + P_b.T)
        values, vectors = np.linalg.eigh(P_b)
        if values[0] < 1e-14 * values[-1]:
            P_b = (vectors * np.maximum(values, 1e-14 * values[-1])) @ vectors.T
            P_b = 0.5 * (P_b + P_b.T)
        P_out[b] = P_b
    return z_out, P_out, innovation, S, nis


def linear_filter(
    F: Array, H: Array, Q: Array, R: Array, x0: Array, P0: Array
) -> Callable[[Array], tuple[Array, Array]]:
    """As ``methods.kalman.linear_filter``, by sigma points.

    Args:
        F: (n, n) how a tick moves the state, in the states' units.
        H: (m, n) slope of the readings, a sensor's unit per unit of the state.
        Q: (n, n) covariance of a tick's process noise, in the states' units squared.
        R: (m, m) covariance of the measurement noise, in the sensors' units squared; diagonal.
        x0: (n,) mean before the first prediction, each in its state's unit.
        P0: (n, n) covariance before the first prediction, in the states' units squared.
    """
    w_mean, w_cov = weights(len(x0), 0.5)
    variance = np.diag(R)[None].copy()

    def run(measured: Array) -> tuple[Array, Array]:
        x, P = x0[None], P0[None]
        means, covs = np.empty((len(measured), len(x0))), np.empty((len(measured), *P0.shape))
        for k, y in enumerate(measured):
            x, P = moments(sigma_points(x, P, 0.5) @ F.T, w_mean, w_cov, Q)
            points = sigma_points(x, P, 0.5)
            x, P, *_ = correct(x, P, points, points @ H.T, y[None], variance, w_mean, w_cov, np.inf)
            means[k], covs[k] = x[0], P[0]
        return means, covs

    return run
