"""The sensors' noise: innovations against a textbook filter and a dense covariance, and what is learnt of it."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import cholesky, solve_triangular
from scipy.stats import multivariate_normal

from twinbench.mismatch.sensors import LONGEST_MEMORY, SensorNoise
from twinbench.physics.simulator import Array

NOISE = SensorNoise(np.array([0.3, 1.0]), np.array([2.0, 0.5]), np.array([4.0, 9.0]))


def covariance(noise: SensorNoise, channel: int, n: int) -> Array:
    lag = np.abs(np.subtract.outer(np.arange(n), np.arange(n)))
    return noise.white[channel] * np.eye(n) + noise.coloured[channel] * np.exp(-lag / noise.memory[channel])


def kalman(y: Array, white: float, coloured: float, keeps: float) -> tuple[Array, float]:
    """Innovations in sds and the log-likelihood, from the five lines of any textbook; NaN is missing."""
    x, P, out, log = 0.0, coloured, [], 0.0
    for value in y:
        if np.isfinite(value):
            S = P + white
            out.append((value - x) / np.sqrt(S))
            log -= 0.5 * (np.log(2.0 * np.pi * S) + (value - x) ** 2 / S)
            x, P = x + P / S * (value - x), P - P**2 / S
        else:
            out.append(0.0)
        x, P = keeps * x, keeps**2 * P + coloured * (1.0 - keeps**2)
    return np.array(out), log


def test_innovations_are_those_of_a_kalman_filter():
    rng = np.random.default_rng(0)
    y = rng.normal(size=(80, 2))
    y[10:14, 0] = np.nan
    white = NOISE.whitened(y[:, :, None].copy())[:, :, 0]
    for c in range(2):
        expected, _ = kalman(y[:, c], NOISE.white[c], NOISE.coloured[c], np.exp(-1.0 / NOISE.memory[c]))
        np.testing.assert_allclose(white[:, c], expected, rtol=1e-9, atol=1e-12)


def test_whitening_is_by_the_root_of_the_covariance_for_columns_too():
    """The filter is linear: it multiplies by the inverse Cholesky factor, and so keeps every scalar product."""
    rng = np.random.default_rng(1)
    columns = rng.normal(size=(50, 2, 3))
    white = NOISE.whitened(columns.copy())
    for c in range(2):
        L = cholesky(covariance(NOISE, c, 50), lower=True)
        np.testing.assert_allclose(white[:, c], solve_triangular(L, columns[:, c], lower=True), rtol=1e-8, atol=1e-10)


def test_the_filters_likelihood_is_that_of_the_dense_covariance():
    rng = np.random.default_rng(2)
    y = rng.normal(size=60)
    _, log = kalman(y, NOISE.white[0], NOISE.coloured[0], np.exp(-1.0 / NOISE.memory[0]))
    assert log == pytest.approx(multivariate_normal(np.zeros(60), covariance(NOISE, 0, 60)).logpdf(y))


@pytest.mark.parametrize("seed", [0, 1])
def test_what_is_learnt_is_as_likely_as_the_noise_that_there_was(seed):
    rng = np.random.default_rng(seed)
    series = np.column_stack([rng.multivariate_normal(np.zeros(1000), covariance(NOISE, c, 1000)) for c in (0, 1)])
    floor = np.sqrt(NOISE.white)
    found = SensorNoise.first_guess(2.0 * floor).learnt([series], floor)
    for c in range(2):
        learnt, true = (
            kalman(series[:, c], n.white[c], n.coloured[c], np.exp(-1.0 / n.memory[c]))[1] for n in (found, NOISE)
        )
        assert true - 0.5 < learnt < true + 8.0
    np.testing.assert_allclose(found.white + found.coloured, NOISE.white + NOISE.coloured, rtol=0.25)
    white = found.whitened(series[:, :, None].copy())[:, :, 0]
    np.testing.assert_allclose(white.var(axis=0), 1.0, atol=0.1)


def test_what_lasts_too_long_for_noise_is_not_learnt_as_its_memory():
    slow = np.sin(np.arange(2000) / 150.0)[:, None] + 0.1 * np.random.default_rng(5).normal(size=(2000, 1))
    found = SensorNoise.first_guess(np.array([0.1])).learnt([slow], np.array([0.1]))
    assert found.memory[0] <= LONGEST_MEMORY
