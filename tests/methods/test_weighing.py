"""What is weighed, against closed forms."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats

from twinbench.machines.compressor import COMPRESSOR
from twinbench.machines.motor import MOTOR
from twinbench.methods.weighing import (
    FAILS_SD,
    LEAP,
    MOST_SURPRISE,
    NOTHING,
    causes_of,
    leap,
    likeliest,
    log_likelihood,
    mixture_into,
    probabilities,
)

NONE_OUT = np.zeros(3, np.int64)


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
    out = np.array([0, 0, 7])
    wide = S + np.diag([0.0, 0.0, FAILS_SD**2 * S[2, 2]])
    expected = stats.multivariate_normal(np.zeros(3), wide).logpdf(y) + 1.5 * np.log(2.0 * np.pi)
    assert told(y, S, out) == pytest.approx(expected)
    assert told(y, S, out) > told(y, S)
    y[2] = 0.0
    assert told(y, S, out) < told(y, S)


def test_causes_are_nothing_a_leap_each_a_return_and_a_failure_each():
    for machine, failing in ((COMPRESSOR, ["p_dis_bar", "m_flow_kg_s"]), (MOTOR, ["speed_rad_s", "T_wind_K"])):
        causes = causes_of(machine)
        assert [NOTHING, LEAP, causes.back, causes.fails, causes.count] == [0, 1, 6, 7, 9]
        assert LEAP + len(machine.health) == causes.back
        assert [machine.outputs[c] for c in causes.failing] == failing
        assert np.exp(causes.log_prior).sum() == pytest.approx(1.0)
        assert likeliest(causes.log_prior) == NOTHING
        assert len(set(np.delete(causes.log_prior, NOTHING))) == 1


def test_a_leap_widens_one_entry_and_keeps_its_covariances():
    P = covariance(np.random.default_rng(3), 4)
    after = P.copy()
    leap(after, 2, 3.0)
    assert (after - P) == pytest.approx(np.diag([0.0, 0.0, 9.0, 0.0]))


def test_probabilities_are_shares_of_the_likelihoods_however_far_they_are_apart():
    out = np.empty(3)
    probabilities(np.log([0.2, 0.5, 0.3]) - 5000.0, out)
    assert out == pytest.approx([0.2, 0.5, 0.3])
    probabilities(np.array([0.0, -1e5, 3.0]), out)
    assert out.sum() == pytest.approx(1.0)
    assert out[1] == 0.0
    assert likeliest(np.array([0.0, 4.0, 3.0])) == 1


def test_the_mixture_has_the_mean_and_covariance_of_draws_from_it():
    rng = np.random.default_rng(4)
    weight, means = np.array([0.6, 0.3, 0.1]), rng.normal(size=(3, 2))
    covs = np.array([covariance(rng, 2) for _ in range(3)])
    mean, cov = np.empty(2), np.empty((2, 2))
    mixture_into(weight, means, covs, mean, cov)
    which = rng.choice(3, size=200_000, p=weight)
    draws = means[which] + np.einsum("nij,nj->ni", np.linalg.cholesky(covs)[which], rng.normal(size=(len(which), 2)))
    assert mean == pytest.approx(weight @ means)
    assert draws.mean(axis=0) == pytest.approx(mean, abs=0.02)
    assert np.cov(draws.T) == pytest.approx(cov, abs=0.06)
