"""Kalman building blocks, compiled: covariance propagation and the Joseph update.

One machine at a time; the estimators loop over their batch. No inverse is formed: the innovation
covariance is factorised by Cholesky and solved.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numba import njit

from twinbench.machines.coordinates import Array

INNOVATION_CLIP_SD = 6.0
"""Filters bound innovations to so many standard deviations: larger ones are faults, which must not move health."""


@njit(cache=True, error_model="numpy")
def predict_covariance(P, F, Q):  # type: ignore[no-untyped-def]
    """Eq. (7): ``F P F' + Q``, symmetrised. Shapes (n, n)."""
    P = F @ P @ F.T + Q
    return 0.5 * (P + P.T)


@njit(cache=True, error_model="numpy")
def multiply_into(A, P, rows, AP):  # type: ignore[no-untyped-def]
    """The leading ``rows`` of ``A P`` into those of AP, for an A of which few entries are not zero."""
    for i in range(rows):
        for j in range(AP.shape[1]):
            AP[i, j] = 0.0
        for k in range(A.shape[1]):
            if A[i, k] != 0.0:
                for j in range(AP.shape[1]):
                    AP[i, j] += A[i, k] * P[k, j]


@njit(cache=True, error_model="numpy")
def carry_into(P, F, moving, FP):  # type: ignore[no-untyped-def]
    """``F P F'`` in P's place, for an F whose rows from ``moving`` on have nothing off the diagonal.

    The function takes plain arrays because it is compiled.

    Args:
        FP: (n, n) scratch.
    """
    n = len(P)
    multiply_into(F, P, moving, FP)
    for i in range(moving, n):
        for j in range(moving):
            P[i, j] = P[j, i] = F[i, i] * FP[j, i]
        for j in range(moving, i + 1):
            P[i, j] = P[j, i] = F[i, i] * F[j, j] * P[i, j]
    for i in range(moving):
        for j in range(i + 1):
            carried = 0.0
            for k in range(n):
                carried += FP[i, k] * F[j, k]
            P[i, j] = P[j, i] = carried


@njit(cache=True, error_model="numpy")
def factorise(S, m):  # type: ignore[no-untyped-def]
    """The lower Cholesky factor of S's leading (m, m), in its place; small m, written out."""
    for i in range(m):
        diagonal = S[i, i]
        for j in range(i + 1):
            s = S[i, j]
            for k in range(j):
                s -= S[i, k] * S[j, k]
            # The floor keeps a factor when round-off has eaten the last of a pivot.
            S[i, j] = np.sqrt(max(s, 1e-14 * diagonal)) if i == j else s / S[j, j]


@njit(cache=True, error_model="numpy")
def substitute(L, m, X):  # type: ignore[no-untyped-def]
    """``X <- S^-1 X`` in the leading m rows of X, with L from ``factorise``."""
    for i in range(m):
        for k in range(i):
            for c in range(X.shape[1]):
                X[i, c] -= L[i, k] * X[k, c]
        for c in range(X.shape[1]):
            X[i, c] /= L[i, i]
    for i in range(m - 1, -1, -1):
        for k in range(i + 1, m):
            for c in range(X.shape[1]):
                X[i, c] -= L[k, i] * X[k, c]
        for c in range(X.shape[1]):
            X[i, c] /= L[i, i]


@njit(cache=True, error_model="numpy")
def cholesky_solve(S, B):  # type: ignore[no-untyped-def]
    """X with ``S X = B`` for symmetric positive definite S (m, m), B (m, n)."""
    L, X = S.copy(), B.copy()
    factorise(L, len(S))
    substitute(L, len(S), X)
    return X


@njit(cache=True, error_model="numpy")
def innovation_cov_into(P, H, R, S, HP):  # type: ignore[no-untyped-def]
    """Eq. (8): ``S = H P H' + R`` into S (m, m), ``H P`` into HP (m, n)."""
    m_all = R.shape[0]
    multiply_into(H, P, m_all, HP)
    for a in range(m_all):
        for b in range(m_all):
            S[a, b] = R[a, b]
            for k in range(P.shape[0]):
                S[a, b] += HP[a, k] * H[b, k]


