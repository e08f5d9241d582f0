"""Small changes of a machine's readings, many at once: its equations linearised along one run and propagated."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba import njit, types
from numpy.typing import NDArray

from twinbench.physics.simulator import Array
from twinbench.proof.concealed.integrate import LAW, Equations, Steps

_VECTOR, _MATRIX = types.Array(types.float64, 1, "C"), types.Array(types.float64, 2, "C")
_CUBE = types.Array(types.float64, 3, "C")
_FUNCTION = types.FunctionType(LAW)
SMALL_SHARE = 1e-6
"""Share of a typical change that finite differences take: far above rounding, far below what bends."""


@njit(
    types.void(_FUNCTION, types.float64, types.float64, types.int64, _VECTOR, _VECTOR, _VECTOR, _VECTOR, _MATRIX),
    cache=True,
    error_model="numpy",
)
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
        _FUNCTION, _FUNCTION, types.float64, types.float64, types.int64, _MATRIX, _VECTOR, _VECTOR, _VECTOR, _VECTOR,
        _MATRIX, _MATRIX, _CUBE, _CUBE,
    ),
    cache=True,
    error_model="numpy",
)  # fmt: skip
def _linearise(law, reading, start_s, period_s, substeps, u, x0, by_x, by_u, p, xs, ys, steps, reads):  # type: ignore[no-untyped-def]
    """Fill states xs (N, nx), ys (N, ny), and steps (N, nx, nx + nu), reads (N, ny, nx + nu) per unit of x and u."""
    h = period_s / substeps
    n, nu, ny = x0.size, u.shape[1], reads.shape[1]
    work, ahead, moved, y = np.empty((3, n)), np.empty(n), np.empty(n), np.empty(ny)
    x, now = x0.copy(), np.empty(nu)
    for k in range(u.shape[0]):
        t = start_s + k * period_s
        now[:] = u[k]
        xs[k] = x
        _step(law, t, h, substeps, now, x, p, ahead, work)
        reading(t, x, now, p, ys[k])
        for j in range(n + nu):
            size = by_x[j] if j < n else by_u[j - n]
            kept = x[j] if j < n else now[j - n]
            if j < n:
                x[j] += size
            else:
                now[j - n] += size
            _step(law, t, h, substeps, now, x, p, moved, work)
            reading(t, x, now, p, y)
            if j < n:
                x[j] = kept
            else:
                now[j - n] = kept
            for i in range(n):
                steps[k, i, j] = (moved[i] - ahead[i]) / size
            for i in range(ny):
                reads[k, i, j] = (y[i] - ys[k, i]) / size
        x[:] = ahead


@njit(
    types.void(
        _FUNCTION, _FUNCTION, types.float64, types.float64, types.int64, _MATRIX, _MATRIX, _MATRIX, _MATRIX, _VECTOR,
        _CUBE, _CUBE,
    ),
    cache=True,
    error_model="numpy",
)  # fmt: skip
def _force(law, reading, start_s, period_s, substeps, u, xs, ys, moved, share, steps, reads):  # type: ignore[no-untyped-def]
    """Fill steps (N, nx, J), reads (N, ny, J): what J parameter vectors change in one sample, over their share."""
    h = period_s / substeps
    n, ny = xs.shape[1], ys.shape[1]
    work, ahead, y = np.empty((3, n)), np.empty(n), np.empty(ny)
    for k in range(u.shape[0]):
        t = start_s + k * period_s
        for j in range(share.size):
            reading(t, xs[k], u[k], moved[j], y)
            for i in range(ny):
                reads[k, i, j] = (y[i] - ys[k, i]) / share[j]
            if k + 1 < u.shape[0]:
                _step(law, t, h, substeps, u[k], xs[k], moved[j], ahead, work)
                for i in range(n):
                    steps[k, i, j] = (ahead[i] - xs[k + 1, i]) / share[j]


@njit(
    types.void(_CUBE, _CUBE, _CUBE, _CUBE, _MATRIX, types.Array(types.int64, 1, "C"), _MATRIX, _CUBE),
    cache=True,
    error_model="numpy",
)
def _propagate(steps, reads, force, shift, start, which, weights, columns):  # type: ignore[no-untyped-def]
    """Fill columns (K, ny, N): of changed starts (nx, K), driven by weights (N, K) of the force ``which`` (K,)."""
    n, count, ny = start.shape[0], which.size, reads.shape[1]
    z, ahead = start.copy(), np.empty((n, count))
    for k in range(columns.shape[2]):
        for i in range(ny):
            for c in range(count):
                total = shift[k, i, which[c]] * weights[k, c]
                for j in range(n):
                    total += reads[k, i, j] * z[j, c]
                columns[c, i, k] = total
        for i in range(n):
            for c in range(count):
                ahead[i, c] = force[k, i, which[c]] * weights[k, c]
            for j in range(n):
                a = steps[k, i, j]
                if a != 0.0:
                    for c in range(count):
                        ahead[i, c] += a * z[j, c]
        z, ahead = ahead, z


class Forces(NamedTuple):
    """What J changes do in one sample.

    Attributes:
        steps: (N, nx, J) to the next state, each in its unit.
        reads: (N, ny, J) to the reading, in the channels' units.
    """

    steps: Array
    reads: Array


class Tangent:
    """The linearisation of one run.

    Args:
        u: (N, nu) inputs in their units.
        x0: (nx,) each state in its unit, at the first sample.
        p: (n_parameters,) the law's own, each in its unit.

    Attributes:
        states: (N, nx) of the run.
        inputs: Forces of one unit of each input.
    """

    def __init__(self, equations: Equations, steps: Steps, u: Array, x0: Array, p: Array) -> None:
        samples, n, nu, ny = len(u), len(x0), u.shape[1], equations.channels
        self._equations, self._steps, self._u = equations, steps, np.ascontiguousarray(u)
        self.states, self._ys = np.empty((samples, n)), np.empty((samples, ny))
        ahead, reads = np.empty((samples, n, n + nu)), np.empty((samples, ny, n + nu))
        by_x, by_u = SMALL_SHARE * (np.abs(x0) + 1.0), SMALL_SHARE * (np.abs(u).max(axis=0) + 1.0)
        law, reading, _ = equations
        _linearise(law, reading, *steps, self._u, x0, by_x, by_u, p, self.states, self._ys, ahead, reads)
        self._ahead, self._reads = ahead[:, :, :n].copy(), reads[:, :, :n].copy()
        self.inputs = Forces(ahead[:, :, n:].copy(), reads[:, :, n:].copy())

    def forces(self, moved: Array, share: Array) -> Forces:
        """Of other parameters along the same run.

        Args:
            moved: (J, n_parameters) each in its unit.
            share: (J,) dimensionless, the part of the wanted change that each is.
        """
        samples, n = self.states.shape
        ahead, reads = np.zeros((samples, n, len(moved))), np.zeros((samples, self._ys.shape[1], len(moved)))
        law, reading, _ = self._equations
        moved = np.ascontiguousarray(moved)
        _force(law, reading, *self._steps, self._u, self.states, self._ys, moved, share, ahead, reads)
        return Forces(ahead, reads)

    def starts(self, changes: Array) -> Array:
        """Changes of the readings (K, ny, N) by changes of the start state.

        Args:
            changes: (nx, K) each state in its unit.
        """
        nothing = Forces(np.zeros((len(self.states), len(changes), 1)), np.zeros((*self._ys.shape, 1)))
        count = changes.shape[1]
        return self._run(nothing, changes, np.zeros(count, dtype=np.int64), np.zeros((len(self.states), count)))

    def driven(self, forces: Forces, which: NDArray[Any], weights: Array, settled: int) -> Array:
        """Changes of the readings (K, ny, N) by weighted forces.

        Args:
            which: (K,) positions of the forces.
            weights: (N, K) of each sample, dimensionless, or in the input's unit.
            settled: for so many samples before the first everything was as at the first.
        """
        at_first = forces.steps[0][:, which] * weights[0]
        return self._run(forces, _series_sum(self._ahead[0], settled) @ at_first, which, weights)

    def _run(self, forces: Forces, start: Array, which: NDArray[Any], weights: Array) -> Array:
        found = np.empty((len(which), self._ys.shape[1], len(self.states)))
        start, weights = np.ascontiguousarray(start), np.ascontiguousarray(weights)
        _propagate(self._ahead, self._reads, forces.steps, forces.reads, start, which, weights, found)
        return found


def _series_sum(A: Array, terms: int) -> Array:
    """I + A + ... + A^(terms - 1), by halving."""
    if terms <= 1:
        return np.eye(len(A)) * float(terms)
    half = _series_sum(A, terms // 2)
    both = half + np.linalg.matrix_power(A, terms // 2) @ half
    return both if terms % 2 == 0 else np.eye(len(A)) + A @ both
