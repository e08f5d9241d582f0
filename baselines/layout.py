"""Where the parts of what networks predict stand: the estimated states, lags that sensors read, coordinates of health.

Sizes and positions follow from the machine's record, so that a learner is written once.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass

import numpy as np

from twinbench.data.batch import Array, Truth
from twinbench.machines.machine import Machine


@dataclass(frozen=True, eq=False)
class Layout:
    """z of a machine: m states, of which n are estimated and the rest lags, then nh coordinates of health.

    Attributes:
        machine: whose.
        columns: (m,) dimensionless, where the m states stand among the plant's.
        read: (ny,) dimensionless, where the state that an output reads stands in z.
        gains: (ny, m) of the readings, in the outputs' units per unit of the state.
        biases: (ny, nh) bool: health that is added to a reading.
        shift: (m, nh) health that is part of a state of z, in its unit per unit of the parameter; zero unless z holds
            what biased sensors see.
        through: (ny, m) bool: what an output reads, and what that follows as its lag.
        seen: (size,) bool: any of that, and what moves alike.
        least: (m,) lowest values of the states, in their units.
    """

    machine: Machine
    columns: np.ndarray
    read: np.ndarray
    gains: Array
    biases: np.ndarray
    shift: Array
    through: np.ndarray
    seen: np.ndarray
    least: Array

    @functools.cached_property
    def zeta(self) -> int:
        """Where health begins, and how many states there are."""
        return len(self.columns)

    @functools.cached_property
    def size(self) -> int:
        """How many entries z has."""
        return len(self.seen)

    @functools.cached_property
    def keep(self) -> np.ndarray:
        """Positions (n + nh,) in z of the machine's quantities."""
        return np.r_[0 : len(self.machine.estimated), self.zeta : self.size]

    @functools.cached_property
    def zeta_limit(self) -> Array:
        """Bounds (nh,) of the coordinates on either side, dimensionless."""
        return -self.machine.zeta_bounds[0]

    def targets(self, truth: Truth) -> Array:
        """z (B, N, size) of a simulation."""
        zeta = self.machine.coordinates.to_zeta(truth.health)
        return np.concatenate([truth.states[..., self.columns] + truth.health @ self.shift.T, zeta], axis=-1)

    def bounded(self, z: Array) -> Array:
        """A copy (..., size) with health within its coordinates and states no lower than a filter lets them be.

        Args:
            z: (..., size) in the units of z.
        """
        z, limit = z.copy(), self.zeta_limit
        z[..., self.zeta :] = np.clip(z[..., self.zeta :], -limit, limit)
        z[..., : self.zeta] = np.maximum(z[..., : self.zeta], self.least)
        return z

    def readings(self, z: Array) -> Array:
        """What the outputs read, (..., ny) in their units.

        Args:
            z: (..., size) in the units of z.
        """
        y = z[..., : self.zeta] @ self.gains.T
        if not self._added.any():
            return y
        return y + self.machine.coordinates.to_theta(z[..., self.zeta :]) @ self._added.T

    def slopes(self, z: Array) -> Array:
        """Of the readings to z, (B, ny, size).

        Args:
            z: (B, size) in the units of z.
        """
        H = np.zeros((len(z), len(self.gains), self.size))
        H[..., : self.zeta] = self.gains
        if self._added.any():
            _, slope = self.machine.coordinates.theta_and_slope(z[:, self.zeta :])
            H[..., self.zeta :] = self._added * slope[:, None]
        return H

    def freed(self, z: Array, P: Array) -> tuple[Array, Array]:
        """Mean (B, size) and covariance (B, size, size) without the biases of the sensors, where z holds them.

        Args:
            z: (B, size) in the units of z.
            P: (B, size, size) in those units squared.
        """
        theta, slope = self.machine.coordinates.theta_and_slope(z[:, self.zeta :])
        free = z.copy()
        free[:, : self.zeta] -= theta @ self.shift.T
        J = np.tile(np.eye(self.size), (len(z), 1, 1))
        J[:, : self.zeta, self.zeta :] = -self.shift * slope[:, None]
        return free, J @ P @ J.transpose(0, 2, 1)

    @functools.cached_property
    def _added(self) -> Array:
        """(ny, nh) health that a reading has beside what z holds already."""
        return self.biases - self.gains @ self.shift


def layout_of(machine: Machine, as_read: bool = False) -> Layout:
    """The layout of a machine.

    Args:
        machine: whose.
        as_read: states that a biased sensor reads, and what its lag follows, are as the sensor sees them.
    """
    states = [v.name for v in machine.plant.states]
    estimated, health = machine.estimated, machine.health_names
    follows = {lag.state: lag.follows for lag in machine.lags}
    used = {r.state for r in machine.readings}
    lags = [lag.state for lag in machine.lags if lag.state in used or lag.follows in estimated]
    names = [*estimated, *lags]
    gains, biases = np.zeros((len(machine.readings), len(names))), np.zeros((len(machine.readings), len(health)), bool)
    shift, through = np.zeros((len(names), len(health))), np.zeros(gains.shape, bool)
    for i, r in enumerate(machine.readings):
        gains[i, names.index(r.state)] = r.gain
        through[i] = [name in (r.state, follows.get(r.state)) for name in names]
        if r.bias:
            biases[i, health.index(r.bias)] = True
            fresh = as_read & through[i] & ~shift.any(axis=1)
            shift[fresh, health.index(r.bias)] = 1.0 / r.gain
    seen = {name for i, name in enumerate(names) if through[:, i].any()}
    for group in machine.alike:
        seen |= set(group) if seen & set(group) else set()
    return Layout(
        machine=machine,
        columns=np.array([states.index(name) for name in names]),
        read=np.array([names.index(r.state) for r in machine.readings]),
        gains=gains,
        biases=biases,
        shift=shift,
        through=through,
        seen=np.array([name in seen for name in names] + [False] * len(health)),
        least=np.array([machine.least.get(name, -np.inf) for name in names]),
    )


def actuators(machine: Machine) -> tuple[np.ndarray, np.ndarray]:
    """Lags behind an input: where each stands among the plant's states, and where its input among the inputs."""
    states = [v.name for v in machine.plant.states]
    behind = [lag for lag in machine.lags if lag.follows in machine.inputs]
    return (
        np.array([states.index(lag.state) for lag in behind], dtype=np.int64),
        np.array([machine.inputs.index(lag.follows) for lag in behind], dtype=np.int64),
    )


def acting(machine: Machine) -> np.ndarray:
    """(nh,) bool: health that acts on the machine, and not on what a sensor reads alone."""
    return np.array([not h.on_readings for h in machine.health])
