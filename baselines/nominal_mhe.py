"""Moving-horizon estimation with the recalibrated nominal model (Rao, Rawlings and Mayne, 2003).

Every second the readings of the last 20 s are fitted anew: least squares over the state at the window's start and the
process noise of each second, with an extended Kalman filter's arrival cost. Readings are thinned to their means over a
second; the model says what such a mean reads. One Gauss-Newton step a second, from the path of the second before, is
the real-time iteration (Diehl, Bock and Schlöder, 2005): a second is linearised anew twenty times before it leaves the
window. Between the fits the nominal EKF goes on at every tick.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numba import njit

from twinbench.baselines.augmented_model import bound, correct_one, forecast_one, keep_doubt, linearise, measure
from twinbench.baselines.horizon import compose, sweep
from twinbench.baselines.nominal_filter import NominalFilter, advance, read
from twinbench.machines.coordinates import Array
from twinbench.methods.estimator import register
from twinbench.methods.kalman import INNOVATION_CLIP_SD

STAGES, STAGE_S = 20, 1.0
"""Stages in a window, and how long a stage is: 20 s, thinned to 1 Hz. A longer window says more of slow health only
where the model bends much in it, and costs time in proportion."""


class Window(NamedTuple):
    """What is carried between ticks, B machines.

    Attributes:
        start: (B, n) mean of the arrival cost, in the units of z.
        P: (B, n, n) its covariance, in those units squared.
        path: (B, STAGES, n) the state at the start of each stage, as last fitted, in the units of z.
        inputs: (B, STAGES, nu + nu) means of each stage's inputs as read, then their sd, in their units.
        readings: (B, STAGES, ny + ny + ny) means of each stage's outputs, white variance, coloured sd, in their units.
        sums: (B, nu + ny + ny) of the open stage: inputs, outputs in their units, how often each output was read.
        filled: (B, 2) dimensionless: stages that are full, ticks of the open one.
    """

    start: Array
    P: Array
    path: Array
    inputs: Array
    readings: Array
    sums: Array
    filled: np.ndarray


@njit(cache=True, error_model="numpy")
def _stage(rhs, output, model, ticks, z, inputs, coloured):  # type: ignore[no-untyped-def]
    """Outcome, slope and noise of a stage of so many ticks from z (n,), as ``sweep`` takes them."""
    n, nu, ny = z.size, inputs.size // 2, coloured.size
    size = n + ny
    u = inputs[:nu].copy()
    _, F, noise = linearise(rhs, model, z, u, inputs[nu:].copy())
    outcome, at = np.zeros(size), z
    for _ in range(ticks):
        at = advance(rhs, model, at, u)
        outcome[n:] += read(output, model, at, u, coloured) / ticks
    outcome[:n] = at
    _, H, _ = measure(output, model, at, u, np.zeros(ny), coloured, coloured)
    reach = np.zeros((size, n))
    reach[:n] = np.eye(n)
    reach[n:] = H / ticks
    tick = np.zeros((size, size))
    tick[:, :n] = reach @ F
    tick[n:, n:] = np.eye(ny)
    whole, spread = compose(tick, reach @ noise @ reach.T, ticks)
    return outcome, whole[:, :n].copy(), spread


@njit(cache=True, error_model="numpy")
def _fit(rhs, output, model, ticks, w, b, full):  # type: ignore[no-untyped-def]
    """Move machine b's path by a Gauss-Newton step over its ``full`` stages of so many ticks; as ``sweep``."""
    n, ny = w.start.shape[1], w.readings.shape[2] // 3
    size = n + ny
    outcome, A, Q = np.empty((full, size)), np.empty((full, size, n)), np.empty((full, size, size))
    for i in range(full):
        bound(model, w.path[b, i])
        outcome[i], A[i], Q[i] = _stage(
            rhs, output, model, ticks, w.path[b, i].copy(), w.inputs[b, i], w.readings[b, i, 2 * ny :].copy()
        )
    readings = w.readings[b, :full]
    return sweep(
        w.start[b], w.P[b], w.path[b, :full], outcome, A, Q,
        readings[:, :ny].copy(), readings[:, ny : 2 * ny].copy(), INNOVATION_CLIP_SD,
    )  # fmt: skip


@njit(cache=True, error_model="numpy")
def _close(ticks, w, b, u_sd, white, coloured):  # type: ignore[no-untyped-def]
    """The open stage of machine b is full: keep its means. An output that was missing half of the time has none."""
    i, sums, nu, ny = w.filled[b, 0], w.sums[b], u_sd.size, white.size
    w.inputs[b, i, :nu] = sums[:nu] / ticks
    w.inputs[b, i, nu:] = u_sd
    for c in range(ny):
        times = sums[nu + ny + c]
        w.readings[b, i, c] = sums[nu + c] / times if 2 * times >= ticks else np.nan
        w.readings[b, i, ny + c] = white[c] ** 2 / max(times, 1.0)
        w.readings[b, i, 2 * ny + c] = coloured[c]
    w.sums[b] = 0.0
    w.filled[b, 0] += 1
    w.filled[b, 1] = 0


@njit(cache=True, error_model="numpy")
def _slide(w, b, z, covs):  # type: ignore[no-untyped-def]
    """Leave machine b's oldest stage; the filter's step through it, to z[1] and covs[1], is the arrival cost."""
    w.start[b], w.P[b] = z[1], covs[1]
    for part in (w.path[b], w.inputs[b], w.readings[b]):
        part[:-1] = part[1:].copy()
    w.filled[b, 0] -= 1


