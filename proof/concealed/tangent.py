"""Small changes of a machine's readings, many at once: its equations linearised along one run and propagated."""

from __future__ import annotations

import numpy as np
from numba import njit, types

from twinbench.physics.simulator import Array
from twinbench.proof.concealed.integrate import LAW, Equations, Steps

_VECTOR, _MATRIX = types.Array(types.float64, 1, "C"), types.Array(types.float64, 2, "C")
_INDEX = types.Array(types.int64, 1, "C")
_FUNCTION = types.FunctionType(LAW)
_STEP = types.void(
    _FUNCTION, types.float64, types.float64, types.int64, _VECTOR, _VECTOR, _VECTOR, _VECTOR, _MATRIX,
)  # fmt: skip
_NUDGE = 1e-6
"""Finite differences take this share of a step that is typical: far above rounding, far below what bends."""


@njit(_STEP, cache=True, error_model="numpy")
def _step(law, t, h, substeps, u, x, p, out, work):  # type: ignore[no-untyped-def]
    k1, k2, ahead = work[0], work[1], work[2]
    n = x.size
    for i in range(n):
        out[i] = x[i]
    for _ in range(substeps):
        law(t, out, u, p, k1)
        for i in range(n):
            ahead[i] = out[i] + h * k1[i]
        law(t + h, ahead, u, p, k2)
        for i in range(n):
            out[i] += 0.5 * h * (k1[i] + k2[i])
        t += h


@njit(
    types.void(
        _FUNCTION, _FUNCTION, types.float64, types.float64, types.int64, _MATRIX, _VECTOR, _VECTOR, _VECTOR, _INDEX,
        _VECTOR, _MATRIX, types.Array(types.float64, 3, "C"), types.Array(types.float64, 3, "C"),
    ),
    cache=True,
    error_model="numpy",
)  # fmt: skip
def _linearise(law, reading, start_s, period_s, substeps, u, x0, scales, p0, at, sizes, xs, jacobians, readouts):  # type: ignore[no-untyped-def]
    """Fill xs (N, nx), jacobians (N, nx, nx + m), readouts (N, ny, nx + m): per unit of a state, per size of p."""
    h = period_s / substeps
    n, m, ny = x0.size, at.size, readouts.shape[1]
    work, ahead, moved = np.empty((3, n)), np.empty(n), np.empty(n)
    read, read_moved = np.empty(ny), np.empty(ny)
    x, p = x0.copy(), p0.copy()
    for k in range(u.shape[0]):
        t = start_s + k * period_s
        xs[k] = x
        _step(law, t, h, substeps, u[k], x, p, ahead, work)
        reading(t, x, u[k], p, read)
        for j in range(n + m):
            kept, size = 0.0, 1.0
            if j < n:
                kept, size = x[j], _NUDGE * scales[j]
                x[j] += size
            else:
                kept, size = p[at[j - n]], _NUDGE
                p[at[j - n]] += size * sizes[j - n]
            _step(law, t, h, substeps, u[k], x, p, moved, work)
            reading(t, x, u[k], p, read_moved)
            if j < n:
                x[j] = kept
            else:
                p[at[j - n]] = kept
            for i in range(n):
                jacobians[k, i, j] = (moved[i] - ahead[i]) / size
            for i in range(ny):
                readouts[k, i, j] = (read_moved[i] - read[i]) / size
        x[:] = ahead


@njit(cache=True, error_model="numpy")
def _propagate(jacobians, readouts, z0, which, weights, columns):  # type: ignore[no-untyped-def]
    """Fill columns (nz + K, ny, N): of starts z0 (nx, nz), then of driven changes."""
    n, nz = z0.shape
    count, ny = which.size, readouts.shape[1]
    z, ahead = np.zeros((n, nz + count)), np.empty((n, nz + count))
    z[:, :nz] = z0
    for k in range(columns.shape[2]):
        for i in range(ny):
            for c in range(nz + count):
                total = 0.0
                for j in range(n):
                    total += readouts[k, i, j] * z[j, c]
                if c >= nz:
                    total += readouts[k, i, n + which[c - nz]] * weights[k, c - nz]
                columns[c, i, k] = total
        for i in range(n):
            ahead[i] = 0.0
            for j in range(n):
                a = jacobians[k, i, j]
                if a != 0.0:
                    for c in range(nz + count):
                        ahead[i, c] += a * z[j, c]
            for c in range(count):
                ahead[i, nz + c] += jacobians[k, i, n + which[c]] * weights[k, c]
        z, ahead = ahead, z


class Tangent:
    """The linearisation of one run.

    Args:
        u: (N, nu) inputs in their units.
        x0: (nx,) each state in its unit, at the first sample.
        p: (n_parameters,) the law's own, each in its unit.
        at: (m,) parameters that may change.
        sizes: (m,) a typical change of each.

    Attributes:
        states: (N, nx) of the run.
    """

    def __init__(
        self, equations: Equations, steps: Steps, u: Array, x0: Array, p: Array, at: Array, sizes: Array
    ) -> None:
        samples, n, m = len(u), len(x0), len(at)
        self.states = np.empty((samples, n))
        self._jacobians = np.empty((samples, n, n + m))
        self._readouts = np.empty((samples, equations.channels, n + m))
        scales = np.maximum(np.abs(x0), 1.0)
        _linearise(
            equations.law, equations.reading, *steps, np.ascontiguousarray(u), x0, scales, p,
            np.asarray(at, dtype=np.int64), np.asarray(sizes, dtype=float), self.states, self._jacobians,
            self._readouts,
        )  # fmt: skip

    def columns(self, starts: Array, which: Array, weights: Array) -> Array:
        """Changes of the readings, (nz + K, ny, N).

        Args:
            starts: (nx, nz) changes of the start state, each state in its unit.
            which: (K,) the changing parameter of each further column, by its place in ``at``.
            weights: (N, K) by how many of its typical changes, sample by sample.
        """
        count = starts.shape[1] + len(which)
        found = np.empty((count, self._readouts.shape[1], len(self.states)))
        _propagate(
            self._jacobians, self._readouts, np.ascontiguousarray(starts), np.asarray(which, dtype=np.int64),
            np.ascontiguousarray(weights), found,
        )  # fmt: skip
        return found
