"""Peers: filterpy's EKF and UKF on the same machine, ten states, with the nominal model in NumPy and in numba.

z = [five states, five health coordinates zeta]. The model is the reduced-order compressor, one Runge-Kutta step a
tick; its probe follows the gas at once, its valve stands where it is told, its head has the gas's temperature.
Noise is the data sheet's and the baselines'. The filters are filterpy's own ``predict`` and ``update``, the EKF's
Jacobians forward differences of the same model.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from filterpy.kalman import ExtendedKalmanFilter, MerweScaledSigmaPoints, UnscentedKalmanFilter
from numba import njit

from twinbench.baselines.model_ekf import STATE_WALK
from twinbench.data.batch import CHANNEL, HEALTH, SAMPLE_PERIOD_S, STATE, STATES, Array
from twinbench.methods.noise import health_walk_var, output_sd
from twinbench.physics.compile import compiled
from twinbench.physics.compressor import X, balance, flux
from twinbench.physics.health import map_health, to_theta
from twinbench.physics.integrate import rk4
from twinbench.physics.nominal import NOMINAL

N_STATES, N_HEALTH = len(STATES), len(HEALTH)
SIZE = N_STATES + N_HEALTH
ALPHA = 0.5
"""Spread of the sigma points, as ``baselines.pinn_ukf`` has it."""
DIFFERENCE_STEP = np.concatenate(
    [1e-4 * np.array([v.scale for v in NOMINAL.states[:N_STATES]]), np.full(len(HEALTH), 1e-3)]
)
"""Of the forward differences."""
Q = np.diag(np.concatenate([STATE_WALK[:N_STATES] ** 2 * SAMPLE_PERIOD_S, health_walk_var(1.0)]))
CONSTANTS = NOMINAL.theta()

Move = Callable[[Array, Array], Array]
"""z (10,) one tick on under inputs (4,)."""
Observe = Callable[[Array, Array], Array]
"""Readings (3,) of z (10,) under inputs (4,)."""


def start(readings: Array) -> tuple[Array, Array]:
    """z (10,) and P (10, 10) of a healthy machine at its first readings (7,).

    Args:
        readings: (7,) in the channels' units, order CHANNELS, none missing.
    """
    z = np.zeros(SIZE)
    z[:N_STATES] = NOMINAL.initial(readings[:4], readings[4:], CONSTANTS)[:N_STATES]  # type: ignore[misc]
    return z, np.diag(np.concatenate([np.array([0.01, 0.05, 5.0, 10.0, 0.02]) ** 2, np.ones(len(HEALTH))]))


def variance(readings: Array) -> Array:
    """R (3, 3) of the outputs at readings (7,).

    Args:
        readings: (7,) in the channels' units, order CHANNELS, none missing.
    """
    white, coloured = output_sd(readings[None])
    return np.diag(white[0] ** 2 + coloured[0] ** 2)


def _numpy_rhs(x: Array, u: Array, theta: Array) -> Array:
    return balance.py_func(x, u, theta, flux.py_func(x, u, theta))


def _all_states(z: Array, u: Array) -> Array:
    """The nominal model's state (8,) at z (10,): the probe and the head have the gas's temperature."""
    T_gas_K = z[STATE.T_gas_K]
    return np.concatenate([z[:N_STATES], [T_gas_K, u[CHANNEL.valve], T_gas_K]])


def numpy_move(z: Array, u: Array) -> Array:
    """One Runge-Kutta step of the equations as they are written, in Python and NumPy.

    Args:
        z: (10,) states in their units, then dimensionless coordinates of health.
        u: (4,) inputs in their units, order INPUTS.
    """
    theta = np.concatenate([to_theta(z[N_STATES:]), CONSTANTS[len(HEALTH) :]])
    x, h = _all_states(z, u), SAMPLE_PERIOD_S
    k1 = _numpy_rhs(x, u, theta)
    k2 = _numpy_rhs(x + 0.5 * h * k1, u, theta)
    k3 = _numpy_rhs(x + 0.5 * h * k2, u, theta)
    k4 = _numpy_rhs(x + h * k3, u, theta)
    return np.concatenate([(x + h / 6.0 * (k1 + 2.0 * (k2 + k3) + k4))[:N_STATES], z[N_STATES:]])


def numpy_observe(z: Array, u: Array) -> Array:
    """What the sensors read, in Python and NumPy.

    Args:
        z: (10,) states in their units, then dimensionless coordinates of health.
        u: (4,) inputs in their units, order INPUTS.
    """
    theta = np.concatenate([to_theta(z[N_STATES:]), CONSTANTS[len(HEALTH) :]])
    return np.asarray(NOMINAL.output(_all_states(z, u), u, theta))


# Bound here, not passed: as an argument an equation costs some 15 us at every call from Python.
_rhs, _output = compiled(NOMINAL).rhs, compiled(NOMINAL).output


@njit(error_model="numpy")
def _whole(z, u):  # type: ignore[no-untyped-def]
    """State (8,) and parameters of the nominal model at z (10,)."""
    theta, x = CONSTANTS.copy(), np.empty(len(X))
    zeta, values, slope = z[N_STATES:].copy().reshape(1, N_HEALTH), np.empty((1, N_HEALTH)), np.empty((1, N_HEALTH))
    map_health(zeta, values, slope)
    theta[:N_HEALTH] = values[0]
    x[:N_STATES] = z[:N_STATES]
    x[X.T_probe_K], x[X.valve_pos], x[X.T_head_K] = z[STATE.T_gas_K], u[CHANNEL.valve], z[STATE.T_gas_K]
    return x, theta


@njit(error_model="numpy")
def numba_move(z, u):  # type: ignore[no-untyped-def]
    """``numpy_move``, compiled."""
    x, theta = _whole(z, u)
    out = z.copy()
    out[:N_STATES] = rk4(_rhs, x, u, theta, SAMPLE_PERIOD_S, 1)[:N_STATES]
    return out


@njit(error_model="numpy")
def numba_observe(z, u):  # type: ignore[no-untyped-def]
    """``numpy_observe``, compiled."""
    x, theta = _whole(z, u)
    return _output(x, u, theta)


def _differences(function: Callable[[Array, Array], Array], z: Array, u: Array) -> Array:
    """Jacobian by forward differences."""
    base = function(z, u)
    return np.stack(
        [(function(z + DIFFERENCE_STEP * one, u) - base) / DIFFERENCE_STEP[j] for j, one in enumerate(np.eye(SIZE))],
        axis=1,
    )


class _EKF(ExtendedKalmanFilter):
    """filterpy leaves the nonlinear forecast to whoever derives."""

    x: Array
    move: Move

    def predict_x(self, u: Array) -> None:
        self.x = self.move(self.x, u)


class FilterpyEKF:
    """filterpy's extended Kalman filter on readings (7,), none missing.

    Args:
        first: (7,) in the channels' units, order CHANNELS, none missing.
        move: z one tick on.
        observe: what the sensors read of z.
    """

    def __init__(self, first: Array, move: Move, observe: Observe) -> None:
        self._filter, self._move, self._observe, self._u = _EKF(SIZE, 3), move, observe, first[:4]
        self._filter.x, self._filter.P = start(first)
        self._filter.Q, self._filter.move = Q, move

    def update(self, readings: Array) -> None:
        """One tick.

        Args:
            readings: (7,) in the channels' units, order CHANNELS, none missing.
        """
        ekf, u = self._filter, readings[:4]
        ekf.F = _differences(self._move, ekf.x, self._u)
        ekf.predict(self._u)
        ekf.update(
            readings[4:], lambda z: _differences(self._observe, z, u), lambda z: self._observe(z, u), variance(readings)
        )
        self._u = u

    @property
    def mean(self) -> Array:
        """z (10,)."""
        return np.asarray(self._filter.x)

    @property
    def cov(self) -> Array:
        """P (10, 10)."""
        return np.asarray(self._filter.P)


class FilterpyUKF:
    """filterpy's unscented Kalman filter on readings (7,), none missing.

    Args:
        first: (7,) in the channels' units, order CHANNELS, none missing.
        move: z one tick on.
        observe: what the sensors read of z.
    """

    def __init__(self, first: Array, move: Move, observe: Observe) -> None:
        points = MerweScaledSigmaPoints(SIZE, ALPHA, beta=2.0, kappa=0.0)
        self._filter = UnscentedKalmanFilter(SIZE, 3, dt=1.0, hx=None, fx=None, points=points)
        self._filter.x, self._filter.P = start(first)
        self._filter.Q = Q
        self._move, self._observe, self._u = move, observe, first[:4]

    def update(self, readings: Array) -> None:
        """One tick.

        Args:
            readings: (7,) in the channels' units, order CHANNELS, none missing.
        """
        before, u = self._u, readings[:4]
        self._filter.predict(fx=lambda z, _: self._move(z, before))
        self._filter.update(readings[4:], R=variance(readings), hx=lambda z: self._observe(z, u))
        self._u = u

    @property
    def mean(self) -> Array:
        """z (10,)."""
        return np.asarray(self._filter.x)

    @property
    def cov(self) -> Array:
        """P (10, 10)."""
        return np.asarray(self._filter.P)
