"""The augmented filter's equations over any Simulator of a machine, compiled. One machine at a time.

z = [the simulator's states, the health coordinates zeta, a coloured-noise state of every output, the slow drift that
sensors share, and, where the model errs, a slow error of every estimated state]. Jacobians are forward differences of
one Runge-Kutta step. The noise of the measured inputs enters as process noise through the sensitivity to them, and the
drift through the same sensitivity: what a sensor with drift reads is the true value times one plus the drift.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

from twinbench.machines.coordinates import Array, Coordinates, map_one
from twinbench.machines.machine import Machine
from twinbench.methods.kalman import INNOVATION_CLIP_SD, predict_covariance, update
from twinbench.methods.noise import coloured_keep, drift_keep
from twinbench.physics.compile import compiled
from twinbench.physics.integrate import rk4
from twinbench.physics.simulator import Simulator

REST = 1e-12
"""Of a tick's process noise, what variances keep at least: far below anything that matters, far above round-off."""
DIFFERENCE = 1e-3
"""Of a typical change of a health parameter: the step of its finite differences. A larger one errs by how the equations
bend, a smaller one by round-off."""


class Filter(NamedTuple):
    """What one tick needs besides the equations. A machine of nx states, nh health parameters, nu inputs, ny outputs.

    Attributes:
        theta: (np,) the simulator's parameters, each in its unit.
        coordinates: the map of health.
        health: (nh,) positions of the health parameters in theta.
        acts: (nh,) bool: a parameter acts on the machine.
        shows: (nh,) bool: a parameter acts on what the outputs read.
        step: (nx,) finite-difference steps of the states, in their units.
        Q: (n, n) process noise of one tick, input noise apart, in the units of z squared.
        keep: (ny + 1,) dimensionless AR(1) factors of the noise states and the drift.
        input_drift: (nu,) dimensionless shares of the inputs that one sd of the drift is; zero: an input has none.
        output_drift: (ny,) likewise of the outputs.
        error_keep: dimensionless AR(1) factor of the model's slow errors.
        period_s: from tick to tick.
        substeps: RK4 steps in a tick.
        low: (n,) lower bounds of z, in its units.
        high: (n,) upper bounds, likewise.
    """

    theta: Array
    coordinates: Coordinates
    health: np.ndarray
    acts: np.ndarray
    shows: np.ndarray
    step: Array
    Q: Array
    keep: Array
    input_drift: Array
    output_drift: Array
    error_keep: float
    period_s: float
    substeps: int
    low: Array
    high: Array


def sensor_keep(machine: Machine) -> Array:
    """AR(1) factors (ny + 1,) from tick to tick: the outputs' coloured noise, the drift that sensors share."""
    return np.append(coloured_keep(machine), drift_keep(machine))


def size_of(machine: Machine, simulator: Simulator, slow_errors: bool) -> int:
    """How many entries z has over a simulator of that machine."""
    sensors = len(machine.outputs) + 1
    return len(simulator.states) + len(machine.health) + sensors + slow_errors * len(machine.estimated)


def shown(machine: Machine, simulator: Simulator) -> np.ndarray:
    """(nh,) bool: which health parameters act on what the outputs read, states given."""
    output = compiled(simulator).output
    u, theta = np.array([v.nominal for v in simulator.inputs]), simulator.theta()
    x, scale = (np.array([getattr(v, part) for v in simulator.states]) for part in ("nominal", "scale"))
    acting = np.array([h.on_readings for h in machine.health])
    for j, h in enumerate(machine.health):
        moved = theta.copy()
        moved[simulator.index(h.name)] += 0.5 * simulator.parameters[simulator.index(h.name)].scale
        for at in (x, x + 0.5 * scale):  # a gain on a state whose nominal value is zero shows beside it
            acting[j] |= bool((output(at, u, moved) != output(at, u, theta)).any())
    return acting


@njit(cache=True, error_model="numpy")
def parameters(model, z):  # type: ignore[no-untyped-def]
    """The simulator's parameters (np,) at the health of z, and d theta / d zeta (nh,)."""
    theta, slope = model.theta.copy(), np.empty(model.health.size)
    for i in range(model.health.size):
        theta[model.health[i]], slope[i] = map_one(model.coordinates, i, z[model.step.size + i])
    return theta, slope


@njit(cache=True, error_model="numpy")
def drift_of(model):  # type: ignore[no-untyped-def]
    """Where the drift stands in z."""
    return model.step.size + model.health.size + model.output_drift.size


@njit(cache=True, error_model="numpy")
def true_inputs(model, z, u):  # type: ignore[no-untyped-def]
    """Inputs (nu,) without the drift of their sensors."""
    u = u.copy()
    for i in range(u.size):
        if model.input_drift[i] != 0.0:
            u[i] /= 1.0 + model.input_drift[i] * z[drift_of(model)]
    return u


@njit(cache=True, error_model="numpy")
def bound(model, z):  # type: ignore[no-untyped-def]
    """z where the model is one, in place, whatever was read."""
    for j in range(model.low.size):
        z[j] = min(max(z[j], model.low[j]), model.high[j])