@njit(cache=True, error_model="numpy")
def gain_into(P, innovation, H, R, K, S, HP, L, X):  # type: ignore[no-untyped-def]
    """``gain`` written into K and S; HP (m, n), which keeps ``H P``, L (m, m) and X (m, n) are scratch. Returns NIS.

    The function takes plain arrays because it is compiled.
    """
    innovation_cov_into(P, H, R, S, HP)
    return solve_gain_into(innovation, S, HP, K, L, X)


@njit(cache=True, error_model="numpy")
def solve_gain_into(innovation, S, HP, K, L, X):  # type: ignore[no-untyped-def]
    """``gain_into`` from what ``innovation_cov_into`` left in S and HP. Returns NIS."""
    n, m_all = HP.shape[1], innovation.size
    m = 0
    for a in range(m_all):
        for j in range(n):
            K[j, a] = 0.0
        if np.isnan(innovation[a]):
            continue
        # What is there moves to the front, in order; rows before it are done with.
        i = 0
        for b in range(a + 1):
            if not np.isnan(innovation[b]):
                L[m, i] = S[a, b]
                i += 1
        for j in range(n):
            X[m, j] = HP[a, j]
        m += 1
    if m == 0:
        return np.nan
    factorise(L, m)
    substitute(L, m, X)
    m = 0
    for a in range(m_all):
        if not np.isnan(innovation[a]):
            for j in range(n):
                K[j, a] = X[m, j]
            X[m, 0] = innovation[a]
            m += 1
    nis = 0.0
    for i in range(m):
        for k in range(i):
            X[i, 0] -= L[i, k] * X[k, 0]
        X[i, 0] /= L[i, i]
        nis += X[i, 0] * X[i, 0]
    return nis


@njit(cache=True, error_model="numpy")
def gain(P, innovation, H, R):  # type: ignore[no-untyped-def]
    """Eqs. (8), (9) and (12) with the measurements that are there.

    Args:
        P: (n, n) prior covariance, in the units of the state squared.
        innovation: (m,) measured minus predicted, in the sensors' units; NaN means missing.
        H: (m, n) slope of the readings, a sensor's unit per unit of the state.
        R: (m, m) covariance of the measurement noise, in the sensors' units squared.

    Returns:
        K (n, m), zero in the columns of missing channels; S (m, m) of all channels; NIS over those
        that are there, NaN if none.
    """
    m, n = H.shape
    K, S = np.empty((n, m)), np.empty((m, m))
    nis = gain_into(P, innovation, H, R, K, S, np.empty((m, n)), np.empty((m, m)), np.empty((m, n)))
    return K, S, nis


@njit(cache=True, error_model="numpy")
def bound_into(innovation, S, clip, out):  # type: ignore[no-untyped-def]
    """``bounded`` written into ``out``."""
    for i in range(innovation.size):
        limit = clip * np.sqrt(S[i, i])
        out[i] = 0.0 if np.isnan(innovation[i]) else min(max(innovation[i], -limit), limit)


@njit(cache=True, error_model="numpy")
def bounded(innovation, S, clip):  # type: ignore[no-untyped-def]
    """Innovations (m,) within ``clip`` standard deviations; 0 where missing."""
    out = np.empty(innovation.size)
    bound_into(innovation, S, clip, out)
    return out


