"""Unscented Kalman filter with the recalibrated nominal model (Julier and Uhlmann, 2004; van der Merwe).

No Jacobian is formed of what is estimated: 2n + 1 points carry mean and covariance through the model and through the
outputs. The noise of the measured inputs is small, and enters by its linear effect, as in the nominal EKF.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, ClassVar

import numpy as np
from numba import njit

from twinbench.baselines.augmented_model import bound, linearise
from twinbench.baselines.nominal_filter import NominalFilter, advance, read
from twinbench.baselines.unscented import correct, linear_filter, moments, sigma_points, weights
from twinbench.machines.coordinates import Array
from twinbench.methods.estimator import register
from twinbench.methods.kalman import INNOVATION_CLIP_SD


@njit(cache=True, error_model="numpy")
def _tick(rhs, output, model, spread, z, P, started, told, info):  # type: ignore[no-untyped-def]
    alpha, w_mean, w_cov = spread
    before, now, u_sd, measured, white, coloured = told
    readings = np.empty((1, w_mean.size, measured.shape[1]))
    for b in range(z.shape[0]):
        one = slice(b, b + 1)
        if started[b]:
            _, _, Q = linearise(rhs, model, z[b], before[b], u_sd[b])
            points = sigma_points(z[one], P[one], alpha)
            for k in range(w_mean.size):
                points[0, k] = advance(rhs, model, points[0, k], before[b])
            z[one], P[one] = moments(points, w_mean, w_cov, Q)
        points = sigma_points(z[one], P[one], alpha)
        for k in range(w_mean.size):
            readings[0, k] = read(output, model, points[0, k], now[b], coloured[b])
        z[one], P[one], info[0][one], info[1][one], info[2][one] = correct(
            z[one], P[one], points, readings, measured[one], white[one] ** 2, w_mean, w_cov, INNOVATION_CLIP_SD
        )
        bound(model, z[b])


@register
class NominalUKF(NominalFilter):
    """What the same engineer would run who trusts no Jacobian.

    ``alpha`` spreads the sigma points: by alpha sqrt(n) standard deviations.
    """

    name = "nominal_ukf"
    says = "unscented Kalman filter with the recalibrated reduced-order model"
    toy_filter = staticmethod(linear_filter)
    settings: ClassVar[dict[str, Any]] = {
        **NominalFilter.settings,
        "health_walk": 2.171,
        "state_walk": 17.61,
        "slow_error": 1.392,
        "alpha": 0.8778,
    }
    search_space: ClassVar[dict[str, Sequence[float]]] = {**NominalFilter.search_space, "alpha": (0.3, 1.0)}
    online = NominalFilter.online | {"alpha"}

    def restore(self) -> None:
        """As the nominal EKF, and the weights of the sigma points."""
        super().restore()
        self._spread = (self.config["alpha"], *weights(self._size, self.config["alpha"]))

    def tick(
        self,
        z: Array,
        P: Array,
        started: np.ndarray,
        own: tuple[np.ndarray, ...],
        told: tuple[Array, ...],
        info: tuple[Array, ...],
    ) -> tuple[np.ndarray, ...]:
        """Predict and correct by sigma points."""
        _tick(self._rhs, self._output, self._model, self._spread, z, P, started, told, info)
        return ()
