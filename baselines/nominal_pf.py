"""Particle filter with the recalibrated nominal model (Gordon, Salmond and Smith, 1993), Rao-Blackwellised.

Particles suppose the health parameters that act on the machine, and move as these walk. Given them, the rest is
nearly linear, and an extended Kalman filter follows it whose covariance all particles share. Resampling is systematic
and regularised. Nothing is drawn from outside: the counter of the random numbers is carried along, so that the same
state and sample give the same answer.
"""

from __future__ import annotations

from typing import Any, ClassVar

import numpy as np
from numba import njit

from twinbench.baselines.augmented_model import bound, keep_doubt, linearise, measure
from twinbench.baselines.nominal_filter import NominalFilter, advance, read
from twinbench.baselines.particles import ONE, follow, mixture, resample, reweigh, walk
from twinbench.machines.coordinates import Array
from twinbench.methods.estimator import register
from twinbench.methods.kalman import INNOVATION_CLIP_SD, predict_covariance

PARTICLES = 96
"""As many as an update of a third of a millisecond allows. Fewer follow four parameters worse; twice as many cost twice
the time."""


@njit(cache=True, error_model="numpy")
def _tick(rhs, output, model, z, P, started, w, told, info):  # type: ignore[no-untyped-def]
    before, now, u_sd, measured, white, coloured = told
    clouds, weights, given, counter = w
    sampled = model.step.size + np.flatnonzero(model.acts)
    sd = np.sqrt(np.diag(model.Q)[sampled])
    readings = np.empty((clouds.shape[1], measured.shape[1]))
    for b in range(z.shape[0]):
        particles, at = clouds[b], z[b]
        if started[b]:
            at, F, Q = linearise(rhs, model, z[b], before[b], u_sd[b])
            for i in sampled:
                Q[i, i] = 0.0
            given[b] = predict_covariance(given[b], F, Q)
            for k in range(len(particles)):
                particles[k] = advance(rhs, model, particles[k], before[b])
            counter[b] = walk(particles, sampled, sd, counter[b])
        _, H, R = measure(output, model, at, now[b], measured[b], white[b], coloured[b])
        for k in range(len(particles)):
            readings[k] = read(output, model, particles[k], now[b], coloured[b])
        info[0][b], info[1][b], info[2][b] = reweigh(
            particles, weights[b], given[b], readings, H, R, measured[b], INNOVATION_CLIP_SD
        )
        counter[b] = resample(particles, weights[b], sampled, counter[b])
        for k in range(len(particles)):
            bound(model, particles[k])
        z[b], P[b] = mixture(particles, weights[b], given[b])
        keep_doubt(model, P[b])


@register
class NominalPF(NominalFilter):
    """What the same engineer would run who wants no bell curve for health."""

    name = "nominal_pf"
    says = "Rao-Blackwellised particle filter with the recalibrated reduced-order model"
    settings: ClassVar[dict[str, Any]] = {
        **NominalFilter.settings,
        "health_walk": 0.643,
        "state_walk": 27.06,
        "slow_error": 2.642,
    }

    def fresh(self, z: Array, P: Array) -> tuple[np.ndarray, ...]:
        """Particles from the prior, alike for every machine, equal weights, the rest's covariance, the counter.

        What acts on readings alone, a bias, is left to the Kalman filter.

        Args:
            z: (B, n) mean of the prior, in the units of z.
            P: (B, n, n) its covariance, in those units squared.
        """
        batch = len(z)
        sampled = len(self._model.step) + np.flatnonzero(self._model.acts)
        slope, L = follow(P[0], sampled)
        step = np.random.default_rng(0).normal(size=(PARTICLES, len(sampled))) @ np.tril(L).T
        given = P[0] - slope @ P[0][sampled]
        given[sampled], given[:, sampled] = 0.0, 0.0
        clouds = np.tile(z[0] + step @ slope.T, (batch, 1, 1))
        return (
            clouds,
            np.full((batch, PARTICLES), 1.0 / PARTICLES),
            np.tile(given, (batch, 1, 1)),
            np.zeros(batch, ONE.dtype),
        )

    def tick(
        self,
        z: Array,
        P: Array,
        started: np.ndarray,
        own: tuple[np.ndarray, ...],
        told: tuple[Array, ...],
        info: tuple[Array, ...],
    ) -> tuple[np.ndarray, ...]:
        """Move and correct every particle, weigh them, resample where few are left."""
        carried = tuple(part.copy() for part in own)
        _tick(self._rhs, self._output, self._model, z, P, started, carried, told, info)
        return carried
