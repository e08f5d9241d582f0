"""filterpy behind typed functions: the reference that our compiled filters must equal.

The filters of the baselines run compiled for the accuracy runs; these do the same step by filterpy.
``twinbench latency`` times both, and a test holds them together to 1e-9 over a whole sequence.
"""

from __future__ import annotations

import functools
from collections.abc import Callable

import numpy as np
from filterpy.kalman import ExtendedKalmanFilter, MerweScaledSigmaPoints, UnscentedKalmanFilter, unscented_transform

from twinbench.machines.coordinates import Array


class _EKF(ExtendedKalmanFilter):
    """The nonlinear forecast is made outside."""

    ahead: Array

    def predict_x(self, u: object = 0) -> None:
        self.x = self.ahead


@functools.cache
def _ekf(size: int) -> _EKF:
    return _EKF(size, 1)  # it takes as many readings as there are


def ekf_predict(P: Array, ahead: Array, F: Array, Q: Array) -> tuple[Array, Array]:
    """State and covariance a step on.

    Args:
        P: (n, n) prior covariance, in the units of the state squared.
        ahead: (n,) the forecast, each in its state's unit.
        F: (n, n) slope of the forecast, in the units of the state.
        Q: (n, n) covariance of the step's process noise, in the units of the state squared.
    """
    ekf = _ekf(len(ahead))
    ekf.P, ekf.ahead, ekf.F, ekf.Q = P, ahead, F, Q
    ekf.predict()
    return ekf.x, ekf.P


def ekf_update(
    z: Array, P: Array, innovation: Array, H: Array, R: Array, clip: float
) -> tuple[Array, Array, Array, float]:
    """As ``methods.kalman.update``: z, P, S (m, m) and NIS over the channels that are there.

    Args:
        z: (n,) prior mean, each in its state's unit.
        P: (n, n) prior covariance, in the units of the state squared.
        innovation: (m,) measured minus predicted, in the sensors' units; NaN means missing.
        H: (m, n) slope of the readings, a sensor's unit per unit of the state.
        R: (m, m) covariance of the measurement noise, in the sensors' units squared.
        clip: innovations are bounded to this many standard deviations.
    """
    S_all = H @ P @ H.T + R
    there = np.flatnonzero(~np.isnan(innovation))
    if not len(there):
        return z, P, S_all, float("nan")
    limit = clip * np.sqrt(np.diag(S_all)[there])
    bounded = np.clip(innovation[there], -limit, limit)
    ekf = _ekf(len(z))
    ekf.x, ekf.P = z, P
    ekf.update(bounded, lambda _: H[there], lambda _: np.zeros(len(there)), R[np.ix_(there, there)])
    nis = innovation[there] @ ekf.SI @ innovation[there]
    return ekf.x, 0.5 * (ekf.P + ekf.P.T), S_all, float(nis)


@functools.cache
def _ukf(size: int, alpha: float) -> UnscentedKalmanFilter:
    points = MerweScaledSigmaPoints(size, alpha, beta=2.0, kappa=0.0)
    return UnscentedKalmanFilter(size, 1, dt=1.0, hx=None, fx=None, points=points)


def ukf_predict(z: Array, P: Array, Q: Array, alpha: float, move: Callable[[Array], Array]) -> tuple[Array, Array]:
    """State and covariance a step on, by sigma points.

    Args:
        z: (n,) prior mean, each in its state's unit.
        P: (n, n) prior covariance, in the units of the state squared.
        Q: (n, n) covariance of the step's process noise, in the units of the state squared.
        alpha: spread of the sigma points.
        move: takes one sigma point (n,) a step on.
    """
    ukf = _ukf(len(z), alpha)
    ukf.x, ukf.P, ukf.Q = z, P, Q
    ukf.predict(fx=lambda sigma, _: move(sigma))
    return ukf.x, ukf.P


def ukf_update(
    z: Array, P: Array, measured: Array, R: Array, alpha: float, clip: float, observe: Callable[[Array], Array]
) -> tuple[Array, Array, Array, Array, float]:
    """z, P, innovation (m,), S (m, m) and NIS over the channels of ``measured`` that are not NaN.

    Args:
        z: (n,) prior mean, each in its state's unit.
        P: (n, n) prior covariance, in the units of the state squared.
        measured: (m,) readings in the sensors' units; NaN means missing.
        R: (m, m) covariance of the measurement noise, in the sensors' units squared.
        alpha: spread of the sigma points.
        clip: innovations are bounded to this many standard deviations.
        observe: maps one sigma point (n,) to readings (m,).
    """
    ukf = _ukf(len(z), alpha)
    ukf.x, ukf.P = z, P
    ukf.sigmas_f = ukf.points_fn.sigma_points(z, P)
    expected, S_all = unscented_transform(np.array([observe(s) for s in ukf.sigmas_f]), ukf.Wm, ukf.Wc, R)
    innovation = measured - expected
    there = np.flatnonzero(~np.isnan(innovation))
    if not len(there):
        return z, P, innovation, S_all, float("nan")
    limit = clip * np.sqrt(np.diag(S_all)[there])
    bounded = expected[there] + np.clip(innovation[there], -limit, limit)
    ukf.update(bounded, R=R[np.ix_(there, there)], hx=lambda sigma: observe(sigma)[there])
    nis = innovation[there] @ ukf.SI @ innovation[there]
    return ukf.x, 0.5 * (ukf.P + ukf.P.T), innovation, S_all, float(nis)