@njit(cache=True, error_model="numpy")
def move(rhs, model, z, u, theta):  # type: ignore[no-untyped-def]
    """z (n,) one tick on under true inputs u (nu,): states by equations and slow errors, the rest by its memory."""
    nx = model.step.size
    sensor, error = nx + model.health.size, drift_of(model) + 1
    after = z.copy()
    after[:nx] = rk4(rhs, z[:nx].copy(), u, theta, model.period_s, model.substeps)
    for i in range(z.size - error):
        after[i] += z[error + i]
        after[error + i] *= model.error_keep
    for i in range(model.keep.size):
        after[sensor + i] *= model.keep[i]
    bound(model, after)
    return after


@njit(cache=True, error_model="numpy")
def linearise(rhs, model, z, u, u_sd):  # type: ignore[no-untyped-def]
    """z (n,) one tick on, F and Q (n, n), from inputs u (nu,) as read and their sd (nu,)."""
    nx, n = model.step.size, z.size
    sensor, drift = nx + model.health.size, drift_of(model)
    theta, slope = parameters(model, z)
    u = true_inputs(model, z, u)
    x = z[:nx].copy()
    base = rk4(rhs, x, u, theta, model.period_s, 1)
    F = np.zeros((n, n))
    for j in range(nx):
        moved = x.copy()
        moved[j] += model.step[j]
        F[:nx, j] = (rk4(rhs, moved, u, theta, model.period_s, 1) - base) / model.step[j]
    for j in range(model.health.size):
        F[nx + j, nx + j] = 1.0
        if model.acts[j]:
            shifted = theta.copy()
            size = DIFFERENCE * slope[j]
            shifted[model.health[j]] += size
            F[:nx, nx + j] = (rk4(rhs, x, u, shifted, model.period_s, 1) - base) / size * slope[j]
    for j in range(model.keep.size):
        F[sensor + j, sensor + j] = model.keep[j]
    for j in range(n - drift - 1):
        F[j, drift + 1 + j] = 1.0
        F[drift + 1 + j, drift + 1 + j] = model.error_keep
    Q = model.Q.copy()
    for j in range(u.size):
        if u_sd[j] > 0.0:
            moved_u = u.copy()
            moved_u[j] += u_sd[j]
            effect = rk4(rhs, x, moved_u, theta, model.period_s, 1) - base
            for a in range(nx):
                for b in range(nx):
                    Q[a, b] += effect[a] * effect[b]
            if model.input_drift[j] != 0.0:
                F[:nx, drift] += effect * (-model.input_drift[j] * u[j] / u_sd[j])
    return move(rhs, model, z, u, theta), F, Q


@njit(cache=True, error_model="numpy")
def measure(output, model, z, u, measured, white_sd, coloured_sd):  # type: ignore[no-untyped-def]
    """Innovation (ny,), NaN where missing, H (ny, n) and R (ny, ny) for the outputs ``measured`` (ny,).

    The function takes plain arrays because it is compiled.
    """
    nx, n, ny = model.step.size, z.size, measured.size
    noise, drift = nx + model.health.size, drift_of(model)
    theta, slope = parameters(model, z)
    u = true_inputs(model, z, u)
    x = z[:nx].copy()
    y = output(x, u, theta)
    H = np.zeros((ny, n))
    for j in range(nx):
        moved = x.copy()
        moved[j] += model.step[j]
        H[:, j] = (output(moved, u, theta) - y) / model.step[j]
    for j in range(model.health.size):
        if model.shows[j]:
            shifted = theta.copy()
            size = DIFFERENCE * slope[j]
            shifted[model.health[j]] += size
            H[:, nx + j] = (output(x, u, shifted) - y) / size * slope[j]
    innovation = measured - y
    R = np.zeros((ny, ny))
    for i in range(ny):
        if model.output_drift[i] != 0.0:
            H[i, :] *= 1.0 + model.output_drift[i] * z[drift]
            H[i, drift] = model.output_drift[i] * y[i]
            innovation[i] -= model.output_drift[i] * z[drift] * y[i]
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
    """z and P after the outputs ``measured`` (ny,), the innovation, S and NIS.

    The function takes plain arrays because it is compiled.

    Args:
        out: (ny,) positive for outputs that are not to be believed; they have an innovation, and correct nothing.
    """
    innovation, H, R = measure(output, model, z, u, measured, white_sd, coloured_sd)
    used = innovation.copy()
    for i in range(used.size):
        if out[i] > 0:
            used[i] = np.nan
    z, P, S, nis = update(z, P, used, H, R, INNOVATION_CLIP_SD)
    keep_doubt(model, P)
    bound(model, z)
    return z, P, innovation, S, nis


@njit(cache=True, error_model="numpy")
def roll_out(rhs, output, model, z, inputs, readings):  # type: ignore[no-untyped-def]
    """Open loop from z (B, n) over inputs (B, L + 1, nu) as read, from the present ones on; health is frozen.

    The function takes plain arrays because it is compiled.

    Args:
        readings: (B, L, ny) noise-free ones, in the outputs' units, are written here.
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
