"""Interacting multiple models over how health wears (Blom and Bar-Shalom, 1988), on the recalibrated nominal model.

Three extended Kalman filters run side by side. They differ in how fast health walks: it stands still, it ramps, or it
leaps. Each tick they start from a mixture of each other, by a Markov chain of the modes, and are weighed by how likely
each found the readings. What is reported has the mixture's moments.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, ClassVar

import numpy as np
from numba import njit

from twinbench.baselines.augmented_model import correct_one, forecast_one, keep_doubt
from twinbench.baselines.nominal_filter import NominalFilter, density, surprise
from twinbench.machines.coordinates import Array
from twinbench.methods.estimator import register
from twinbench.methods.kalman import INNOVATION_CLIP_SD, predict_covariance, update
from twinbench.methods.noise import health_walk_var

STAY_S = np.array([300.0, 300.0, 5.0])
"""How long still, ramping and leaping last on average. Half or twice as long for a leap shares its variance among
fewer or more ticks, and decides how long a filter has to recognise it; the others matter little."""
NEXT = np.array([[0.0, 0.7, 0.3], [0.9, 0.0, 0.1], [0.5, 0.5, 0.0]])
"""Dimensionless: which mode follows which. Ramps are commoner than leaps; what has ramped mostly stands still after."""


def chain(tick_s: float) -> Array:
    """Probabilities (3, 3) of going from one mode to another in a tick of so many seconds."""
    leave = np.minimum(tick_s / STAY_S[:, None], 1.0)
    return leave * NEXT + (1.0 - leave) * np.eye(len(STAY_S))


@njit(cache=True, error_model="numpy")
def merge(mu, z, P):  # type: ignore[no-untyped-def]
    """Mean (n,) and covariance (n, n) of a mixture with weights mu (M,), means (M, n) and covariances (M, n, n)."""
    mean = np.zeros(z.shape[1])
    for j in range(mu.size):
        mean += mu[j] * z[j]
    cov = np.zeros(P.shape[1:])
    for j in range(mu.size):
        apart = z[j] - mean
        cov += mu[j] * (P[j] + np.outer(apart, apart))
    return mean, cov


@njit(cache=True, error_model="numpy")
def mix(mu, turn, z, P):  # type: ignore[no-untyped-def]
    """Each mode's start of a tick: its probability (M,), mean (M, n) and covariance (M, n, n).

    Args:
        mu: (M,) probabilities of the modes at the tick before.
        turn: (M, M) dimensionless, of going from one to another.
        z: (M, n) their means, in the filter's coordinates.
        P: (M, n, n) their covariances.
    """
    ahead, z_mixed, P_mixed = mu @ turn, np.empty_like(z), np.empty_like(P)
    for j in range(mu.size):
        z_mixed[j], P_mixed[j] = merge(mu * turn[:, j] / ahead[j], z, P)
    return ahead, z_mixed, P_mixed


@njit(cache=True, error_model="numpy")
def weigh(ahead, log_density):  # type: ignore[no-untyped-def]
    """Probabilities (M,) of the modes after the readings, from those before them and the log densities (M,)."""
    mu = ahead * np.exp(log_density - log_density.max())
    return mu / mu.sum()


@njit(cache=True, error_model="numpy")
def _tick(rhs, output, models, turn, z, P, started, modes, told, info):  # type: ignore[no-untyped-def]
    before, now, u_sd, measured, white, coloured = told
    mu, zs, Ps = modes
    count = mu.shape[1]
    ny = measured.shape[1]
    innovation, S, log_density = np.empty((count, ny)), np.empty((count, ny, ny)), np.empty(count)
    none_out = np.zeros(ny, np.int64)
    for b in range(z.shape[0]):
        ahead = mu[b].copy()
        if started[b]:
            ahead, zs[b], Ps[b] = mix(mu[b], turn, zs[b], Ps[b])
        for j in range(count):
            if started[b]:
                zs[b, j], Ps[b, j], _ = forecast_one(rhs, models[j], zs[b, j], Ps[b, j], before[b], u_sd[b])
            zs[b, j], Ps[b, j], innovation[j], S[j], _ = correct_one(
                output, models[j], zs[b, j], Ps[b, j], now[b], measured[b], white[b], coloured[b], none_out
            )
            keep_doubt(models[j], Ps[b, j])
            log_density[j] = density(innovation[j], S[j], INNOVATION_CLIP_SD)
        mu[b] = weigh(ahead, log_density)
        z[b], P[b] = merge(mu[b], zs[b], Ps[b])
        gap, spread = merge(ahead, np.where(np.isnan(innovation), 0.0, innovation), S)
        info[0][b] = np.where(np.isnan(innovation[0]), np.nan, gap)
        info[1][b] = spread
        info[2][b] = surprise(info[0][b], spread)[0]


@register
class NominalIMM(NominalFilter):
    """What the same engineer would run who knows that wear comes in spells.

    ``still`` is what the walk of health is multiplied by while it stands still; ``leap`` is the standard deviation of
    a leap, in typical changes.
    """

    name = "nominal_imm"
    says = "interacting multiple models of wear, still, ramping and leaping, with the recalibrated reduced-order model"
    settings: ClassVar[dict[str, Any]] = {
        **NominalFilter.settings,
        "health_walk": 1.319,
        "state_walk": 14.04,
        "slow_error": 0.7499,
        "still": 0.05028,
        "leap": 0.7052,
    }
    search_space: ClassVar[dict[str, Sequence[float]]] = {
        **NominalFilter.search_space,
        "still": (0.02, 1.0),
        "leap": (0.5, 6.0),
    }
    online = NominalFilter.online | {"still", "leap"}

    def restore(self) -> None:
        """As the nominal EKF, and the modes."""
        super().restore()
        tick_s = self.machine.sample_period_s
        walk = health_walk_var(self.machine, self.config["health_walk"])
        leap = self.config["leap"] ** 2 * min(tick_s / STAY_S[-1], 1.0)
        at = np.arange(len(self._model.step), self._sensor)
        models = []
        for var in (self.config["still"] ** 2 * walk, walk, walk + leap):
            Q = self._model.Q.copy()
            Q[at, at] = var
            models.append(self._model._replace(Q=Q))
        self._models, self._turn = tuple(models), chain(tick_s)

    def fresh(self, z: Array, P: Array) -> tuple[np.ndarray, ...]:
        """Every mode begins alike; their probabilities are those of the chain in the long run."""
        usual = np.linalg.matrix_power(self._turn, 2**20)[0]
        count = len(usual)
        return np.tile(usual, (len(z), 1)), np.repeat(z[:, None], count, axis=1), np.repeat(P[:, None], count, axis=1)

    def tick(
        self,
        z: Array,
        P: Array,
        started: np.ndarray,
        own: tuple[np.ndarray, ...],
        told: tuple[Array, ...],
        info: tuple[Array, ...],
    ) -> tuple[np.ndarray, ...]:
        """Mix, run every mode's filter, weigh, merge."""
        modes = tuple(part.copy() for part in own)
        _tick(self._rhs, self._output, self._models, self._turn, z, P, started, modes, told, info)
        return modes

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
        count = len(STAY_S)
        return linear_modes(F, H, np.repeat(Q[None], count, axis=0), R, x0, P0, chain(1.0))


