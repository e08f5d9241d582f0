"""A run linearised along its own path: what small changes of rates and start states do to the readings.

Every stretch of a run becomes four small matrices, made once. A column, the change of the readings with whatever
acts on the rates, is then one pass over them: no forward run is needed for it, however many columns there are.
"""

from __future__ import annotations

import numpy as np
from numba import njit, types
from numba.extending import register_jitable

from twinbench.mismatch.march import advance_stretch
from twinbench.physics.integrate import INDICES, MATRIX
from twinbench.physics.jit import FUNCTION, VECTOR

CUBE = types.Array(types.float64, 3, "C")
SUMMED_BELOW = 0.5
"""Norm up to which the exponential's series is summed; larger matrices are halved until they are as small.
Six terms then leave a relative error of 1e-6; more would change nothing."""
TERMS = 7
NUDGE = 1e-4
"""Step of a difference quotient in a state, in scales of it: far above rounding, far below any curvature."""


@register_jitable
def _product(a, b, out):  # type: ignore[no-untyped-def]
    for i in range(a.shape[0]):
        for j in range(b.shape[1]):
            total = 0.0
            for k in range(b.shape[0]):
                total += a[i, k] * b[k, j]
            out[i, j] = total


@register_jitable
def _exponential(A, h, E, G, X, term, spare):  # type: ignore[no-untyped-def]
    """``E = exp(A h)`` and ``G``, the integral of ``exp(A s)`` over s from 0 to h, by scaling and doubling."""
    n = A.shape[0]
    norm = 0.0
    for i in range(n):
        row = 0.0
        for j in range(n):
            row += abs(A[i, j])
        norm = max(norm, row)
    doublings = 0
    while norm * h > SUMMED_BELOW and doublings < 60:
        h *= 0.5
        doublings += 1
    for i in range(n):
        for j in range(n):
            X[i, j] = A[i, j] * h
            term[i, j] = h if i == j else 0.0
            G[i, j] = term[i, j]
    for k in range(2, TERMS + 1):
        _product(X, term, spare)
        for i in range(n):
            for j in range(n):
                term[i, j] = spare[i, j] / k
                G[i, j] += term[i, j]
    _product(A, G, E)
    for i in range(n):
        E[i, i] += 1.0
    for _ in range(doublings):
        for i in range(n):
            E[i, i] += 1.0
        _product(E, G, spare)
        for i in range(n):
            for j in range(n):
                G[i, j] = spare[i, j]
            E[i, i] -= 1.0
        _product(E, E, spare)
        for i in range(n):
            for j in range(n):
                E[i, j] = spare[i, j]


@njit(
    types.void(FUNCTION, MATRIX, VECTOR, VECTOR, VECTOR, INDICES, MATRIX, types.float64, MATRIX, VECTOR, MATRIX),
    cache=True,
    error_model="numpy",
    nogil=True,
)
def path(rhs, u, seconds, x0, theta, varying, values, step_s, scheme, limit, means):  # type: ignore[no-untyped-def]
    """The mean states (S, nx) of stretches; NaN from where the run diverges. Arguments as of ``march``."""
    theta = theta.copy()
    x, mean = x0.copy(), np.empty(x0.size)
    work = np.empty((4, x.size))
    means[:] = np.nan
    for k in range(u.shape[0]):
        for j in range(varying.size):
            theta[varying[j]] = values[k, j]
        if not advance_stretch(rhs, x, u[k], theta, seconds[k], step_s, scheme, limit, work, mean):
            return
        means[k] = mean


@njit(
    types.void(
        FUNCTION, FUNCTION, MATRIX, VECTOR, INDICES, MATRIX, VECTOR, INDICES, MATRIX, INDICES, VECTOR, CUBE, CUBE, CUBE,
        CUBE,
    ),
    cache=True,
    error_model="numpy",
    nogil=True,
)  # fmt: skip
def stretches(rhs, output, u, seconds, samples, means, theta, varying, values, active, scales, E, G, Yx, Yf):  # type: ignore[no-untyped-def]
    """The matrices of each stretch, frozen at its mean state.

    A change dx (na,) of the active states and a change d (na,) of their rates throughout a stretch make a change
    ``E dx + G d`` at its end and change the mean of its readings by ``Yx dx + Yf d``.

    Shapes are u (S, nu), seconds and samples (S,), means (S, nx), active and scales (na,), E and G (S, na, na), Yx
    and Yf (S, ny, na).
    """
    n, ny = active.size, Yx.shape[1]
    theta = theta.copy()
    A, H = np.empty((n, n)), np.empty((ny, n))
    e, g, X, term, spare = (np.empty((n, n)), np.empty((n, n)), np.empty((n, n)), np.empty((n, n)), np.empty((n, n)))
    wx, wf, sx, sf = (np.empty((n, n)), np.empty((n, n)), np.empty((n, n)), np.empty((n, n)))
    for k in range(u.shape[0]):
        for j in range(varying.size):
            theta[varying[j]] = values[k, j]
        x = means[k].copy()
        for j in range(n):
            at, step = active[j], NUDGE * scales[j]
            kept = x[at]
            x[at] = kept + step
            ahead, read_ahead = rhs(x, u[k], theta).copy(), output(x, u[k], theta).copy()
            x[at] = kept - step
            behind, read_behind = rhs(x, u[k], theta), output(x, u[k], theta)
            x[at] = kept
            for i in range(n):
                A[i, j] = (ahead[active[i]] - behind[active[i]]) / (2.0 * step)
            for i in range(ny):
                H[i, j] = (read_ahead[i] - read_behind[i]) / (2.0 * step)
        count = max(samples[k], 1)
        _exponential(A, seconds[k] / count, e, g, X, term, spare)
        for i in range(n):
            for j in range(n):
                wx[i, j] = 1.0 if i == j else 0.0
                wf[i, j] = sx[i, j] = sf[i, j] = 0.0
        for _ in range(count):
            for i in range(n):
                for j in range(n):
                    sx[i, j] += wx[i, j] / count
                    sf[i, j] += wf[i, j] / count
            _product(e, wx, spare)
            wx[:] = spare
            _product(e, wf, spare)
            for i in range(n):
                for j in range(n):
                    wf[i, j] = spare[i, j] + g[i, j]
        E[k] = wx
        G[k] = wf
        _product(H, sx, Yx[k])
        _product(H, sf, Yf[k])


