"""The augmented filter's equations over any Simulator of the compressor, compiled. One machine at a time.

z = [the simulator's states, five health coordinates zeta, three coloured-noise states, the slow drift that the pressure
sensors share, and, where the model errs, five slow errors of it]. Jacobians are forward differences of one Runge-Kutta
step. The noise of the measured inputs enters as process noise through the sensitivity to them, and the drift through
the same sensitivity: what the suction sensor reads is the true pressure times one plus the drift.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba import njit

from twinbench.data.batch import CHANNEL, HEALTH, OUTPUTS, SAMPLE_PERIOD_S, STATES, Array
from twinbench.methods.kalman import INNOVATION_CLIP_SD, predict_covariance, update
from twinbench.methods.noise import coloured_keep, drift_keep
from twinbench.physics.health import map_one
from twinbench.physics.integrate import rk4
from twinbench.physics.sensors import PRESSURE_DRIFT_SHARE

N_HEALTH, N_NOISE, N_ERROR = len(HEALTH), len(OUTPUTS), len(STATES)
N_SENSOR = N_NOISE + 1
"""Entries of z that belong to the sensors: coloured noise and drift, AR(1) of unit variance."""
SUCTION, DISCHARGE = CHANNEL.p_suc_bar, OUTPUTS.index("p_dis_bar")
REST = 1e-12
"""Of a tick's process noise, what variances keep at least: far below anything that matters, far above round-off."""


class Filter(NamedTuple):
    """What one tick needs besides the equations.

    Attributes:
        theta: (np,) the simulator's parameters, each in its unit.
        health: (5,) positions of the health parameters in theta.
        step: (nx,) finite-difference steps of the states, in their units.
        Q: (n, n) process noise of one tick, input noise apart, in the units of z squared.
        keep: (4,) dimensionless AR(1) factors of the noise states and the drift.
        error_keep: dimensionless AR(1) factor of the model's slow errors.
        substeps: RK4 steps in a tick.
        low: (n,) lower bounds of z, in its units.
        high: (n,) upper bounds, likewise.
    """

    theta: Array
    health: np.ndarray
    step: Array
    Q: Array
    keep: Array
    error_keep: float
    substeps: int
    low: Array
    high: Array


def sensor_keep() -> Array:
    """AR(1) factors (4,) from tick to tick: the outputs' coloured noise, the drift of the pressure sensors."""
    return np.append(coloured_keep(), drift_keep())


@njit(cache=True, error_model="numpy")
def parameters(model, z):  # type: ignore[no-untyped-def]
    """The simulator's parameters (np,) at the health of z, and d theta / d zeta (5,)."""
    theta, slope = model.theta.copy(), np.empty(N_HEALTH)
    for i in range(N_HEALTH):
        theta[model.health[i]], slope[i] = map_one(i, z[model.step.size + i])
    return theta, slope


@njit(cache=True, error_model="numpy")
def true_inputs(model, z, u):  # type: ignore[no-untyped-def]
    """Inputs (4,) without the drift of the suction sensor."""
    u = u.copy()
    u[SUCTION] /= 1.0 + PRESSURE_DRIFT_SHARE * z[model.step.size + N_HEALTH + N_NOISE]
    return u


@njit(cache=True, error_model="numpy")
def bound(model, z):  # type: ignore[no-untyped-def]
    """z where the model is one, in place, whatever was read."""
    for j in range(model.low.size):
        z[j] = min(max(z[j], model.low[j]), model.high[j])


@njit(cache=True, error_model="numpy")
def move(rhs, model, z, u, theta):  # type: ignore[no-untyped-def]
    """z (n,) one tick on under true inputs u (4,): states by equations and slow errors, the rest by its memory."""
    nx = model.step.size
    sensor, error = nx + N_HEALTH, nx + N_HEALTH + N_SENSOR
    after = z.copy()
    after[:nx] = rk4(rhs, z[:nx].copy(), u, theta, SAMPLE_PERIOD_S, model.substeps)
    for i in range(z.size - error):
        after[i] += z[error + i]
        after[error + i] *= model.error_keep
    for i in range(N_SENSOR):
        after[sensor + i] *= model.keep[i]
    bound(model, after)
    return after


