"""Particles: their numbers, what resampling keeps, and the Kalman filter that they go to on a linear machine."""

import numpy as np
import pytest
from scipy import stats

from twinbench.baselines.particles import follow, mixture, normal, resample, reweigh, uniform, walk
from twinbench.methods.kalman import linear_filter, predict_covariance

SAMPLED = np.array([2, 3])
START = np.uint64(0)


def test_the_counters_numbers_are_uniform_and_normal_and_the_same_each_time():
    counters = np.arange(0, 40_000, 2, dtype=np.uint64)
    flat, bell = np.array([uniform(c) for c in counters]), np.array([normal(c) for c in counters])
    assert stats.kstest(flat, "uniform").pvalue > 0.01
    assert stats.kstest(bell, "norm").pvalue > 0.01
    assert abs(np.corrcoef(flat[:-1], flat[1:])[0, 1]) < 0.03
    assert abs(np.corrcoef(bell[:-1], bell[1:])[0, 1]) < 0.03
    assert [uniform(int(c)) for c in counters[:9]] == list(flat[:9])
    assert [normal(int(c)) for c in counters[:9]] == list(bell[:9])


def linear_machine(seed):
    """The two sampled states walk by themselves and drive the others."""
    rng = np.random.default_rng(seed)
    F = np.eye(4)
    F[:2, :2] = 0.9 * np.linalg.qr(rng.normal(size=(2, 2)))[0]
    F[:2, 2:] = 0.3 * rng.normal(size=(2, 2))
    H = np.hstack([rng.normal(size=(3, 2)), np.zeros((3, 2))])
    return F, H, np.diag([0.05, 0.1, 0.01, 0.02]), np.diag([0.5, 0.2, 1.0]), rng.normal(size=4), np.eye(4)


def begin(count, x0, P0):
    slope, L = follow(P0, SAMPLED)
    step = np.random.default_rng(0).normal(size=(count, 2)) @ np.tril(L).T
    given = P0 - slope @ P0[SAMPLED]
    given[SAMPLED], given[:, SAMPLED] = 0.0, 0.0
    return x0 + step @ slope.T, np.full(count, 1.0 / count), given


@pytest.mark.parametrize("seed", range(2))
def test_with_many_particles_it_goes_to_the_kalman_filter_whatever_is_missing(seed):
    F, H, Q, R, x0, P0 = linear_machine(seed)
    rng = np.random.default_rng(seed)
    x, y = x0 + rng.normal(size=4), np.empty((60, 3))
    for k in range(len(y)):
        x = F @ x + np.sqrt(np.diag(Q)) * rng.normal(size=4)
        y[k] = H @ x + np.sqrt(np.diag(R)) * rng.normal(size=3)
    y[rng.random(y.shape) < 0.2] = np.nan
    particles, weights, given = begin(20_000, x0, P0)
    rest = Q.copy()
    rest[SAMPLED] = 0.0
    counter, resampled = START, 0
    for reading, mean, cov in zip(y, *linear_filter(F, H, Q, R, x0, P0)(y), strict=True):
        particles, given = np.ascontiguousarray(particles @ F.T), predict_covariance(given, F, rest)
        counter = walk(particles, SAMPLED, np.sqrt(np.diag(Q)[SAMPLED]), counter)
        readings = np.ascontiguousarray(particles @ H.T)
        reweigh(particles, weights, given, readings, H, R, reading, np.inf)
        ours, ours_cov = mixture(particles, weights, given)
        sd = np.sqrt(np.diagonal(cov))
        np.testing.assert_allclose(ours / sd, mean / sd, atol=0.08)
        np.testing.assert_allclose(ours_cov / sd / sd[:, None], cov / sd / sd[:, None], atol=0.08)
        after = resample(particles, weights, SAMPLED, counter)
        resampled += after != counter
        counter = after
    assert resampled > 3


def test_resampling_keeps_mean_and_covariance_and_evens_the_weights():
    rng = np.random.default_rng(1)
    slope = rng.normal(size=(4, 2))
    slope[SAMPLED] = np.eye(2)
    particles = rng.normal(size=(20_000, 2)) @ slope.T
    weights = np.exp(2.0 * particles[:, 2])
    weights /= weights.sum()
    mean, cov = mixture(particles, weights, np.zeros((4, 4)))
    counter = resample(particles, weights, SAMPLED, START)
    assert counter > START
    np.testing.assert_array_equal(weights, 1.0 / 20_000)
    sd = np.sqrt(np.diagonal(cov))
    after, cov_after = mixture(particles, weights, np.zeros((4, 4)))
    np.testing.assert_allclose(after / sd, mean / sd, atol=0.06)
    np.testing.assert_allclose(cov_after / sd / sd[:, None], cov / sd / sd[:, None], atol=0.08)
    np.testing.assert_array_equal(resample(particles, weights, SAMPLED, counter), counter)


def test_readings_that_are_missing_weigh_nothing():
    _, H, _, R, x0, P0 = linear_machine(0)
    particles, weights, given = begin(50, x0, P0)
    before = particles.copy(), weights.copy(), given.copy()
    *_, nis = reweigh(particles, weights, given, particles @ H.T, H, R, np.full(3, np.nan), 6.0)
    assert np.isnan(nis)
    for now, then in zip((particles, weights, given), before, strict=True):
        np.testing.assert_array_equal(now, then)