@njit(types.void(CUBE, CUBE, CUBE, CUBE, CUBE, CUBE, MATRIX, CUBE), cache=True, error_model="numpy", nogil=True)
def columns(E, G, Yx, Yf, rates, reads, start, out):  # type: ignore[no-untyped-def]
    """Changes of the readings' means, out (S, ny, K), of K changes at once.

    Args:
        E: (S, na, na) as of ``stretches``, like the next three.
        G: (S, na, na).
        Yx: (S, ny, na).
        Yf: (S, ny, na).
        rates: (S, na, K) changes of the active states' rates.
        reads: (S, ny, K) changes of the readings themselves.
        start: (na, K) changes of the start state.
    """
    n, ny, many = G.shape[1], Yx.shape[1], start.shape[1]
    dx, ahead = start.copy(), np.empty((n, many))
    for k in range(E.shape[0]):
        for i in range(ny):
            for c in range(many):
                out[k, i, c] = reads[k, i, c]
            for j in range(n):
                a, b = Yx[k, i, j], Yf[k, i, j]
                for c in range(many):
                    out[k, i, c] += a * dx[j, c] + b * rates[k, j, c]
        ahead[:] = 0.0
        for i in range(n):
            for j in range(n):
                a, b = E[k, i, j], G[k, i, j]
                for c in range(many):
                    ahead[i, c] += a * dx[j, c] + b * rates[k, j, c]
        dx, ahead = ahead, dx


@njit(types.void(CUBE, CUBE, CUBE, CUBE, MATRIX, MATRIX), cache=True, error_model="numpy", nogil=True)
def transposed(E, G, Yx, Yf, reads, rates):  # type: ignore[no-untyped-def]
    """The transpose of ``columns``: what the rates (S, na) of a change have to do with weighted readings (S, ny)."""
    n, ny = G.shape[1], Yx.shape[1]
    ahead, before = np.zeros(n), np.empty(n)
    for k in range(E.shape[0] - 1, -1, -1):
        for j in range(n):
            rates[k, j], before[j] = 0.0, 0.0
            for i in range(n):
                rates[k, j] += G[k, i, j] * ahead[i]
                before[j] += E[k, i, j] * ahead[i]
            for i in range(ny):
                rates[k, j] += Yf[k, i, j] * reads[k, i]
                before[j] += Yx[k, i, j] * reads[k, i]
        ahead, before = before, ahead


@njit(
    types.void(
        FUNCTION,
        FUNCTION,
        MATRIX,
        MATRIX,
        VECTOR,
        INDICES,
        MATRIX,
        INDICES,
        types.boolean,
        MATRIX,
        MATRIX,
        VECTOR,
        MATRIX,
        MATRIX,
    ),
    cache=True,
    error_model="numpy",
    nogil=True,
)
def acting(  # type: ignore[no-untyped-def]
    rhs, output, u, means, theta, varying, values, active, read, base_rates, base_reads, weights, rates, reads
):
    """By how much rates (S, na) of the active states at the means differ from others, weighted (S,).

    So do readings (S, ny), if they are to be ``read``.
    """
    theta = theta.copy()
    for k in range(u.shape[0]):
        for j in range(varying.size):
            theta[varying[j]] = values[k, j]
        dx = rhs(means[k], u[k], theta)
        for i in range(active.size):
            rates[k, i] = (dx[active[i]] - base_rates[k, i]) * weights[k]
        if read:
            y = output(means[k], u[k], theta)
            for i in range(reads.shape[1]):
                reads[k, i] = (y[i] - base_reads[k, i]) * weights[k]
