"""The peers of ``bench.latency.peers`` wholly compiled: what is left for anybody's own method to beat."""

from __future__ import annotations

import functools
from collections.abc import Callable

import numpy as np
from numba import njit

from twinbench.baselines.unscented import correct, moments, sigma_points, weights
from twinbench.bench.latency.peers import ALPHA, Model, model_of
from twinbench.machines.coordinates import Array
from twinbench.machines.machine import Machine
from twinbench.methods.kalman import predict_covariance, update
from twinbench.methods.noise import output_sd_of, sheet_of

Tick = Callable[..., tuple[Array, Array]]
"""One tick, compiled: z (n + nh,), P (n + nh, n + nh), sheet, last inputs (nu,), readings (nu + ny,) -> z, P."""


@njit(error_model="numpy")
def _variance(sheet, readings):  # type: ignore[no-untyped-def]
    white, coloured = np.empty(sheet.white.size), np.empty(sheet.white.size)
    output_sd_of(sheet, readings, white, coloured)
    return white**2 + coloured**2


def ekf(model: Model) -> Tick:
    """One tick of the extended Kalman filter."""
    (move, observe), steps, Q = model.numba, model.difference, model.Q
    nu, ny = len(model.machine.inputs), len(model.machine.outputs)

    @njit(error_model="numpy")
    def tick(z, P, sheet, before, readings):  # type: ignore[no-untyped-def]
        u, n = readings[:nu].copy(), z.size
        ahead, F, H = move(z, before), np.empty((n, n)), np.empty((ny, n))
        for j in range(n):
            moved = z.copy()
            moved[j] += steps[j]
            F[:, j] = (move(moved, before) - ahead) / steps[j]
        y = observe(ahead, u)
        for j in range(n):
            moved = ahead.copy()
            moved[j] += steps[j]
            H[:, j] = (observe(moved, u) - y) / steps[j]
        P = predict_covariance(P, F, Q)
        z, P, _, _ = update(ahead, P, readings[nu:] - y, H, np.diag(_variance(sheet, readings)), np.inf)
        return z, P

    return tick


def ukf(model: Model) -> Tick:
    """One tick of the unscented Kalman filter."""
    (move, observe), Q = model.numba, model.Q
    nu, ny = len(model.machine.inputs), len(model.machine.outputs)
    W_MEAN, W_COV = weights(len(Q), ALPHA)

    @njit(error_model="numpy")
    def tick(z, P, sheet, before, readings):  # type: ignore[no-untyped-def]
        u = readings[:nu].copy()
        points = sigma_points(z.reshape(1, -1), P.reshape(1, z.size, -1), ALPHA)
        for k in range(points.shape[1]):
            points[0, k] = move(points[0, k], before)
        mean, cov = moments(points, W_MEAN, W_COV, Q)
        points = sigma_points(mean, cov, ALPHA)
        read = np.empty((1, points.shape[1], ny))
        for k in range(points.shape[1]):
            read[0, k] = observe(points[0, k], u)
        measured, R = readings[nu:].copy().reshape(1, ny), _variance(sheet, readings).reshape(1, ny)
        mean, cov, _, _, _ = correct(mean, cov, points, read, measured, R, W_MEAN, W_COV, np.inf)
        return mean[0], cov[0]

    return tick


@functools.cache
def _compiled(kind: Callable[[Model], Tick], machine: Machine) -> Tick:
    """One for each machine: compiling it takes seconds."""
    return kind(model_of(machine))


class CompiledPeer:
    """One of the two, one call an update.

    Args:
        first: (nu + ny,) in the channels' units, none missing.
        model: of the machine.
        kind: ``ekf`` or ``ukf``.
    """

    def __init__(self, first: Array, model: Model, kind: Callable[[Model], Tick]) -> None:
        machine = model.machine
        self._tick, self._inputs, self._sheet = _compiled(kind, machine), len(machine.inputs), sheet_of(machine)
        self._u = first[: self._inputs].copy()
        self.mean, self.cov = model.start(first)

    def update(self, readings: Array) -> None:
        """One tick.

        Args:
            readings: (nu + ny,) in the channels' units, none missing.
        """
        self.mean, self.cov = self._tick(self.mean, self.cov, self._sheet, self._u, readings)
        self._u = readings[: self._inputs].copy()
