"""Iterated extended Kalman filter with the recalibrated nominal model (Bell and Cathey, 1993).

Each correction is a Gauss-Newton search: the outputs are linearised again where the last step led. Most machines'
outputs are nearly linear in z. What bends is the scale of a sensor's bias, which matters in the first corrections, from
a wide prior. So the row says what iterating is worth, and little can be gained.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, ClassVar

import numpy as np
from numba import njit

from twinbench.baselines.augmented_model import bound, forecast_one, keep_doubt, measure
from twinbench.baselines.nominal_filter import NominalFilter
from twinbench.machines.coordinates import Array
from twinbench.methods.estimator import register
from twinbench.methods.kalman import INNOVATION_CLIP_SD, bounded, gain, joseph, predict_covariance

STEPS = 3
"""Gauss-Newton steps of a correction. One is the nominal EKF; for outputs nearly linear three are more than enough."""


@njit(cache=True, error_model="numpy")
def relinearised(prior, P, at, innovation, H, R, clip):  # type: ignore[no-untyped-def]
    """A Gauss-Newton step of a correction. Plain arrays, because it is compiled.

    Args:
        prior: (n,) mean before the correction, each in its state's unit.
        P: (n, n) its covariance.
        at: (n,) where the step before led, and the outputs were linearised.
        innovation: (m,) measured minus what is read there, in the sensors' units; NaN means missing.
        H: (m, n) slope of the readings there.
        R: (m, m) covariance of the measurement noise, in the sensors' units squared.
        clip: innovations are bounded to this many standard deviations.

    Returns:
        Where this step leads (n,), the gain (n, m), S (m, m) and NIS.
    """
    from_prior = innovation - H @ (prior - at)
    K, S, nis = gain(P, from_prior, H, R)
    return prior + K @ bounded(from_prior, S, clip), K, S, nis


@njit(cache=True, error_model="numpy")
def _tick(rhs, output, model, z, P, started, told, info):  # type: ignore[no-untyped-def]
    before, now, u_sd, measured, white, coloured = told
    for b in range(z.shape[0]):
        if started[b]:
            z[b], P[b], _ = forecast_one(rhs, model, z[b], P[b], before[b], u_sd[b])
        prior = z[b].copy()
        innovation, H, R = measure(output, model, prior, now[b], measured[b], white[b], coloured[b])
        z[b], K, S, nis = relinearised(prior, P[b], prior, innovation, H, R, INNOVATION_CLIP_SD)
        info[0][b], info[1][b], info[2][b] = innovation, S, nis
        for _ in range(STEPS - 1):
            bound(model, z[b])
            innovation, H, R = measure(output, model, z[b], now[b], measured[b], white[b], coloured[b])
            z[b], K, S, nis = relinearised(prior, P[b], z[b].copy(), innovation, H, R, INNOVATION_CLIP_SD)
        P[b] = joseph(P[b], K, H, R)
        keep_doubt(model, P[b])
        bound(model, z[b])


@register
class NominalIEKF(NominalFilter):
    """What the same engineer would run who linearises each reading again."""

    name = "nominal_iekf"
    says = "iterated extended Kalman filter with the recalibrated reduced-order model"
    settings: ClassVar[dict[str, Any]] = {
        **NominalFilter.settings,
        "health_walk": 2.285,
        "state_walk": 2.502,
        "slow_error": 0.3137,
    }

    def tick(
        self,
        z: Array,
        P: Array,
        started: np.ndarray,
        own: tuple[np.ndarray, ...],
        told: tuple[Array, ...],
        info: tuple[Array, ...],
    ) -> tuple[np.ndarray, ...]:
        """Predict as the EKF, correct in steps."""
        _tick(self._rhs, self._output, self._model, z, P, started, told, info)
        return ()

    @staticmethod
    def toy_filter(
        F: Array, H: Array, Q: Array, R: Array, x0: Array, P0: Array
    ) -> Callable[[Array], tuple[Array, Array]]:
        """On a linear machine every step leads to the same place.

        Args:
            F: (n, n) how a tick moves the state, in the states' units.
            H: (m, n) slope of the readings, a sensor's unit per unit of the state.
            Q: (n, n) covariance of a tick's process noise, in the states' units squared.
            R: (m, m) covariance of the measurement noise, in the sensors' units squared.
            x0: (n,) mean before the first prediction, each in its state's unit.
            P0: (n, n) covariance before the first prediction, in the states' units squared.
        """

        def run(measured: Array) -> tuple[Array, Array]:
            x, P = x0, P0
            means, covs = np.empty((len(measured), len(x0))), np.empty((len(measured), *P0.shape))
            for k, y in enumerate(measured):
                prior, P = F @ x, predict_covariance(P, F, Q)
                x = prior
                for _ in range(STEPS):
                    x, K, _, _ = relinearised(prior, P, x, y - H @ x, H, R, np.inf)
                P = joseph(P, K, H, R)
                means[k], covs[k] = x, P
            return means, covs

        return run