@njit(cache=True, error_model="numpy")
def joseph_into(P, K, H, R, HP, X):  # type: ignore[no-untyped-def]
    """``joseph`` in P's place: ``(I - K H) P (I - K H)' + K R K'``, the products of rank m.

    The function takes plain arrays because it is compiled.

    Args:
        HP: (m, n) ``H P`` of the prior; K' is written there, whose rows are read quicker than columns of K.
        X: (m, n) scratch.
    """
    n, m = K.shape
    for i in range(n):
        for a in range(m):
            for j in range(n):
                P[i, j] -= K[i, a] * HP[a, j]
    for a in range(m):
        for i in range(n):
            X[a, i], HP[a, i] = 0.0, K[i, a]
            for b in range(m):
                X[a, i] += K[i, b] * R[b, a]
        for k in range(n):
            if H[a, k] != 0.0:  # few are not
                for i in range(n):
                    X[a, i] -= P[i, k] * H[a, k]
    for i in range(n):
        for a in range(m):
            for j in range(n):
                P[i, j] += X[a, i] * HP[a, j]
    symmetrise(P)


@njit(cache=True, error_model="numpy")
def symmetrise(P):  # type: ignore[no-untyped-def]
    """In place."""
    for i in range(len(P)):
        for j in range(i):
            P[i, j] = P[j, i] = 0.5 * (P[i, j] + P[j, i])


@njit(cache=True, error_model="numpy")
def joseph(P, K, H, R):  # type: ignore[no-untyped-def]
    """Eq. (11): posterior covariance under any gain K, symmetrised."""
    P, HP = P.copy(), H @ P
    joseph_into(P, K, H, R, HP, np.empty_like(H))
    return P


@njit(cache=True, error_model="numpy")
def room_for(n, m):  # type: ignore[no-untyped-def]
    """Scratch of one correction of n states by m readings: K, S, ``H P``, two of ``gain_into`` and bounded innovations.

    The function takes plain numbers because it is compiled.
    """
    return np.empty((n, m)), np.empty((m, m)), np.empty((m, n)), np.empty((m, m)), np.empty((m, n)), np.empty(m)


@njit(cache=True, error_model="numpy")
def update_into(z, P, innovation, H, R, clip, room):  # type: ignore[no-untyped-def]
    """``update`` in the place of z and P; ``room`` is of ``room_for``, and keeps S. Returns NIS.

    The function takes plain arrays because it is compiled.
    """
    K, S, HP, L, X, r = room
    nis = gain_into(P, innovation, H, R, K, S, HP, L, X)
    if not np.isnan(nis):
        bound_into(innovation, S, clip, r)
        for i in range(z.size):
            for a in range(r.size):
                z[i] += K[i, a] * r[a]
        joseph_into(P, K, H, R, HP, X)
    return nis


@njit(cache=True, error_model="numpy")
def update(z, P, innovation, H, R, clip):  # type: ignore[no-untyped-def]
    """Correct by the measurements that are there, Eqs. (8)-(12).

    Args:
        z: (n,) prior mean, each in its state's unit.
        P: (n, n) prior covariance, in the units of the state squared.
        innovation: (m,) measured minus predicted, in the sensors' units; NaN means missing.
        H: (m, n) slope of the readings, a sensor's unit per unit of the state.
        R: (m, m) covariance of the measurement noise, in the sensors' units squared.
        clip: innovations are bounded to this many standard deviations before the correction, so
            that one bad sample moves little and a lasting shift still gets through; inf for never.

    Returns:
        z (n,), P (n, n) posterior in Joseph form, S (m, m) of all channels, NIS over the channels
        that are there (NaN if none).
    """
    z, P, room = z.copy(), P.copy(), room_for(z.size, innovation.size)
    nis = update_into(z, P, innovation, H, R, clip, room)
    return z, P, room[1], nis


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
        F: (n, n) how a tick moves the state, in the states' units.
        H: (m, n) slope of the readings, a sensor's unit per unit of the state.
        Q: (n, n) covariance of a tick's process noise, in the states' units squared.
        R: (m, m) covariance of the measurement noise, in the sensors' units squared.
        x0: (n,) mean before the first prediction, each in its state's unit.
        P0: (n, n) covariance before the first prediction, in the states' units squared.

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
