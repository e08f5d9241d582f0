"""By what modes are weighed, against closed forms."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats

from twinbench.methods.mixing import FAILS_SD, MOST_SURPRISE, Failing, log_likelihood, read_failing

NONE_OUT = np.zeros(3)


def covariance(rng: np.random.Generator, n: int) -> np.ndarray:
    A = rng.normal(size=(n, n))
    return A @ A.T + 0.1 * np.eye(n)


def read(mean: float = 0.0, var: float = 0.0, noise_var: float = 1.0, wander: float = 0.0) -> Failing:
    """One of three outputs is off by so much."""
    return Failing(np.array([mean, var]), np.full(3, noise_var), wander)


def told(innovation: np.ndarray, S: np.ndarray, out: np.ndarray = NONE_OUT, failing: Failing | None = None) -> float:
    """Of a mode that goes on."""
    return log_likelihood(innovation, S, out, 1.0, failing or read(), np.empty((3, 3)), np.empty(3))


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


def test_an_output_that_goes_on_failing_reads_noise_around_its_offset():
    rng = np.random.default_rng(2)
    S, y = covariance(rng, 3), np.array([0.3, -0.2, 20.0])
    out, off = np.array([0.0, 0.0, 1.0]), read(mean=19.0, var=0.5, noise_var=2.0)
    believed = stats.multivariate_normal(np.zeros(2), S[:2, :2]).logpdf(y[:2]) + np.log(2.0 * np.pi)
    failed = stats.norm(19.0, np.sqrt(2.5)).logpdf(y[2]) + 0.5 * np.log(2.0 * np.pi)
    assert told(y, S, out, off) == pytest.approx(believed + failed)
    assert told(y, S, out, read(19.0, 0.5, 2.0)) > told(y, S)


@pytest.mark.parametrize("stays", [0.0, 0.3, 1.0])
def test_what_an_output_is_off_by_is_the_mixtures_posterior(stays):
    """By quadrature: either the failure goes on, or it has begun and the output may read anything."""
    mean, var, noise, S, wander, y = 2.0, 0.7, 0.4, 1.5, 0.1, 3.1
    failing = read(mean, var, noise, wander)
    nis, log_var = read_failing(failing, 1, stays, y, S)
    off = np.linspace(-400.0, 400.0, 4_000_001)
    goes_on = stats.norm(mean, np.sqrt(var + wander * noise)).pdf(off) * stats.norm(off, np.sqrt(noise)).pdf(y)
    # One that has begun is off by anything, so its reading says all: what the filter did not know is in the offset.
    begun = stats.norm(0.0, FAILS_SD * np.sqrt(S)).pdf(y) * stats.norm(y, np.sqrt(noise)).pdf(off)
    both = stays * goes_on + (1.0 - stays) * begun
    evidence = np.trapezoid(both, off)
    expected = np.trapezoid(off * both, off) / evidence
    assert failing.offset[0] == pytest.approx(expected, rel=1e-6)
    spread = np.trapezoid((off - expected) ** 2 * both, off) / evidence
    assert failing.offset[1] == pytest.approx(spread, rel=1e-5)
    assert -0.5 * (nis + log_var) == pytest.approx(np.log(evidence) + 0.5 * np.log(2.0 * np.pi), rel=1e-6)


def test_a_failure_that_has_just_begun_costs_as_much_as_it_is_unlikely():
    S, far = np.eye(3), np.array([0.0, 0.0, 8.0])
    out, room = np.array([0.0, 0.0, 1.0]), (np.empty((3, 3)), np.empty(3))
    scores = [log_likelihood(far, S, out, stays, read(), *room) for stays in (0.0, 0.9)]
    assert scores[0] - scores[1] == pytest.approx(np.log(10.0), rel=1e-3)
    assert scores[0] == pytest.approx(stats.norm(0.0, FAILS_SD).logpdf(8.0) + 0.5 * np.log(2.0 * np.pi))


@pytest.mark.parametrize("reading", [0.0, 1e9])
def test_a_noise_of_nothing_or_a_reading_from_elsewhere_leaves_all_finite(reading):
    failing = read(noise_var=0.0)
    for stays in (0.0, 1.0, 0.5):
        assert np.isfinite(read_failing(failing, 0, stays, reading, 1.0)).all()
        assert np.isfinite(failing.offset).all()
        assert failing.offset[1] >= 0.0
