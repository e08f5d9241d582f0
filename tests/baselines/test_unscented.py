"""Sigma points and the unscented correction against what they must reduce to."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from twinbench.baselines.unscented import correct, linear_filter, moments, sigma_points, weights
from twinbench.methods import kalman

ALPHA = 0.5


def spd(rng, n):
    A = rng.normal(size=(n, n))
    return A @ A.T + 0.1 * np.eye(n)


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 10_000), st.integers(2, 8))
def test_moments_of_sigma_points_are_the_mean_and_covariance_again(seed, n):
    rng = np.random.default_rng(seed)
    z, P, Q = rng.normal(size=(2, n)), np.stack([spd(rng, n), spd(rng, n)]), spd(rng, n)
    mean, cov = moments(sigma_points(z, P, ALPHA), *weights(n, ALPHA), Q)
    np.testing.assert_allclose(mean, z, atol=1e-9)
    np.testing.assert_allclose(cov, P + Q, atol=1e-8)


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 10_000), st.integers(0, 7))
def test_linear_correction_is_the_kalman_update_whatever_is_missing(seed, missing):
    rng = np.random.default_rng(seed)
    n, m = 5, 3
    z, P, H = rng.normal(size=n), spd(rng, n), rng.normal(size=(m, n))
    variance, y = rng.uniform(0.1, 1.0, m), rng.normal(size=m)
    y[[bool(missing >> i & 1) for i in range(m)]] = np.nan
    points = sigma_points(z[None], P[None], ALPHA)
    got = correct(z[None], P[None], points, points @ H.T, y[None], variance[None], *weights(n, ALPHA), np.inf)
    want = kalman.update(z, P, y - H @ z, H, np.diag(variance), np.inf)
    np.testing.assert_allclose(got[0][0], want[0], atol=1e-8)
    np.testing.assert_allclose(got[1][0], want[1], atol=1e-8)
    np.testing.assert_allclose(got[4][0], want[3], atol=1e-8)


def test_innovations_beyond_the_clip_are_bounded():
    z, P = np.zeros((1, 2)), np.eye(2)[None]
    points = sigma_points(z, P, ALPHA)
    arguments = (np.ones((1, 1)), *weights(2, ALPHA))
    far, *_ = correct(z, P, points, points[..., :1], np.array([[100.0]]), *arguments, 6.0)
    np.testing.assert_allclose(far[0], [6.0 * np.sqrt(2.0) / 2.0, 0.0], atol=1e-9)


def test_both_linear_filters_agree():
    rng = np.random.default_rng(3)
    F, H = 0.9 * np.eye(3) + 0.05 * rng.normal(size=(3, 3)), rng.normal(size=(2, 3))
    arguments = (F, H, 0.1 * np.eye(3), np.diag([0.5, 0.2]), np.zeros(3), np.eye(3))
    measured = rng.normal(size=(50, 2))
    measured[10:15, 0] = np.nan
    by_points, by_matrices = linear_filter(*arguments)(measured), kalman.linear_filter(*arguments)(measured)
    for ours, theirs in zip(by_points, by_matrices, strict=True):
        np.testing.assert_allclose(ours, theirs, atol=1e-9)
