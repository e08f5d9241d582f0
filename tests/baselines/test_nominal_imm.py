"""The interacting multiple models against filterpy's, and what modes are for."""

import numpy as np
import pytest
from filterpy.kalman import IMMEstimator, KalmanFilter

from twinbench.baselines.nominal_imm import chain, linear_modes, merge


def linear_machine(seed):
    rng = np.random.default_rng(seed)
    n, m = 4, 3
    F = 0.95 * np.linalg.qr(rng.normal(size=(n, n)))[0]
    H, q, p = rng.normal(size=(m, n)), rng.normal(size=(n, n)), rng.normal(size=(n, n))
    Q = q @ q.T
    return F, H, np.stack([0.01 * Q, 0.1 * Q, 2.0 * Q]), np.diag([0.5, 0.2, 1.0]), rng.normal(size=n), p @ p.T


@pytest.mark.parametrize("seed", range(3))
def test_modes_that_differ_give_what_filterpy_gives(seed):
    F, H, Q, R, x0, P0 = linear_machine(seed)
    filters = []
    for each in Q:
        one = KalmanFilter(len(x0), len(R))
        one.x, one.P, one.F, one.H, one.Q, one.R = x0.copy(), P0.copy(), F, H, each, R
        filters.append(one)
    peer = IMMEstimator(filters, np.full(3, 1 / 3), chain(0.05))
    measured = 2.0 * np.random.default_rng(seed).normal(size=(150, 3))
    means, covs = linear_modes(F, H, Q, R, x0, P0, chain(0.05))(measured)
    for y, mean, cov in zip(measured, means, covs, strict=True):
        peer.predict()
        peer.update(y)
        np.testing.assert_allclose(mean, peer.x, rtol=1e-8, atol=1e-9)
        np.testing.assert_allclose(cov, peer.P, rtol=1e-8, atol=1e-9)


def test_the_chain_goes_somewhere_and_stays_as_long_as_it_says():
    turn = chain(0.05)
    np.testing.assert_allclose(turn.sum(axis=1), 1.0)
    np.testing.assert_allclose(0.05 / (1.0 - np.diagonal(turn)), [300.0, 300.0, 5.0])


def test_a_mixtures_moments_are_those_of_draws_from_it():
    rng = np.random.default_rng(0)
    mu, z, P = np.array([0.2, 0.8]), np.array([[0.0, 1.0], [2.0, -1.0]]), np.stack([np.eye(2), 0.5 * np.eye(2)])
    which = rng.random(200_000) < mu[1]
    draws = np.where(which[:, None], z[1], z[0]) + rng.normal(size=(200_000, 2)) * np.where(which, 0.5**0.5, 1)[:, None]
    mean, cov = merge(mu, z, P)
    np.testing.assert_allclose(mean, draws.mean(axis=0), atol=0.02)
    np.testing.assert_allclose(cov, np.cov(draws.T), atol=0.02)


def test_a_leap_is_followed_sooner_than_by_a_walk_alone():
    """A constant that leaps: with a mode for leaps the estimate is there in a tenth of the time."""
    one, walk = np.eye(1), np.array([1e-6, 1e-4, 0.2])[:, None, None]
    y = np.random.default_rng(1).normal(size=(800, 1))
    y[400:] += 20.0
    modes, alone = (
        linear_modes(one, one, Q, one, np.zeros(1), one, chain(0.05))(y)[0][:, 0]
        for Q in (walk, np.repeat(walk[1:2], 3, axis=0))
    )
    assert abs(modes[430] - 20.0) < 2.0
    assert abs(alone[430] - 20.0) > 10.0
