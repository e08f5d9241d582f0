"""Evidence of linear Gaussian models against dense multivariate normals."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.stats import multivariate_normal, norm

from twinbench.mismatch.naming.marginal import (
    DISCREPANCY_PCT,
    LEARNT,
    Reduced,
    eliminated,
    learn,
    one_sided,
)
from twinbench.mismatch.naming.sets import Sets
from twinbench.physics.simulator import Array

N = 60


def dense(r: Array, mean: Array, cov: Array) -> float:
    """Log density over that of white noise alone."""
    return float(multivariate_normal(mean, cov).logpdf(r) - norm.logpdf(r).sum())


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_what_is_integrated_out_leaves_the_density_of_the_readings(seed):
    rng = np.random.default_rng(seed)
    J, r = rng.normal(size=(N, 4)) * [1.0, 30.0, 0.1, 1e3], rng.normal(size=N) * 2.0
    mean, precision = rng.normal(size=4), np.array([1.0, 4.0, 0.25, 9.0])
    found = eliminated(J.T @ J, J.T @ r, np.arange(4), mean, precision)
    assert found.log == pytest.approx(dense(r, J @ mean, np.eye(N) + J @ np.diag(1.0 / precision) @ J.T), abs=1e-4)
    assert found.G.shape == (0, 0)


def test_it_is_all_the_same_in_which_order_things_are_integrated_out():
    rng = np.random.default_rng(3)
    J, r = rng.normal(size=(N, 5)), rng.normal(size=N)
    G, b, mean, precision = J.T @ J, J.T @ r, rng.normal(size=5), np.full(5, 2.0)
    whole = eliminated(G, b, np.arange(5), mean, precision)
    first = eliminated(G, b, np.array([1, 3]), mean[[1, 3]], precision[[1, 3]])
    then = eliminated(first.G, first.b, np.arange(3), mean[[0, 2, 4]], precision[[0, 2, 4]])
    assert first.log + then.log == pytest.approx(whole.log, abs=1e-6)


def discrepancy(rng: np.random.Generator, size_pct: float) -> tuple[Array, Array, Array]:
    """Columns of two ports' functions, which port each is of, and readings with one port's discrepancy in them."""
    F, group = rng.normal(size=(N, 12)) * 3.0, np.repeat([0, 1], 6)
    return F, group, rng.normal(size=N) + F[:, :6] @ rng.normal(size=6) * size_pct


def evidence(F: Array, group: Array, r: Array, s: Array) -> float:
    """Log evidence of readings with discrepancies of given sizes, with their prior."""
    cov = np.eye(N) + (F * s[group] ** 2) @ F.T
    return dense(r, np.zeros(N), cov) - 0.5 * float(np.sum((s / DISCREPANCY_PCT) ** 2))


@pytest.mark.parametrize("size_pct", [0.05, 0.5, 2.0])
def test_the_size_that_is_learnt_has_the_highest_evidence(size_pct):
    F, group, r = discrepancy(np.random.default_rng(4), size_pct)
    found = learn(F.T @ F, F.T @ r, group, np.array([0.3, 0.3]), rounds=300)
    assert found.log == pytest.approx(evidence(F, group, r, found.s), abs=0.02)
    grid = np.geomspace(1e-3, 5.0, 40)
    best = max(evidence(F, group, r, np.array([a, b])) for a in grid for b in grid)
    assert found.log > best - 5.0 * LEARNT
    assert found.s[0] > 3.0 * found.s[1] or size_pct < 0.1


def test_the_weights_are_the_posterior_mean():
    F, group, r = discrepancy(np.random.default_rng(5), 1.0)
    found = learn(F.T @ F, F.T @ r, group, np.array([0.3, 0.3]), rounds=300)
    expected = np.linalg.solve(F.T @ F + np.diag(1.0 / found.s[group] ** 2), F.T @ r)
    some = found.s[group] > 0.05
    np.testing.assert_allclose(found.weights[some], expected[some], atol=0.02)


def test_a_size_of_one_sign_is_weighed_by_half_a_normal():
    mean, sd = np.array([0.8, -1.5, 0.0]), np.array([0.4, 0.5, 0.3])
    said = one_sided(mean, sd, np.array([True, True, False]))
    for k in range(2):
        half = quad(lambda g, k=k: 2.0 * norm.pdf(g, mean[k], sd[k]), 0.0, 20.0)[0]
        assert said[k] == pytest.approx(np.log(half), abs=1e-6)
    assert said[2] == 0.0


def sets(X: Array, F: Array, r: Array, bounded: bool = False) -> Sets:
    """Of columns X (n, V) and functions F (n, R) of one port."""
    both, v = np.column_stack((X, F)), X.shape[1]
    return Sets(
        reduced=Reduced(both.T @ both, both.T @ r, 0.0),
        group=np.zeros(F.shape[1], dtype=int),
        prior=np.full(v, -3.0),
        bounded=np.full(v, bounded),
        family=np.arange(v),
        usable=np.ones(v, dtype=bool),
        s=np.array([0.4]),
        since=np.full(v, -np.inf),
    )


def readings(seed: int, *there: int) -> tuple[Array, Array, Array]:
    rng = np.random.default_rng(seed)
    X, F = rng.normal(size=(N, 9)), rng.normal(size=(N, 3))
    return X, F, rng.normal(size=N) + X[:, list(there)].sum(axis=1) * 1.5 + F @ rng.normal(size=3) * 0.5


@pytest.mark.parametrize("key", [(), (2,), (1, 4), (0, 3, 7)])
def test_the_evidence_of_a_set_is_that_of_a_dense_gaussian(key):
    X, F, r = readings(6, 1, 4)
    found = sets(X, F, r).score(key)
    s = float(found.learnt.s[0])
    some = X[:, list(key)]
    expected = dense(r, np.zeros(N), np.eye(N) + some @ some.T + s**2 * F @ F.T) - 0.5 * (s / DISCREPANCY_PCT) ** 2
    assert found.log == pytest.approx(expected - 3.0 * len(key), abs=0.1)


def test_the_evidence_of_an_effect_of_one_sign_is_an_integral_over_that_sign():
    X, F, r = readings(7, 5)
    for sign in (1.0, -1.0):
        found = sets(sign * X, F, r, bounded=True).score((5,))
        s = float(found.learnt.s[0])
        cov = np.eye(N) + s**2 * F @ F.T

        def at(size: float, sign: float = sign, cov: Array = cov) -> float:
            return 2.0 * norm.pdf(size) * np.exp(dense(r, sign * size * X[:, 5], cov))

        integral = quad(at, 0.0, 8.0, points=[1.0, 1.5, 2.0])[0]
        expected = np.log(integral) - 0.5 * (s / DISCREPANCY_PCT) ** 2 - 3.0
        assert found.log == pytest.approx(expected, abs=0.15)


def test_what_is_quickly_said_of_every_effect_is_its_evidence_at_a_fixed_discrepancy():
    X, F, r = readings(8, 1, 4)
    s = np.array([0.4])
    gains = sets(X, F, r).quick((4,), s)
    base = np.eye(N) + s[0] ** 2 * F @ F.T + np.outer(X[:, 4], X[:, 4])
    for i in (0, 1, 7):
        more = dense(r, np.zeros(N), base + np.outer(X[:, i], X[:, i])) - dense(r, np.zeros(N), base)
        assert gains[i] == pytest.approx(more - 3.0, abs=1e-3)


@pytest.mark.parametrize("there", [(), (3,), (1, 4), (0, 2, 8)])
def test_the_search_finds_what_there_is(there):
    X, F, r = readings(9, *there)
    assert sets(X, F, r).search().key == there
