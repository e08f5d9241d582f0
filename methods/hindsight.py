"""What is known of a tick later: the Rauch-Tung-Striebel pass over a filter's own forecasts and corrections.

Rauch, Tung and Striebel, AIAA Journal 3, 1965. Compiled, one machine at a time.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

from twinbench.machines.coordinates import Array
from twinbench.methods.kalman import cholesky_solve, symmetrise


class Pass(NamedTuple):
    """A forward pass over N ticks of one machine.

    Attributes:
        ahead: (N, n) means before the correction, in the units of z; of the first tick the prior.
        ahead_cov: (N, n, n) their covariances, in those units squared.
        z: (N, n) means after it, in the units of z.
        P: (N, n, n) their covariances, in those units squared.
        F: (N, n, n) slope that led to each tick from the one before, in the units of z.
    """

    ahead: Array
    ahead_cov: Array
    z: Array
    P: Array
    F: Array


def empty_pass(ticks: int, n: int) -> Pass:
    """Room for so many ticks of n entries of z."""
    square = (ticks, n, n)
    z, P = np.empty((ticks, n)), np.empty(square)
    return Pass(np.empty((ticks, n)), np.empty(square), z, P, np.zeros(square))


@njit(cache=True, error_model="numpy")
def look_back(kept):  # type: ignore[no-untyped-def]
    """``kept.z`` and ``kept.P`` become what all of the pass says of each tick, in place."""
    n = kept.z.shape[1]
    sd, scaled, FP = np.empty(n), np.empty((n, n)), np.empty((n, n))
    for k in range(kept.z.shape[0] - 2, -1, -1):
        cov = kept.ahead_cov[k + 1]
        for i in range(n):  # bar and kelvin: solved in units of one sd each
            sd[i] = np.sqrt(cov[i, i])
        FP[:, :] = kept.F[k + 1] @ kept.P[k]
        for i in range(n):
            for j in range(n):
                scaled[i, j] = cov[i, j] / (sd[i] * sd[j])
                FP[i, j] /= sd[i]
        G = cholesky_solve(scaled, FP).T.copy()
        for i in range(n):
            for j in range(n):
                G[i, j] /= sd[j]
        kept.z[k] += G @ (kept.z[k + 1] - kept.ahead[k + 1])
        kept.P[k] += G @ (kept.P[k + 1] - cov) @ G.T
        symmetrise(kept.P[k])
