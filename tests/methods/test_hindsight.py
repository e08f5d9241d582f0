"""The look back over a filter's pass against filterpy, and at a seam."""

from __future__ import annotations

import numpy as np
import pytest

from twinbench.methods.hindsight import Pass, empty_pass, look_back

TICKS, N = 60, 3
F = np.array([[1.0, 0.1, 0.0], [0.0, 0.95, 0.1], [0.0, 0.0, 0.8]])
Q = np.diag([1e-3, 1e-2, 0.1])


@pytest.fixture
def kept() -> Pass:
    """A pass of filterpy's Kalman filter over one random recording."""
    from filterpy.kalman import KalmanFilter

    rng, kept = np.random.default_rng(0), empty_pass(TICKS, N)
    kf = KalmanFilter(N, 1)
    kf.F, kf.H, kf.Q, kf.R, kf.P = F, np.array([[1.0, 0.0, 0.5]]), Q, np.array([[0.2]]), np.diag([2.0, 1.0, 4.0])
    for k in range(TICKS):
        if k:
            kf.predict()
        kept.F[k] = F
        kept.ahead[k], kept.ahead_cov[k] = kf.x[:, 0], kf.P
        kf.update(rng.normal(size=1))
        kept.z[k], kept.P[k] = kf.x[:, 0], kf.P
    return kept


def smoothed_by_filterpy(kept: Pass) -> tuple[np.ndarray, np.ndarray]:
    from filterpy.kalman import KalmanFilter

    ticks = len(kept.z)
    kf = KalmanFilter(N, 1)
    means, covs, *_ = kf.rts_smoother(kept.z[..., None].copy(), kept.P.copy(), [F] * ticks, [Q] * ticks)
    return means[..., 0], covs


def test_it_equals_filterpy(kept):
    means, covs = smoothed_by_filterpy(kept)
    look_back(kept)
    np.testing.assert_allclose(kept.z, means, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(kept.P, covs, rtol=1e-9, atol=1e-12)
