"""By what modes are weighed, against closed forms."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats

from twinbench.methods.modes import FAILS_SD, MOST_SURPRISE, log_likelihood

NONE_OUT = np.zeros(3)


def covariance(rng: np.random.Generator, n: int) -> np.ndarray:
    A = rng.normal(size=(n, n))
    return A @ A.T + 0.1 * np.eye(n)


def told(innovation: np.ndarray, S: np.ndarray, out: np.ndarray = NONE_OUT) -> float:
    return log_likelihood(innovation, S, out, np.empty((3, 3)), np.empty(3))


@settings(deadline=None)  # the first call compiles
@given(st.integers(0, 1000), st.lists(st.booleans(), min_size=3, max_size=3))
def test_the_likelihood_is_the_normal_density_of_what_is_there(seed, there):
    rng = np.random.default_rng(seed)
    S, there = covariance(rng, 3), np.array(there)
    y = 0.5 * np.linalg.cholesky(S) @ rng.uniform(-1.0, 1.0, 3)
    expected = 0.0
    if there.any():
        own = S[np.ix_(there, there)]
        share = 0.5 * there.sum() * np.log(2.0 * np.pi)
        expected = stats.multivariate_normal(np.zeros(there.sum()), own).logpdf(y[there]) + share
    assert told(np.where(there, y, np.nan), S) == pytest.approx(expected, rel=1e-9, abs=1e-9)


def test_no_surprise_counts_for_more_than_the_bound():
    S = covariance(np.random.default_rng(0), 3)
    at_the_bound = -0.5 * (MOST_SURPRISE + np.log(np.linalg.det(S)))
    assert told(np.full(3, 1e6), S) == pytest.approx(at_the_bound)


def test_an_output_that_fails_may_read_anything():
    rng = np.random.default_rng(2)
    S, y = covariance(rng, 3), np.array([0.3, -0.2, 0.0])
    y[2] = 20.0 * np.sqrt(S[2, 2])
    out = np.array([0.0, 0.0, 1.0])
    wide = S + np.diag([0.0, 0.0, FAILS_SD**2 * S[2, 2]])
    expected = stats.multivariate_normal(np.zeros(3), wide).logpdf(y) + 1.5 * np.log(2.0 * np.pi)
    assert told(y, S, out) == pytest.approx(expected)
    assert told(y, S, out) > told(y, S)
    y[2] = 0.0
    assert told(y, S, out) < told(y, S)
