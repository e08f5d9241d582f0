"""Fixed-step Runge-Kutta for any Simulator, compiled, batched over sequences."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numba import njit, types

from twinbench.physics.compile import compiled
from twinbench.physics.jit import FUNCTION, VECTOR
from twinbench.physics.simulator import Array, Simulator

MATRIX = types.Array(types.float64, 2, "C")
INDICES = types.Array(types.int64, 1, "C")


@njit(VECTOR(FUNCTION, VECTOR, VECTOR, VECTOR, types.float64, types.int64), cache=True, error_model="numpy")
def rk4(rhs, x, u, theta, dt_s, substeps):  # type: ignore[no-untyped-def]
    """Advance x by dt_s with inputs and parameters held; classical fourth order."""
    h = dt_s / substeps
    n = x.size
    x = x.copy()
    y = np.empty((3, n))  # one per stage: what rhs returns may be its argument
    for _ in range(substeps):
        k1 = rhs(x, u, theta)
        for i in range(n):
            y[0, i] = x[i] + 0.5 * h * k1[i]
        k2 = rhs(y[0], u, theta)
        for i in range(n):
            y[1, i] = x[i] + 0.5 * h * k2[i]
        k3 = rhs(y[1], u, theta)
        for i in range(n):
            y[2, i] = x[i] + h * k3[i]
        k4 = rhs(y[2], u, theta)
        for i in range(n):
            x[i] += h / 6.0 * (k1[i] + 2.0 * (k2[i] + k3[i]) + k4[i])
    return x


_LOOP = types.void(
    FUNCTION, FUNCTION, MATRIX, VECTOR, VECTOR, INDICES, MATRIX, types.float64, types.int64, MATRIX, MATRIX
)


@njit(_LOOP, cache=True, error_model="numpy")
def _run(rhs, output, u, x0, theta, varying, values, dt_s, substeps, x_out, y_out):  # type: ignore[no-untyped-def]
    theta = theta.copy()
    x = x0.copy()
    for k in range(u.shape[0]):
        for j in range(varying.size):
            theta[varying[j]] = values[k, j]
        x_out[k] = x
        y_out[k] = output(x, u[k], theta)
        if k + 1 < u.shape[0]:
            x = rk4(rhs, x, u[k], theta, dt_s, substeps)


def _run_python(rhs, output, u, x0, theta, varying, values, dt_s, substeps, x_out, y_out):  # type: ignore[no-untyped-def]
    theta = theta.copy()
    x_out[0] = x0
    for k in range(len(u)):
        theta[varying] = values[k]
        y_out[k] = output(x_out[k], u[k], theta)
        if k + 1 < len(u):
            x_out[k + 1] = rk4.py_func(rhs, x_out[k], u[k], theta, dt_s, substeps)


def simulate(
    simulator: Simulator,
    u: Array,
    x0: Array,
    theta: Array | None = None,
    dt_s: float = 0.05,
    substeps: int = 2,
    varying: Sequence[str] = (),
    values: Array | None = None,
) -> tuple[Array, Array]:
    """Run B sequences of N samples.

    Args:
        simulator: what is run.
        u: (B, N, nu) inputs in their units; row k holds from t_k until t_(k+1).
        x0: (nx,) or (B, nx), the state at t_0, each in its unit.
        theta: (np,) or (B, np), each in its parameter's unit; the simulator's nominal values if left out.
        dt_s: sample period.
        substeps: RK4 steps in one sample period.
        varying: names of parameters that change in time.
        values: (B, N, n_varying), what those parameters are, each in its unit.

    Returns:
        x (B, N, nx) and y (B, N, ny), both at the sample instants.
    """
    u = np.ascontiguousarray(u, dtype=np.float64)
    batch, samples, n_inputs = u.shape
    if n_inputs != len(simulator.inputs):
        raise ValueError(f"u has {n_inputs} columns, simulator {simulator.name!r} has {len(simulator.inputs)} inputs")
    if substeps < 1:
        raise ValueError(f"substeps is {substeps}, must be at least 1")
    start = np.broadcast_to(np.asarray(x0, dtype=np.float64), (batch, len(simulator.states)))
    base = simulator.theta() if theta is None else np.asarray(theta, dtype=np.float64)
    thetas = np.broadcast_to(base, (batch, len(simulator.parameters)))
    if values is None:
        values = np.empty((batch, samples, 0))
    values = np.ascontiguousarray(values, dtype=np.float64)
    if values.shape != (batch, samples, len(varying)):
        raise ValueError(f"values has shape {values.shape}, expected {(batch, samples, len(varying))}")
    indices = np.array([simulator.index(name) for name in varying], dtype=np.int64)
    equations = compiled(simulator)
    run = _run if equations.native else _run_python
    x = np.empty((batch, samples, len(simulator.states)))
    y = np.empty((batch, samples, len(simulator.outputs)))
    for b in range(batch):
        run(
            equations.rhs,
            equations.output,
            u[b],
            start[b].copy(),
            thetas[b].copy(),
            indices,
            values[b],
            dt_s,
            substeps,
            x[b],
            y[b],
        )
    return x, y


@njit(
    types.void(FUNCTION, MATRIX, MATRIX, VECTOR, INDICES, MATRIX, types.float64, types.int64, MATRIX),
    cache=True,
    error_model="numpy",
)
def _advance(rhs, x, u, theta, varying, values, dt_s, substeps, out):  # type: ignore[no-untyped-def]
    theta = theta.copy()
    for k in range(x.shape[0]):
        for j in range(varying.size):
            theta[varying[j]] = values[k, j]
        out[k] = rk4(rhs, x[k], u[k], theta, dt_s, substeps)


def advance(
    simulator: Simulator,
    x: Array,
    u: Array,
    dt_s: float,
    substeps: int = 2,
    varying: Sequence[str] = (),
    values: Array | None = None,
) -> Array:
    """One step of M independent machines: x (M, nx), u (M, nu), values (M, len(varying)) -> (M, nx).

    Args:
        x: (M, nx), each state in its unit.
        u: (M, nu) inputs in their units.
        dt_s: how long the step lasts.
        substeps: RK4 steps in it.
        varying: names of parameters that differ between the machines.
        values: (M, n_varying), what those are, each in its unit.
    """
    equations = compiled(simulator)
    if values is None:
        values = np.empty((len(x), 0))
    out = np.empty((len(x), len(simulator.states)))
    indices = np.array([simulator.index(name) for name in varying], dtype=np.int64)
    step = _advance if equations.native else _advance.py_func
    step(
        equations.rhs,
        np.ascontiguousarray(x, dtype=np.float64),
        np.ascontiguousarray(u, dtype=np.float64),
        simulator.theta(),
        indices,
        np.ascontiguousarray(values, dtype=np.float64),
        dt_s,
        substeps,
        out,
    )
    return out