@njit(cache=True, error_model="numpy")
def _sound(z, covs):  # type: ignore[no-untyped-def]
    """Is a fit to be believed? Under absurd readings the model may explode within a second; the window begins anew."""
    if not (np.isfinite(z).all() and np.isfinite(covs).all()):
        return False
    sd = np.sqrt(np.maximum(np.diag(covs[-1]), 1e-30))
    return np.linalg.eigvalsh(covs[-1] / np.outer(sd, sd))[0] > -1e-9


@njit(cache=True, error_model="numpy")
def _tick(rhs, output, model, ticks, z, P, started, w, told, info):  # type: ignore[no-untyped-def]
    before, now, u_sd, measured, white, coloured = told
    nu, ny = before.shape[1], measured.shape[1]
    none_out = np.zeros(ny, np.int64)
    for b in range(z.shape[0]):
        if started[b]:
            z[b], P[b], _ = forecast_one(rhs, model, z[b], P[b], before[b], u_sd[b])
        z[b], P[b], info[0][b], info[1][b], info[2][b] = correct_one(
            output, model, z[b], P[b], now[b], measured[b], white[b], coloured[b], none_out
        )
        keep_doubt(model, P[b])
        if not started[b]:
            w.start[b], w.P[b], w.path[b, 0] = z[b], P[b], z[b]
            continue
        w.sums[b, :nu] += before[b]
        for c in range(ny):
            if not np.isnan(measured[b, c]):
                w.sums[b, nu + c] += measured[b, c]
                w.sums[b, nu + ny + c] += 1.0
        w.filled[b, 1] += 1
        if w.filled[b, 1] < ticks:
            continue
        _close(ticks, w, b, u_sd[b], white[b], coloured[b])
        full = w.filled[b, 0]
        means, covs = _fit(rhs, output, model, ticks, w, b, full)
        if _sound(means, covs):
            z[b], P[b] = means[full], covs[full]
            bound(model, z[b])
            if full == STAGES:
                _slide(w, b, means, covs)
        else:
            w.start[b], w.P[b], w.filled[b, 0] = z[b], P[b], 0
        w.path[b, w.filled[b, 0]] = z[b]


@register
class NominalMHE(NominalFilter):
    """What the same engineer would run who can afford to think the last 20 s over again every second."""

    name = "nominal_mhe"
    says = "moving-horizon estimation over 20 s with the recalibrated reduced-order model"

    def restore(self) -> None:
        """As the nominal EKF, and how many ticks a stage has."""
        super().restore()
        self._ticks = max(1, round(STAGE_S / self.machine.sample_period_s))
        self.window = STAGES * self._ticks

    def fresh(self, z: Array, P: Array) -> tuple[np.ndarray, ...]:
        """An empty window of each machine."""
        (batch, n), nu, ny = z.shape, len(self.machine.inputs), len(self.machine.outputs)
        shapes = ((STAGES, n), (STAGES, 2 * nu), (STAGES, 3 * ny), (nu + 2 * ny,))
        return (z, P, *(np.zeros((batch, *s)) for s in shapes), np.zeros((batch, 2), np.int64))

    def tick(
        self,
        z: Array,
        P: Array,
        started: np.ndarray,
        own: tuple[np.ndarray, ...],
        told: tuple[Array, ...],
        info: tuple[Array, ...],
    ) -> tuple[np.ndarray, ...]:
        """One step of the EKF; once a second, fit the window."""
        window = Window(*(part.copy() for part in own))
        _tick(self._rhs, self._output, self._model, self._ticks, z, P, started, window, told, info)
        return tuple(window)

    @staticmethod
    def toy_filter(
        F: Array, H: Array, Q: Array, R: Array, x0: Array, P0: Array
    ) -> Callable[[Array], tuple[Array, Array]]:
        """A window of 20 stages of one tick on a linear machine.

        Args:
            F: (n, n) how a tick moves the state, in the states' units.
            H: (m, n) slope of the readings, a sensor's unit per unit of the state.
            Q: (n, n) covariance of a tick's process noise, in the states' units squared.
            R: (m, m) covariance of the measurement noise, in the sensors' units squared; diagonal.
            x0: (n,) mean before the first prediction, each in its state's unit.
            P0: (n, n) covariance before the first prediction, in the states' units squared.
        """
        reach = np.vstack([np.eye(len(x0)), H])
        A, noise, variance = reach @ F, reach @ Q @ reach.T, np.diag(R)

        def run(measured: Array) -> tuple[Array, Array]:
            start, P, path = x0, P0, x0[None].copy()
            means, covs = np.empty((len(measured), len(x0))), np.empty((len(measured), *P0.shape))
            for k in range(len(measured)):
                count = len(path)
                seen = measured[k + 1 - count : k + 1].copy()
                slope, spread, white = (np.repeat(part[None], count, axis=0) for part in (A, noise, variance))
                z, P_at = sweep(start, P, path, path @ A.T, slope, spread, seen, white, np.inf)
                means[k], covs[k] = z[-1], P_at[-1]
                if count == STAGES:
                    start, P, path = z[1], P_at[1], path[1:]
                path = np.vstack([path, z[-1]])
            return means, covs

        return run
