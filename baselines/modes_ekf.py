"""Interacting multiple models over how health moves and which sensor fails, with any Simulator as the model.

An extended Kalman filter for each mode of ``methods.modes``. They differ in how fast each health parameter walks and in
which output they believe. The equations are linearised once a tick, at the common mean of all. Each mode on its own, by
the equations themselves, errs no less on validation recordings of two machines, and takes half as long again.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, ClassVar

import numpy as np
from numba import njit

from twinbench.baselines.augmented_model import bound, keep_doubt, linearise, measure
from twinbench.baselines.model_ekf import ModelEKF
from twinbench.baselines.nominal_filter import nis_of
from twinbench.machines.coordinates import Array
from twinbench.methods.estimator import FLAG_GATED, Info, Sample, State
from twinbench.methods.frontend import Memory
from twinbench.methods.kalman import INNOVATION_CLIP_SD, carry_into, room_for, update_into
from twinbench.methods.mixing import (
    FAILS_FROM,
    Failing,
    failure,
    follow_into,
    linear_modes,
    log_likelihood,
    merge_into,
    mix,
    weigh_into,
)
from twinbench.methods.modes import at_first, modes_of
from twinbench.methods.reporting import clean_flags


@njit(cache=True, error_model="numpy")
def _foresee(model, modes, F, Q, z, P, before, centre):  # type: ignore[no-untyped-def]
    """Every mode's z (M, n) and P (M, n, n) a tick on, in place: the equations are linear about their common mean.

    The function takes plain arrays because it is compiled.

    Args:
        before: (n,) the common mean.
        centre: (n,) where the equations take it.
    """
    count, n = z.shape
    apart, FP = np.empty(n), np.empty((n, n))
    for j in range(count):
        follow_into(z[j], F, before, centre, apart)
        carry_into(P[j], F, model.step.size, FP)
        for i in range(n):
            for k in range(n):
                P[j, i, k] += Q[i, k] + modes.walk[j, i, k]


@njit(cache=True, error_model="numpy")
def _tell(ahead, innovation, S, mean, cov):  # type: ignore[no-untyped-def]
    """The mixture's innovation (ny,) and its covariance (ny, ny); NaN where a reading is missing, under every mode.

    The function takes plain arrays because it is compiled.

    Args:
        ahead: (M,) probabilities before the readings.
        innovation: (M, ny) of each mode.
        S: (M, ny, ny) its covariance.
    """
    missing = np.isnan(innovation[0])
    for c in range(mean.size):
        if missing[c]:
            innovation[:, c] = 0.0
    merge_into(ahead, innovation, S, mean, cov)
    for c in range(mean.size):
        if missing[c]:
            mean[c] = np.nan


@njit(cache=True, error_model="numpy")
def tick_modes(rhs, output, model, modes, z, P, started, carried, told, info):  # type: ignore[no-untyped-def]
    """B machines a tick on, in place.

    The function takes plain arrays because it is compiled.

    Args:
        modes: walk (M, n, n) as process noise of z, the rest as in ``methods.modes.Modes``.
        carried: of the modes, as ``undecided`` gives them.
        told: what ``filter_inputs`` gives.
        info: innovation (B, ny), S (B, ny, ny) and NIS (B,) are written here.
    """
    before, now, u_sd, measured, white, coloured = told
    out, (mu, zs, Ps, offset) = modes.out, carried
    (count, ny), n = out.shape, z.shape[1]
    innovation, S, score = np.empty((count, ny)), np.empty((count, ny, ny)), np.empty(count)
    L, y, noise_var, used, room = np.empty((ny, ny)), np.empty(ny), np.empty(ny), np.empty(ny), room_for(n, ny)
    for b in range(z.shape[0]):
        ahead, stays, centre = mu[b].copy(), np.zeros(count), z[b].copy()
        if started[b]:
            ahead, stays, zs[b], Ps[b] = mix(mu[b], modes, zs[b], Ps[b])
            centre, F, Q = linearise(rhs, model, z[b], before[b], u_sd[b])
            _foresee(model, modes, F, Q, zs[b], Ps[b], z[b], centre)
        expected, H, R = measure(output, model, centre, now[b], measured[b], white[b], coloured[b])
        for c in range(ny):
            noise_var[c] = R[c, c] + coloured[b, c] ** 2
        for j in range(count):
            for c in range(ny):
                innovation[j, c] = expected[c]
                for i in range(n):
                    innovation[j, c] -= H[c, i] * (zs[b, j, i] - centre[i])
                used[c] = np.nan if out[j, c] > 0 else innovation[j, c]
            update_into(zs[b, j], Ps[b, j], used, H, R, INNOVATION_CLIP_SD, room)
            S[j] = room[1]
            keep_doubt(model, Ps[b, j])
            bound(model, zs[b, j])
            failing = Failing(offset[b, j], noise_var, modes.wander)
            score[j] = log_likelihood(innovation[j], S[j], out[j], modes.lasts[j] * stays[j], failing, L, y)
        weigh_into(ahead, score, mu[b])
        merge_into(mu[b], zs[b], Ps[b], z[b], P[b])
        _tell(ahead, innovation, S, info[0][b], info[1][b])
        for c in range(ny):
            used[c] = np.nan if failure(mu[b], out, c) > FAILS_FROM else info[0][b, c]
        info[2][b] = nis_of(used, info[1][b])
        started[b] = True


class ModesEKF(ModelEKF):
    """Base of the filters that know in what ways health moves; a subclass says with which model in ``simulator``.

    ``health_walk`` is the walk of a parameter that ramps, ``still`` what that is multiplied by for one that stands
    still, and ``leap`` the standard deviation of a leap, in typical changes.
    """

    settings: ClassVar[dict[str, Any]] = {
        **{name: value for name, value in ModelEKF.settings.items() if name != "implementation"},
        "still": 0.05,
        "leap": 2.0,
    }
    search_space: ClassVar[dict[str, Sequence[float]]] = {
        **ModelEKF.search_space,
        "still": (0.01, 0.5),
        "leap": (0.5, 10.0),
    }
    online = ModelEKF.online | {"still", "leap"}

    def restore(self) -> None:
        """As the base class, and the modes; how health walks is theirs."""
        super().restore()
        modes = modes_of(self.machine, *(self.config[k] for k in ("health_walk", "still", "leap")))
        at = np.arange(len(self._model.step), self._sensor)
        Q = self._model.Q.copy()
        Q[at, at] = 0.0
        self._model = self._model._replace(Q=Q)
        walk = np.zeros((len(modes.walk), *Q.shape))
        walk[:, at, at] = modes.walk
        self._modes = modes._replace(walk=walk)

    def init(self, batch: int) -> State:
        """As the base class. Every mode begins alike, and no sensor fails."""
        z, P, started, *front = super().init(batch).memory
        return self._report(z, P, (started, *self.undecided(z, P), *front))

    def undecided(self, z: Array, P: Array) -> tuple[Array, Array, Array, Array]:
        """Of the modes, probabilities (B, M), means (B, M, n), covariances (B, M, n, n) and offsets (B, M, 2) of the
        output that fails, before the first sample.

        Args:
            z: (B, n) mean of the prior, in the units of z.
            P: (B, n, n) its covariance, in those units squared.
        """
        count = len(self._modes.walk)
        mu, offset = np.tile(at_first(self._modes), (len(z), 1)), np.zeros((len(z), count, 2))
        return mu, np.repeat(z[:, None], count, axis=1), np.repeat(P[:, None], count, axis=1), offset

    def step(self, state: State, sample: Sample) -> tuple[State, Info]:
        """Mix, run every mode's filter, weigh, merge."""
        ends = len(state.memory) - len(Memory._fields)
        front, clean = self._front_end.step(Memory(*state.memory[ends:]), sample.measured)
        z, P, started, *modes = (part.copy() for part in state.memory[:ends])
        carried, info = tuple(modes), self.blank_info(len(z))
        equations = self._rhs, self._output, self._model
        tick_modes(*equations, self._modes, z, P, started, carried, self.told(clean), info)
        failed = carried[0] @ self._modes.out > FAILS_FROM
        accepted = clean.accepted[:, len(self.machine.inputs) :] & ~failed
        flags = clean_flags(clean) | np.where(failed.any(axis=1), FLAG_GATED, 0)
        return self._report(z, P, (started, *carried, *front)), Info(*info, accepted, flags, clean.age_s)

    @staticmethod
    def toy_filter(
        F: Array, H: Array, Q: Array, R: Array, x0: Array, P0: Array
    ) -> Callable[[Array], tuple[Array, Array]]:
        """Modes that do not differ are one Kalman filter.

        Args:
            F: (n, n) how a tick moves the state, in the states' units.
            H: (m, n) slope of the readings, a sensor's unit per unit of the state.
            Q: (n, n) covariance of a tick's process noise, in the states' units squared.
            R: (m, m) covariance of the measurement noise, in the sensors' units squared.
            x0: (n,) mean before the first prediction, each in its state's unit.
            P0: (n, n) covariance before the first prediction, in the states' units squared.
        """
        turn = np.array([[0.9, 0.1], [0.2, 0.8]])
        return linear_modes(F, H, np.repeat(Q[None], len(turn), axis=0), R, x0, P0, turn)
