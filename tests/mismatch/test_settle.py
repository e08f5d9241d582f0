"""A hypothesis brought to its own fixed point, from near and far."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from motor import MOTOR
from motor_friction import friction_found
from scipy.optimize import lsq_linear

from twinbench.mismatch.course import Acts, Course
from twinbench.mismatch.mixture import interval_of
from twinbench.mismatch.naming.bounded import bounded
from twinbench.mismatch.naming.effect import Effect
from twinbench.mismatch.naming.ground import Products
from twinbench.mismatch.naming.posterior import posterior
from twinbench.mismatch.naming.settle import SETTLED, Settled, settled
from twinbench.mismatch.naming.view import View
from twinbench.mismatch.variants import Variant, typical

SIZE = 1.2
"""Of the dry friction that is there, rad/s^2."""


def hypothesis(size: float, name: str = "coulomb_friction@omega_rad_s") -> Settled:
    d = friction_found().diagnosis
    (which,) = (i for i, c in enumerate(d.machine.candidates) if c.name == name)
    sd = abs(typical(d.machine.candidates[which]))
    naming = d.answer.naming
    return settled(*d.before, [Effect(Variant(which, ()), size, sd, -2.0)], naming.ground, naming.ground.s)


@pytest.mark.parametrize("size", [0.0, 0.3, 3.0])
def test_a_known_size_is_found_wherever_it_begins(size):
    found = hypothesis(size)
    assert found.sizes[0] == pytest.approx(SIZE, rel=0.08)
    assert found.sds[0] < 0.1 * SIZE
    assert found.at[found.entries(0)][0] == pytest.approx(found.sizes[0])
    true = {"R_ohm": 0.65, "J_kg_m2": 1.35}
    for k, u in enumerate(found.problem.unknowns):
        if u.name in true:
            assert found.at[k] == pytest.approx(true[u.name], rel=0.01)


def test_its_evidence_is_the_same_wherever_it_begins():
    logs = [hypothesis(size).log for size in (0.0, 0.3, 3.0)]
    assert np.ptp(logs) < 3.0 * SETTLED


def test_columns_that_lead_astray_are_made_by_runs(monkeypatch):
    """Here those of rates point the wrong way, so that no share of any step makes the fit better."""
    sound = hypothesis(0.3)
    told = Course.columns
    monkeypatch.setattr(
        Course, "columns", lambda self, acts, start=None: told(self, Acts(-acts.rates, -acts.reads), start)
    )
    found = hypothesis(0.3)
    assert found.sizes == pytest.approx(sound.sizes, rel=0.02)
    assert found.promised == 0.0


def test_what_is_there_is_likelier_than_nothing_and_what_is_not_is_less_likely():
    null = friction_found().diagnosis.answer.naming.null
    assert hypothesis(1.0).log > null.log + 50.0
    assert hypothesis(0.0, "sensor_gain@T_probe_K").log < null.log


def test_where_it_stands_its_residuals_are_those_of_runs_sample_by_sample():
    """What blocks leave out under an effect is another than without: stale, it drives the size away from the truth."""
    found = hypothesis(0.3)
    for r, residual in enumerate(found.problem.residuals(found.z)):
        track = found.problem.tracks[r]
        exact = track.means - track.block_means(found.problem.readings(r, found.z))
        assert residual == pytest.approx(exact, abs=1e-9, nan_ok=True)


def test_its_squares_are_those_of_a_ridge_regression():
    ground, found = friction_found().diagnosis.answer.naming.ground, hypothesis(SIZE)
    view = View.around(found.problem, found.z)
    own = view.unknowns()
    white = np.concatenate([ground.whitened(r, columns, view.residuals[r]) for r, columns in enumerate(own)])
    J, e, mean = white[:, :-1], white[:, -1], found.mean[: len(found.z)]
    step = np.linalg.lstsq(np.vstack((J, np.eye(len(mean)))), np.concatenate((e, mean)), rcond=None)[0]
    assert found.squares == pytest.approx(np.sum((e - J @ step) ** 2), rel=1e-6)


def test_what_is_explained_is_sought_no_further():
    naming = friction_found().diagnosis.answer.naming
    assert naming.explained
    assert not replace(naming, hypotheses=[naming.null]).explained
    lacking = hypothesis(0.0, "sensor_gain@T_probe_K")
    assert not replace(naming, hypotheses=[lacking]).explained


def test_the_null_is_the_problem_as_it_was():
    null = friction_found().diagnosis.answer.naming.null
    assert null.effects == ()
    assert len(null.at) == null.first == len(null.bare.unknowns)
    assert {u.name for u in null.problem.unknowns if u.kind == "parameter"} == {v.name for v in MOTOR.parameters}


@given(seed=st.integers(0, 10_000), n=st.integers(1, 8))
def test_a_step_within_bounds_is_that_of_bounded_least_squares(seed, n):
    rng = np.random.default_rng(seed)
    R, slope, k = rng.normal(size=(n + 3, n)), 3.0 * rng.normal(size=n), int(rng.integers(0, n + 1))
    A = R.T @ R + 0.1 * np.eye(n)
    low, high = -rng.exponential(size=k) * rng.integers(0, 2, k), rng.exponential(size=k)
    x, held = bounded(A, slope, low, high)
    L = np.linalg.cholesky(A)
    ends = (np.append(low, np.full(n - k, -np.inf)), np.append(high, np.full(n - k, np.inf)))
    least = lsq_linear(L.T, np.linalg.solve(L, slope), ends, method="bvls", tol=1e-14)
    assert x == pytest.approx(least.x, abs=1e-6)
    assert (x[:k][held[:k]] == np.where(x[:k] <= low, low, high)[held[:k]]).all()
    assert not held[k:].any()


def test_what_a_bound_holds_back_costs_what_is_beyond_it():
    """A parameter that would be likelier beyond its bound: the others go where they fit best beside it."""
    d = friction_found().diagnosis
    ground, (problem, z) = d.answer.naming.ground, d.before
    k = next(i for i, u in enumerate(problem.unknowns) if u.name == "R_ohm")
    free = settled(problem, z, (), ground, ground.s)
    bound = float(free.at[k]) - 0.02
    tight = replace(problem.unknowns[k], high=bound)
    short = replace(problem, unknowns=(*problem.unknowns[:k], tight, *problem.unknowns[k + 1 :]))
    found = settled(short, np.where(np.arange(len(z)) == k, bound, z), (), ground, ground.s)
    assert found.at[k] == bound
    # The same with the parameter known: what is fitted beside it is the same.
    known = replace(short, unknowns=(*problem.unknowns[:k], *problem.unknowns[k + 1 :]), theta=_with(problem, k, bound))
    beside = settled(known, np.delete(found.at, k), (), ground, ground.s)
    assert np.delete(found.at, k) == pytest.approx(beside.at, rel=0.02, abs=0.02)
    assert found.log < free.log
    assert found.log == pytest.approx(beside.log, abs=12.0)


def _with(problem, k, value):
    theta = problem.theta.copy()
    theta[problem.unknowns[k].at] = value
    return theta


def likely(*probabilities: float) -> list[SimpleNamespace]:
    """Hypotheses with such probabilities."""
    return [SimpleNamespace(log=np.log(p)) for p in probabilities]


def test_an_interval_of_a_mixture_holds_nine_tenths():
    rng = np.random.default_rng(0)
    mixture = likely(0.7, 0.3), [(0.0, 1.0), (5.0, 0.2)]
    which = rng.random(200_000) < 0.7
    drawn = np.where(which, rng.normal(0.0, 1.0, 200_000), rng.normal(5.0, 0.2, 200_000))
    low, high = interval_of(*mixture)
    assert (low, high) == pytest.approx(np.quantile(drawn, (0.05, 0.95)), abs=0.02)
    assert interval_of(*mixture, 0.0, 4.0) == (0.0, 4.0)


def test_an_interval_of_what_is_certain_is_that_number():
    for number in (1.0, 0.0, -3e8):
        sure = interval_of(likely(0.9, 0.1), [(number, 0.0)] * 2)
        assert sure == pytest.approx((number, number), rel=1e-12)
    apart = interval_of(likely(0.9, 0.1), [(1.0, 0.0), (2.0, 0.0)])
    assert apart == pytest.approx((1.0, 2.0), rel=1e-12)


def test_a_step_promises_what_it_gains_with_all_that_wanders_integrated_out():
    """Oracle: the marginal of readings under unknowns alone. What wanders moves with no step, and is not promised."""
    rng = np.random.default_rng(3)
    own, wander, left = rng.normal(size=(60, 2)), 2.0 * rng.normal(size=(60, 3)), 3.0 * rng.normal(size=60)
    mean = np.array([0.4, -0.7])
    white = np.concatenate((own, wander, left[:, None]), axis=1)
    products = Products((white.T @ white)[None], np.zeros((1, 6, 0)), np.zeros((1, 0, 0)))
    ground = friction_found().diagnosis.answer.naming.ground.exact
    wide = np.full(2, 100.0)
    found = posterior(products, np.concatenate((mean, np.zeros(3))), ground, np.empty(0), -wide, wide)

    inverse = np.linalg.inv(np.eye(60) + wander @ wander.T)
    best = np.linalg.solve(own.T @ inverse @ own + np.eye(2), own.T @ inverse @ left + mean)

    def cost(x):
        error = left - own @ x
        return 0.5 * (error @ inverse @ error + (x - mean) @ (x - mean))

    assert found.step == pytest.approx(best, abs=1e-6)
    assert found.promised == pytest.approx(cost(np.zeros(2)) - cost(best), rel=1e-6)
