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
from twinbench.baselines.model_ekf import NONE_OUT
from twinbench.baselines.nominal_filter import NominalFilter, advance, read
from twinbench.data.batch import INPUTS, OUTPUTS, Array
from twinbench.methods.estimator import register
from twinbench.methods.kalman import INNOVATION_CLIP_SD

STAGES, STAGE_TICKS = 20, 20
"""Stages in a window, and ticks in a stage: 20 s, thinned to 1 Hz. A longer window says more of slow health only where
the model bends much in it, and costs time in proportion."""
N_U, N_Y = len(INPUTS), len(OUTPUTS)


class Window(NamedTuple):
    """What is carried between ticks, B machines.

    Attributes:
        start: (B, n) mean of the arrival cost, in the units of z.
        P: (B, n, n) its covariance, in those units squared.
        path: (B, STAGES, n) the state at the start of each stage, as last fitted, in the units of z.
        inputs: (B, STAGES, 8) means of each stage's inputs as read, then their sd, in their units.
        readings: (B, STAGES, 9) means of each stage's outputs, their white variance and coloured sd, in their units.
        sums: (B, 10) of the open stage: inputs, outputs in their units, how often each output was read.
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
def _stage(rhs, output, model, z, inputs, coloured):  # type: ignore[no-untyped-def]
    """Outcome, slope and noise of a stage from z (n,), as ``sweep`` takes them."""
    n, size = z.size, z.size + N_Y
    u = inputs[:N_U].copy()
    _, F, noise = linearise(rhs, model, z, u, inputs[N_U:].copy())
    outcome, at = np.zeros(size), z
    for _ in range(STAGE_TICKS):
        at = advance(rhs, model, at, u)
        outcome[n:] += read(output, model, at, u, coloured) / STAGE_TICKS
    outcome[:n] = at
    _, H, _ = measure(output, model, at, u, np.zeros(N_Y), coloured, coloured)
    reach = np.zeros((size, n))
    reach[:n] = np.eye(n)
    reach[n:] = H / STAGE_TICKS
    tick = np.zeros((size, size))
    tick[:, :n] = reach @ F
    tick[n:, n:] = np.eye(N_Y)
    whole, spread = compose(tick, reach @ noise @ reach.T, STAGE_TICKS)
    return outcome, whole[:, :n].copy(), spread


@njit(cache=True, error_model="numpy")
def _fit(rhs, output, model, w, b, full):  # type: ignore[no-untyped-def]
    """Move machine b's path by a Gauss-Newton step over its ``full`` stages; as ``sweep``."""
    n = w.start.shape[1]
    size = n + N_Y
    outcome, A, Q = np.empty((full, size)), np.empty((full, size, n)), np.empty((full, size, size))
    for i in range(full):
        bound(model, w.path[b, i])
        outcome[i], A[i], Q[i] = _stage(
            rhs, output, model, w.path[b, i].copy(), w.inputs[b, i], w.readings[b, i, 2 * N_Y :].copy()
        )
    readings = w.readings[b, :full]
    return sweep(
        w.start[b], w.P[b], w.path[b, :full], outcome, A, Q,
        readings[:, :N_Y].copy(), readings[:, N_Y : 2 * N_Y].copy(), INNOVATION_CLIP_SD,
    )  # fmt: skip


@njit(cache=True, error_model="numpy")
def _close(w, b, u_sd, white, coloured):  # type: ignore[no-untyped-def]
    """The open stage of machine b is full: keep its means. An output that was missing half of the time has none."""
    i, sums = w.filled[b, 0], w.sums[b]
    w.inputs[b, i, :N_U] = sums[:N_U] / STAGE_TICKS
    w.inputs[b, i, N_U:] = u_sd
    for c in range(N_Y):
        times = sums[N_U + N_Y + c]
        w.readings[b, i, c] = sums[N_U + c] / times if 2 * times >= STAGE_TICKS else np.nan
        w.readings[b, i, N_Y + c] = white[c] ** 2 / max(times, 1.0)
        w.readings[b, i, 2 * N_Y + c] = coloured[c]
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
def _tick(rhs, output, model, z, P, started, w, told, info):  # type: ignore[no-untyped-def]
    before, now, u_sd, measured, white, coloured = told
    for b in range(z.shape[0]):
        if started[b]:
            z[b], P[b], _ = forecast_one(rhs, model, z[b], P[b], before[b], u_sd[b])
        z[b], P[b], info[0][b], info[1][b], info[2][b] = correct_one(
            output, model, z[b], P[b], now[b], measured[b], white[b], coloured[b], NONE_OUT
        )
        keep_doubt(model, P[b])
        if not started[b]:
            w.start[b], w.P[b], w.path[b, 0] = z[b], P[b], z[b]
            continue
        w.sums[b, :N_U] += before[b]
        for c in range(N_Y):
            if not np.isnan(measured[b, c]):
                w.sums[b, N_U + c] += measured[b, c]
                w.sums[b, N_U + N_Y + c] += 1.0
        w.filled[b, 1] += 1
        if w.filled[b, 1] < STAGE_TICKS:
            continue
        _close(w, b, u_sd[b], white[b], coloured[b])
        full = w.filled[b, 0]
        means, covs = _fit(rhs, output, model, w, b, full)
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
    window = STAGES * STAGE_TICKS

    def fresh(self, z: Array, P: Array) -> tuple[np.ndarray, ...]:
        """An empty window of each machine."""
        batch, n = z.shape
        shapes = ((STAGES, n), (STAGES, 2 * N_U), (STAGES, 3 * N_Y), (N_U + 2 * N_Y,))
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
        _tick(self._rhs, self._output, self._model, z, P, started, window, told, info)
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