def linear_modes(
    F: Array, H: Array, Q: Array, R: Array, x0: Array, P0: Array, turn: Array
) -> Callable[[Array], tuple[Array, Array]]:
    """These blocks on a linear-Gaussian machine whose process noise has modes, as ``methods.kalman.linear_filter``.

    Args:
        F: (n, n) how a tick moves the state, in the states' units.
        H: (m, n) slope of the readings, a sensor's unit per unit of the state.
        Q: (3, n, n) covariance of a tick's process noise in each mode, in the states' units squared.
        R: (m, m) covariance of the measurement noise, in the sensors' units squared.
        x0: (n,) mean before the first prediction, each in its state's unit.
        P0: (n, n) covariance before the first prediction, in the states' units squared.
        turn: (3, 3) dimensionless probabilities of going from one mode to another in a tick.
    """
    count = len(Q)

    def run(measured: Array) -> tuple[Array, Array]:
        mu = np.full(count, 1.0 / count)
        z, P = np.repeat(x0[None], count, axis=0), np.repeat(P0[None], count, axis=0)
        means, covs = np.empty((len(measured), len(x0))), np.empty((len(measured), *P0.shape))
        for k, y in enumerate(measured):
            mu, z, P = mix(mu, turn, z, P)
            log_density = np.empty(count)
            for j in range(count):
                z[j], P[j] = F @ z[j], predict_covariance(P[j], F, Q[j])
                innovation = y - H @ z[j]
                z[j], P[j], S, _ = update(z[j], P[j], innovation, H, R, np.inf)
                log_density[j] = density(innovation, S, np.inf)
            mu = weigh(mu, log_density)
            means[k], covs[k] = merge(mu, z, P)
        return means, covs

    return run