@njit(cache=True, error_model="numpy")
def linearise(rhs, model, z, u, u_sd):  # type: ignore[no-untyped-def]
    """z (n,) one tick on, F and Q (n, n), from inputs u (4,) as read and their sd (4,)."""
    nx, n = model.step.size, z.size
    sensor, error = nx + N_HEALTH, nx + N_HEALTH + N_SENSOR
    theta, slope = parameters(model, z)
    u = true_inputs(model, z, u)
    x = z[:nx].copy()
    base = rk4(rhs, x, u, theta, SAMPLE_PERIOD_S, 1)
    F = np.zeros((n, n))
    for j in range(nx):
        moved = x.copy()
        moved[j] += model.step[j]
        F[:nx, j] = (rk4(rhs, moved, u, theta, SAMPLE_PERIOD_S, 1) - base) / model.step[j]
    for j in range(N_HEALTH - 1):  # the sensor's bias does not act on the machine
        shifted = theta.copy()
        size = 1e-3 * slope[j]
        shifted[model.health[j]] += size
        F[:nx, nx + j] = (rk4(rhs, x, u, shifted, SAMPLE_PERIOD_S, 1) - base) / size * slope[j]
    for j in range(N_HEALTH):
        F[nx + j, nx + j] = 1.0
    for j in range(N_SENSOR):
        F[sensor + j, sensor + j] = model.keep[j]
    for j in range(n - error):
        F[j, error + j] = 1.0
        F[error + j, error + j] = model.error_keep
    Q = model.Q.copy()
    for j in range(u.size):
        if u_sd[j] > 0.0:
            moved_u = u.copy()
            moved_u[j] += u_sd[j]
            effect = rk4(rhs, x, moved_u, theta, SAMPLE_PERIOD_S, 1) - base
            for a in range(nx):
                for b in range(nx):
                    Q[a, b] += effect[a] * effect[b]
            if j == SUCTION:
                F[:nx, sensor + N_NOISE] = effect * (-PRESSURE_DRIFT_SHARE * u[j] / u_sd[j])
    return move(rhs, model, z, u, theta), F, Q


@njit(cache=True, error_model="numpy")
def measure(output, model, z, u, measured, white_sd, coloured_sd):  # type: ignore[no-untyped-def]
    """Innovation (3,), NaN where missing, H (3, n) and R (3, 3) for the outputs ``measured`` (3,).

    The function takes plain arrays because it is compiled.
    """
    nx, n = model.step.size, z.size
    noise, drift = nx + N_HEALTH, nx + N_HEALTH + N_NOISE
    theta, slope = parameters(model, z)
    u = true_inputs(model, z, u)
    x = z[:nx].copy()
    y = output(x, u, theta)
    H = np.zeros((3, n))
    for j in range(nx):
        moved = x.copy()
        moved[j] += model.step[j]
        H[:, j] = (output(moved, u, theta) - y) / model.step[j]
    bias = model.health[N_HEALTH - 1]
    theta[bias] += 1.0
    H[:, noise - 1] = (output(x, u, theta) - y) * slope[N_HEALTH - 1]
    H[DISCHARGE, :] *= 1.0 + PRESSURE_DRIFT_SHARE * z[drift]
    H[DISCHARGE, drift] = PRESSURE_DRIFT_SHARE * y[DISCHARGE]
    innovation = measured - y
    innovation[DISCHARGE] -= PRESSURE_DRIFT_SHARE * z[drift] * y[DISCHARGE]
    R = np.zeros((3, 3))
    for i in range(N_NOISE):
        H[i, noise + i] = coloured_sd[i]
        R[i, i] = white_sd[i] ** 2
        innovation[i] -= coloured_sd[i] * z[noise + i]
    return innovation, H, R


@njit(cache=True, error_model="numpy")
def forecast_one(rhs, model, z, P, u, u_sd):  # type: ignore[no-untyped-def]
    """z (n,) and P (n, n) a tick on, and the F that led there.

    The function takes plain arrays because it is compiled.
    """
    after, F, Q = linearise(rhs, model, z, u, u_sd)
    return after, predict_covariance(P, F, Q), F


@njit(cache=True, error_model="numpy")
def keep_doubt(model, P):  # type: ignore[no-untyped-def]
    """Variances of P (n, n), in place, no smaller than REST of a tick's noise: a reading of zero has no noise."""
    for i in range(len(P)):
        P[i, i] = max(P[i, i], REST * model.Q[i, i])


@njit(cache=True, error_model="numpy")
def correct_one(output, model, z, P, u, measured, white_sd, coloured_sd, out):  # type: ignore[no-untyped-def]
    """z and P after the outputs ``measured`` (3,), the innovation, S and NIS.

    The function takes plain arrays because it is compiled.

    Args:
        out: (3,) positive for outputs that are not to be believed; they have an innovation, and correct nothing.
    """
    innovation, H, R = measure(output, model, z, u, measured, white_sd, coloured_sd)
    used = innovation.copy()
    for i in range(N_NOISE):
        if out[i] > 0:
            used[i] = np.nan
    z, P, S, nis = update(z, P, used, H, R, INNOVATION_CLIP_SD)
    keep_doubt(model, P)
    bound(model, z)
    return z, P, innovation, S, nis


@njit(cache=True, error_model="numpy")
def roll_out(rhs, output, model, z, inputs, readings):  # type: ignore[no-untyped-def]
    """Open loop from z (B, n) over inputs (B, L + 1, 4) as read, from the present ones on; health is frozen.

    The function takes plain arrays because it is compiled.

    Args:
        readings: (B, L, 3) noise-free ones, in the outputs' units, are written here.
    """
    nx = model.step.size
    for b in range(z.shape[0]):
        at = z[b].copy()
        theta, _ = parameters(model, at)
        u = true_inputs(model, at, inputs[b, 0])
        for k in range(readings.shape[1]):
            at = move(rhs, model, at, u, theta)
            u = true_inputs(model, at, inputs[b, k + 1])
            readings[b, k] = output(at[:nx].copy(), u, theta)


def size_of(machine: Any, slow_errors: bool) -> int:
    """How many entries z has over that simulator."""
    return len(machine.states) + N_HEALTH + N_SENSOR + (N_ERROR if slow_errors else 0)
