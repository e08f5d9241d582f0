"""The Kalman building blocks against five lines of textbook."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from twinbench.methods.kalman import carry_into, cholesky_solve, predict_covariance, update


def random_problem(seed: int, n: int = 6, m: int = 3):
    rng = np.random.default_rng(seed)
    A, B = rng.normal(size=(n, n)), rng.normal(size=(m, m))
    return rng.normal(size=n), A @ A.T + np.eye(n), rng.normal(size=m), rng.normal(size=(m, n)), B @ B.T + np.eye(m)


def textbook(z, P, r, H, R):
    S = H @ P @ H.T + R
    K = P @ H.T @ np.linalg.inv(S)
    return z + K @ r, (np.eye(len(z)) - K @ H) @ P, S, r @ np.linalg.inv(S) @ r


@pytest.mark.parametrize("seed", range(5))
def test_update_is_the_textbook(seed):
    problem = random_problem(seed)
    for ours, theirs in zip(update(*problem, np.inf), textbook(*problem), strict=True):
        assert ours == pytest.approx(theirs, abs=1e-10)


@pytest.mark.parametrize("missing", [[0], [1, 2], [0, 2]])
def test_a_missing_channel_is_a_smaller_problem(missing):
    z, P, r, H, R = random_problem(7)
    left = [i for i in range(3) if i not in missing]
    r_nan = r.copy()
    r_nan[missing] = np.nan
    z1, P1, _, nis = update(z, P, r_nan, H, R, np.inf)
    z2, P2, _, nis2 = textbook(z, P, r[left], H[left], R[np.ix_(left, left)])
    assert z1 == pytest.approx(z2, abs=1e-10)
    assert P1 == pytest.approx(P2, abs=1e-10)
    assert nis == pytest.approx(nis2)


def test_nothing_measured_changes_nothing():
    z, P, r, H, R = random_problem(8)
    z1, P1, _, nis = update(z, P, np.full_like(r, np.nan), H, R, 6.0)
    assert np.array_equal(z1, z)
    assert np.array_equal(P1, P)
    assert np.isnan(nis)


def test_a_wild_sample_moves_no_more_than_the_clip_allows():
    z, P, r, H, R = random_problem(9)
    S = H @ P @ H.T + R
    wild, bounded = r.copy(), r.copy()
    wild[0] = 1e6
    bounded[0] = 6.0 * np.sqrt(S[0, 0])
    assert update(z, P, wild, H, R, 6.0)[0] == pytest.approx(textbook(z, P, bounded, H, R)[0])


def test_posterior_stays_a_covariance_through_ill_conditioned_updates():
    """Nearly perfect measurements of nearly unknown states, a hundred times over."""
    rng = np.random.default_rng(0)
    P = np.diag([1e8, 1.0, 1e-9, 1e3])
    for _ in range(100):
        H = rng.normal(size=(3, 4)) * 10.0 ** rng.uniform(-4, 3, size=(3, 1))
        H[2] = H[1] * (1 + 1e-9)  # two channels that repeat each other
        _, P, _, _ = update(np.zeros(4), P, np.ones(3), H, 1e-7 * np.eye(3), np.inf)
        assert np.array_equal(P, P.T)
        assert np.linalg.eigvalsh(P).min() >= -1e-12 * np.trace(P)
        P = P + 1e-6 * np.eye(4)


@settings(max_examples=50, deadline=None)
@given(st.integers(0, 10_000))
def test_prediction_composes_and_correction_shrinks(seed):
    z, P, r, H, R = random_problem(seed)
    F = np.random.default_rng(seed).normal(size=P.shape)
    Q = np.eye(len(z))
    once = predict_covariance(P, F, Q)
    assert once == pytest.approx(F @ P @ F.T + Q)
    corrected = update(z, P, r, H, R, np.inf)[1]
    assert np.linalg.eigvalsh(P - corrected).min() > -1e-8


@settings(max_examples=50, deadline=None)
@given(st.integers(0, 10_000))
def test_what_stands_still_is_carried_as_by_the_whole_product(seed):
    _, P, _, _, _ = random_problem(seed)
    rng, n = np.random.default_rng(seed), len(P)
    moving = int(rng.integers(0, n + 1))
    F = np.diag(rng.uniform(0.5, 1.0, n))
    F[:moving] = rng.normal(size=(moving, n)) * (rng.random((moving, n)) < 0.5)
    carried = P.copy()
    carry_into(carried, F, moving, np.full_like(P, np.nan))
    assert carried == pytest.approx(F @ P @ F.T)
    assert np.array_equal(carried, carried.T)


def test_cholesky_solve_is_numpys():
    _, P, _, H, _ = random_problem(3)
    assert cholesky_solve(P, H.T.copy()) == pytest.approx(np.linalg.solve(P, H.T))
