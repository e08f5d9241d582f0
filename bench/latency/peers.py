"""Peers: filterpy's EKF and UKF on the same machine, with its reduced model in NumPy and in numba.

z = [the estimated states, coordinates zeta of health]. The model is the machine's reduced one, one Runge-Kutta step a
tick. What lags is where it follows to; other states behind the estimated ones stay at their nominal values. Noise is
the data sheet's and the baselines'. The filters are filterpy's own ``predict`` and ``update``, the EKF's Jacobians
forward differences of the same model.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from filterpy.kalman import ExtendedKalmanFilter, MerweScaledSigmaPoints, UnscentedKalmanFilter
from numba import njit

from twinbench.machines.coordinates import Array, Coordinates, map_one
from twinbench.machines.machine import Machine
from twinbench.methods.noise import health_walk_var, output_sd, sheet_of
from twinbench.physics.compile import compiled
from twinbench.physics.integrate import rk4
from twinbench.physics.simulator import Equation, Simulator

ALPHA = 0.5
"""Spread of the sigma points, as ``baselines.pinn_ukf`` has it."""
STATE_STEP, ZETA_STEP = 1e-4, 1e-3
"""Of the forward differences: of a state's scale, and in the coordinates of health."""

Move = Callable[[Array, Array], Array]
"""z (n + nh,) one tick on under inputs (nu,)."""
Observe = Callable[[Array, Array], Array]
"""Readings (ny,) of z (n + nh,) under inputs (nu,)."""


class Model(NamedTuple):
    """A machine's reduced model as the peers take it.

    Attributes:
        machine: of which.
        Q: (n + nh, n + nh) covariance of a tick's process noise, in the states' units and coordinates, squared.
        difference: (n + nh,) steps of the forward differences, in the states' units and coordinates.
        written: move and observe in Python and NumPy, as they are written.
        numba: the same, compiled.
    """

    machine: Machine
    Q: Array
    difference: Array
    written: tuple[Move, Observe]
    numba: tuple[Move, Observe]

    def start(self, readings: Array) -> tuple[Array, Array]:
        """z (n + nh,) and P (n + nh, n + nh) of a healthy machine at its first readings.

        Args:
            readings: (nu + ny,) in the channels' units, none missing.
        """
        machine, nu, n = self.machine, len(self.machine.inputs), len(self.machine.estimated)
        reduced = machine.reduced
        z = np.zeros(len(machine.quantities))
        z[:n] = reduced.initial(readings[:nu], readings[nu:], reduced.theta())[:n]
        return z, np.diag(np.concatenate([machine.states_spread**2, np.ones(len(z) - n)]))

    def variance(self, readings: Array) -> Array:
        """R (ny, ny) of the outputs at readings.

        Args:
            readings: (nu + ny,) in the channels' units, none missing.
        """
        white, coloured = output_sd(sheet_of(self.machine), readings[None])
        return np.diag(white[0] ** 2 + coloured[0] ** 2)


@functools.cache
def model_of(machine: Machine) -> Model:
    """One for each machine: compiling it takes seconds."""
    n, nh = len(machine.estimated), len(machine.health)
    scale = np.array([v.scale for v in machine.reduced.states[:n]])
    walk = machine.states_walk[:n] ** 2 * machine.sample_period_s
    return Model(
        machine,
        np.diag(np.concatenate([walk, health_walk_var(machine, 1.0)])),
        np.concatenate([STATE_STEP * scale, np.full(nh, ZETA_STEP)]),
        _written(machine),
        _compiled(machine),
    )


class _Places(NamedTuple):
    """Where things stand in the reduced model.

    Attributes:
        health: (nh,) in theta.
        lags: (n_lags,) among the states.
        follow: (n_lags,) what each follows, among the estimated states and then the inputs.
    """

    health: np.ndarray
    lags: np.ndarray
    follow: np.ndarray


def _places(machine: Machine) -> _Places:
    states = [v.name for v in machine.reduced.states]
    followed = [*machine.estimated, *machine.inputs]
    return _Places(
        np.array([machine.reduced.index(name) for name in machine.health_names]),
        np.array([states.index(lag.state) for lag in machine.lags], dtype=np.int64),
        np.array([followed.index(lag.follows) for lag in machine.lags], dtype=np.int64),
    )


def _written(machine: Machine) -> tuple[Move, Observe]:
    """The equations as they are written, in Python and NumPy."""
    reduced, places, n = machine.reduced, _places(machine), len(machine.estimated)
    rhs, output, h = _plain_rhs(reduced), _plain(reduced.output), machine.sample_period_s

    def whole(z: Array, u: Array) -> tuple[Array, Array]:
        theta = reduced.theta()
        theta[places.health] = machine.coordinates.to_theta(z[n:])
        x = np.array([v.nominal for v in reduced.states])
        x[:n] = z[:n]
        x[places.lags] = np.concatenate([z[:n], u])[places.follow]
        return x, theta

    def move(z: Array, u: Array) -> Array:
        x, theta = whole(z, u)
        k1 = rhs(x, u, theta)
        k2 = rhs(x + 0.5 * h * k1, u, theta)
        k3 = rhs(x + 0.5 * h * k2, u, theta)
        k4 = rhs(x + h * k3, u, theta)
        return np.concatenate([(x + h / 6.0 * (k1 + 2.0 * (k2 + k3) + k4))[:n], z[n:]])

    def observe(z: Array, u: Array) -> Array:
        x, theta = whole(z, u)
        return np.asarray(output(x, u, theta))

    return move, observe


