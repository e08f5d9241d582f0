"""The deterministic ensemble: exact moments, and what filterpy's stochastic ensemble goes to with many members."""

import numpy as np
from filterpy.kalman import EnsembleKalmanFilter
from hypothesis import given, settings
from hypothesis import strategies as st

from twinbench.baselines.nominal_enkf import NominalEnKF, assimilate, begin, moments_of, take_up
from twinbench.methods import kalman


def spd(rng, n):
    A = rng.normal(size=(n, n))
    return A @ A.T + 0.1 * np.eye(n)


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 10_000), st.integers(2, 22))
def test_an_ensemble_has_the_moments_it_is_given_and_grows_by_the_process_noise(seed, n):
    rng = np.random.default_rng(seed)
    z, P, Q = rng.normal(size=n), spd(rng, n), spd(rng, n)
    members = begin(z, P)
    for got, want in zip(moments_of(members), (z, P), strict=True):
        np.testing.assert_allclose(got, want, atol=1e-9)
    take_up(members, Q)
    for got, want in zip(moments_of(members), (z, P + Q), strict=True):
        np.testing.assert_allclose(got, want, atol=1e-8)


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 10_000), st.integers(0, 7))
def test_linear_correction_is_the_kalman_update_whatever_is_missing(seed, missing):
    rng = np.random.default_rng(seed)
    n, m = 5, 3
    z, P, H = rng.normal(size=n), spd(rng, n), rng.normal(size=(m, n))
    variance, y = rng.uniform(0.1, 1.0, m), 20.0 * rng.normal(size=m)  # some beyond the bound
    y[[bool(missing >> i & 1) for i in range(m)]] = np.nan
    members = begin(z, P)
    innovation, S, nis = assimilate(members, np.ascontiguousarray(members @ H.T), y, variance, 3.0)
    want = kalman.update(z, P, y - H @ z, H, np.diag(variance), 3.0)
    for got, expected in zip((*moments_of(members), S, nis), want, strict=True):
        np.testing.assert_allclose(got, expected, rtol=1e-8, atol=1e-8)
    np.testing.assert_allclose(innovation, y - H @ z, atol=1e-9)


def test_with_many_members_filterpys_ensemble_goes_to_ours():
    rng = np.random.default_rng(0)
    F = 0.95 * np.linalg.qr(rng.normal(size=(3, 3)))[0]
    H, Q, R, x0, P0 = rng.normal(size=(2, 3)), 0.1 * spd(rng, 3), np.diag([0.5, 0.2]), rng.normal(size=3), spd(rng, 3)
    y = 2.0 * rng.normal(size=(20, 2))
    means, covs = NominalEnKF.toy_filter(F, H, Q, R, x0, P0)(y)
    np.random.seed(0)  # noqa: NPY002  filterpy draws from there
    peer = EnsembleKalmanFilter(x0, P0, 2, 1.0, 20_000, lambda x: H @ x, lambda x, dt: F @ x)
    peer.Q, peer.R = Q, R
    for reading, mean, cov in zip(y, means, covs, strict=True):
        peer.predict()
        peer.update(reading)
        sd = np.sqrt(np.diagonal(cov))
        np.testing.assert_allclose(peer.x / sd, mean / sd, atol=0.06)  # six times 1 / sqrt(20,000), carried on a little
        np.testing.assert_allclose(peer.P / sd / sd[:, None], cov / sd / sd[:, None], atol=0.06)
