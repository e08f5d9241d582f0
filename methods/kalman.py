"""Kalman building blocks, compiled: covariance propagation and the Joseph update.

One machine at a time; the estimators loop over their batch. No inverse is formed: the innovation
covariance is factorised by Cholesky and solved.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numba import njit

from data.batch import Array


@njit(cache=True, error_model="numpy")
def predict_covariance(P, F, Q):  # type: ignore[no-untyped-def]
    """Eq. (7): ``F P F' + Q``, symmetrised. Shapes (n, n)."""
    P = F @ P @ F.T + Q
    return 0.5 * (P + P.T)


@njit(cache=True, error_model="numpy")
def cholesky_solve(S, B):  # type: ignore[no-untyped-def]
    """X with ``S X = B`` for symmetric positive definite S (m, m), B (m, n); small m, written out."""
    m, n = B.shape
    L = np.zeros((m, m))
    for i in range(m):
        for j in range(i + 1):
            s = S[i, j]
            for k in range(j):
                s -= L[i, k] * L[j, k]
            # The floor keeps a factor when round-off has eaten the last of a pivot.
            L[i, j] = np.sqrt(max(s, 1e-14 * S[i, i])) if i == j else s / L[j, j]
    X = np.empty((m, n))
    for c in range(n):
        for i in range(m):
            s = B[i, c]
            for k in range(i):
                s -= L[i, k] * X[k, c]
            X[i, c] = s / L[i, i]
        for i in range(m - 1, -1, -1):
            s = X[i, c]
            for k in range(i + 1, m):
                s -= L[k, i] * X[k, c]
            X[i, c] = s / L[i, i]
    return X


@njit(cache=True, error_model="numpy")
def gain(P, innovation, H, R):  # type: ignore[no-untyped-def]
    """Eqs. (8), (9) and (12) with the measurements that are there.

    Args:
        P, H, R: (n, n), (m, n), (m, m).
        innovation: (m,) measured minus predicted; NaN means missing.

    Returns:
        K (n, m), zero in the columns of missing channels; S (m, m) of all channels; NIS over those
        that are there, NaN if none.
    """
    n, m_all = P.shape[0], innovation.size
    S_all = H @ P @ H.T + R
    m = 0
    rows = np.empty(m_all, np.int64)
    for i in range(m_all):
        if not np.isnan(innovation[i]):
            rows[m] = i
            m += 1
    K = np.zeros((n, m_all))
    if m == 0:
        return K, S_all, np.nan
    r = np.empty((m, 1))
    Hm = np.empty((m, n))
    S = np.empty((m, m))
    for a in range(m):
        r[a, 0] = innovation[rows[a]]
        for j in range(n):
            Hm[a, j] = H[rows[a], j]
        for b in range(m):
            S[a, b] = S_all[rows[a], rows[b]]
    nis = (r.T @ cholesky_solve(S, r))[0, 0]
    transposed = cholesky_solve(S, Hm @ P)
    for a in range(m):
        for j in range(n):
            K[j, rows[a]] = transposed[a, j]
    return K, S_all, nis


@njit(cache=True, error_model="numpy")
def bounded(innovation, S, clip):  # type: ignore[no-untyped-def]
    """Innovations (m,) within ``clip`` standard deviations; 0 where missing."""
    out = np.zeros(innovation.size)
    for i in range(innovation.size):
        if not np.isnan(innovation[i]):
            limit = clip * np.sqrt(S[i, i])
            out[i] = min(max(innovation[i], -limit), limit)
    return out


@njit(cache=True, error_model="numpy")
def joseph(P, K, H, R):  # type: ignore[no-untyped-def]
    """Eq. (11): posterior covariance under any gain K, symmetrised."""
    A = np.eye(P.shape[0]) - K @ H
    P = A @ P @ A.T + K @ R @ K.T
    return 0.5 * (P + P.T)


@njit(cache=True, error_model="numpy")
def update(z, P, innovation, H, R, clip):  # type: ignore[no-untyped-def]
    """Correct by the measurements that are there, Eqs. (8)-(12).

    Args:
        z, P: (n,), (n, n) prior.
        innovation: (m,) measured minus predicted; NaN means missing.
        H, R: (m, n), (m, m).
        clip: innovations are bounded to this many standard deviations before the correction, so
            that one bad sample moves little and a lasting shift still gets through; inf for never.

    Returns:
        z (n,), P (n, n) posterior in Joseph form, S (m, m) of all channels, NIS over the channels
        that are there (NaN if none).
    """
    K, S, nis = gain(P, innovation, H, R)
    if np.isnan(nis):
        return z.copy(), P.copy(), S, nis
    return z + K @ bounded(innovation, S, clip), joseph(P, K, H, R), S, nis


@njit(cache=True, error_model="numpy")
def update_all(z, P, innovation, H, R, clip):  # type: ignore[no-untyped-def]
    """``update`` for B machines: every argument with a leading axis. Returns z, P, S (B, m, m), NIS (B,)."""
    batch, m = innovation.shape
    z_out, P_out = np.empty_like(z), np.empty_like(P)
    S, nis = np.empty((batch, m, m)), np.empty(batch)
    for b in range(batch):
        z_out[b], P_out[b], S[b], nis[b] = update(z[b], P[b], innovation[b], H[b], R[b], clip)
    return z_out, P_out, S, nis


def linear_filter(
    F: Array, H: Array, Q: Array, R: Array, x0: Array, P0: Array
) -> Callable[[Array], tuple[Array, Array]]:
    """These blocks on a linear-Gaussian machine, for comparison with the textbook.

    Args:
        F, H, Q, R: (n, n), (m, n), (n, n), (m, m).
        x0, P0: (n,), (n, n) before the first prediction.

    Returns:
        A function from measurements (N, m), NaN where missing, to means (N, n) and covariances (N, n, n).
    """

    def run(measured: Array) -> tuple[Array, Array]:
        x, P = x0, P0
        means, covs = np.empty((len(measured), len(x0))), np.empty((len(measured), *P0.shape))
        for k, y in enumerate(measured):
            x, P = F @ x, predict_covariance(P, F, Q)
            x, P, _, _ = update(x, P, y - H @ x, H, R, np.inf)
            means[k], covs[k] = x, P
        return means, covs

    return run