def _plain_rhs(simulator: Simulator) -> Equation:
    if simulator.flux is None or simulator.balance is None:
        assert simulator.rhs is not None
        return _plain(simulator.rhs)
    flux, balance = _plain(simulator.flux), _plain(simulator.balance)
    return lambda x, u, theta: balance(x, u, theta, flux(x, u, theta))


def _plain(function: Callable[..., Array]) -> Callable[..., Array]:
    """What a compiled function was written as."""
    return getattr(function, "py_func", function)  # type: ignore[no-any-return]


def _compiled(machine: Machine) -> tuple[Move, Observe]:
    # Bound here, not passed: as an argument an equation costs some 15 us at every call from Python.
    rhs, output, _ = compiled(machine.reduced)
    n, nh, period_s = len(machine.estimated), len(machine.health), machine.sample_period_s
    healthy, low, high, exponential, slope, offset = machine.coordinates
    health, lags, follow = _places(machine)
    constants, nominal = machine.reduced.theta(), np.array([v.nominal for v in machine.reduced.states])

    @njit(error_model="numpy")
    def whole(z, u):  # type: ignore[no-untyped-def]
        theta, x = constants.copy(), nominal.copy()
        own = Coordinates(healthy, low, high, exponential, slope, offset)
        for j in range(nh):
            theta[health[j]] = map_one(own, j, z[n + j])[0]
        x[:n] = z[:n]
        for i in range(lags.size):
            x[lags[i]] = z[follow[i]] if follow[i] < n else u[follow[i] - n]
        return x, theta

    @njit(error_model="numpy")
    def move(z, u):  # type: ignore[no-untyped-def]
        x, theta = whole(z, u)
        out = z.copy()
        out[:n] = rk4(rhs, x, u, theta, period_s, 1)[:n]
        return out

    @njit(error_model="numpy")
    def observe(z, u):  # type: ignore[no-untyped-def]
        x, theta = whole(z, u)
        return output(x, u, theta)

    return move, observe


def _differences(function: Callable[[Array, Array], Array], z: Array, u: Array, steps: Array) -> Array:
    """Jacobian by forward differences."""
    base = function(z, u)
    ones = np.eye(len(z))
    return np.stack([(function(z + steps * one, u) - base) / steps[j] for j, one in enumerate(ones)], axis=1)


class _EKF(ExtendedKalmanFilter):
    """filterpy leaves the nonlinear forecast to whoever derives."""

    x: Array
    move: Move

    def predict_x(self, u: Array) -> None:
        self.x = self.move(self.x, u)


class FilterpyEKF:
    """filterpy's extended Kalman filter on readings, none missing.

    Args:
        first: (nu + ny,) in the channels' units, none missing.
        model: of the machine.
        functions: its ``written`` or ``numba`` ones.
    """

    def __init__(self, first: Array, model: Model, functions: tuple[Move, Observe]) -> None:
        machine = model.machine
        self._model, (self._move, self._observe), self._inputs = model, functions, len(machine.inputs)
        self._filter, self._u = _EKF(len(machine.quantities), len(machine.outputs)), first[: self._inputs]
        self._filter.x, self._filter.P = model.start(first)
        self._filter.Q, self._filter.move = model.Q, self._move

    def update(self, readings: Array) -> None:
        """One tick.

        Args:
            readings: (nu + ny,) in the channels' units, none missing.
        """
        ekf, u, steps = self._filter, readings[: self._inputs], self._model.difference
        ekf.F = _differences(self._move, ekf.x, self._u, steps)
        ekf.predict(self._u)
        ekf.update(
            readings[self._inputs :],
            lambda z: _differences(self._observe, z, u, steps),
            lambda z: self._observe(z, u),
            self._model.variance(readings),
        )
        self._u = u

    @property
    def mean(self) -> Array:
        """z (n + nh,)."""
        return np.asarray(self._filter.x)

    @property
    def cov(self) -> Array:
        """P (n + nh, n + nh)."""
        return np.asarray(self._filter.P)


class FilterpyUKF:
    """filterpy's unscented Kalman filter on readings, none missing; arguments as of ``FilterpyEKF``.

    Args:
        first: (nu + ny,) in the channels' units, none missing.
        model: of the machine.
        functions: its ``written`` or ``numba`` ones.
    """

    def __init__(self, first: Array, model: Model, functions: tuple[Move, Observe]) -> None:
        machine = model.machine
        self._model, (self._move, self._observe), self._inputs = model, functions, len(machine.inputs)
        size = len(machine.quantities)
        points = MerweScaledSigmaPoints(size, ALPHA, beta=2.0, kappa=0.0)
        self._filter = UnscentedKalmanFilter(size, len(machine.outputs), dt=1.0, hx=None, fx=None, points=points)
        self._filter.x, self._filter.P = model.start(first)
        self._filter.Q, self._u = model.Q, first[: self._inputs]

    def update(self, readings: Array) -> None:
        """One tick.

        Args:
            readings: (nu + ny,) in the channels' units, none missing.
        """
        before, u = self._u, readings[: self._inputs]
        self._filter.predict(fx=lambda z, _: self._move(z, before))
        R = self._model.variance(readings)
        self._filter.update(readings[self._inputs :], R=R, hx=lambda z: self._observe(z, u))
        self._u = u

    @property
    def mean(self) -> Array:
        """z (n + nh,)."""
        return np.asarray(self._filter.x)

    @property
    def cov(self) -> Array:
        """P (n + nh, n + nh)."""
        return np.asarray(self._filter.P)
