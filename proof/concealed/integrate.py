"""Heun's method with a fine step: how the concealed machines run (the twins use fourth-order Runge-Kutta)."""

from __future__ import annotations

import numpy as np
from numba import njit, types

from twinbench.physics.simulator import Array

_VECTOR = types.Array(types.float64, 1, "C")
_MATRIX = types.Array(types.float64, 2, "C")
LAW = types.float64(types.float64, _VECTOR, _VECTOR, _VECTOR, _VECTOR)
"""``law(t_s, x, u, p, out) -> 0.0`` fills ``out`` with dx/dt, or with the readings."""
_FUNCTION = types.FunctionType(LAW)
_RUN = types.void(
    _FUNCTION, _FUNCTION, types.float64, types.float64, types.int64, _MATRIX, _VECTOR, _VECTOR, _VECTOR,
    types.float64, _VECTOR, _MATRIX,
)  # fmt: skip


@njit(_RUN, cache=True, error_model="numpy")
def _run(law, reading, start_s, period_s, substeps, u, x0, before, after, onset_s, last, y):  # type: ignore[no-untyped-def]
    h = period_s / substeps
    n = x0.size
    x, ahead = x0.copy(), np.empty(n)
    k1, k2 = np.empty(n), np.empty(n)
    for k in range(u.shape[0]):
        t = start_s + k * period_s
        p = after if t >= onset_s else before
        reading(t, x, u[k], p, y[k])
        if k + 1 == u.shape[0]:
            break
        for _ in range(substeps):
            law(t, x, u[k], p, k1)
            for i in range(n):
                ahead[i] = x[i] + h * k1[i]
            law(t + h, ahead, u[k], p, k2)
            for i in range(n):
                x[i] += 0.5 * h * (k1[i] + k2[i])
            t += h
    for i in range(n):
        last[i] = x[i]


def run(
    law: object,
    reading: object,
    channels: int,
    start_s: float,
    period_s: float,
    substeps: int,
    u: Array,
    x0: Array,
    before: Array,
    after: Array,
    onset_s: float,
) -> tuple[Array, Array]:
    """Run one recording of N samples; inputs u (N, nu) are held between samples.

    Args:
        u: (N, nu) inputs in their units.
        x0: (nx,) each state in its unit, at the first sample.
        before: (n_parameters,) the parameters until ``onset_s``, each in its unit.
        after: (n_parameters,) those from then on, likewise.
        onset_s: a time on the suite's clock, like ``start_s``.

    Returns:
        Clean readings (N, channels) and the last state (nx,).
    """
    y, last = np.empty((len(u), channels)), np.empty(len(x0))
    _run(law, reading, start_s, period_s, substeps, np.ascontiguousarray(u), x0, before, after, onset_s, last, y)
    return y, last
