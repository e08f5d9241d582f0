"""What the filters of the nominal model share: points move and read as the EKF's mean does, and estimates are alike."""

import numpy as np
import pytest

from twinbench.baselines.augmented_model import Filter, linearise, measure, sensor_keep, size_of
from twinbench.baselines.nominal_ekf import NominalEKF
from twinbench.baselines.nominal_enkf import NominalEnKF
from twinbench.baselines.nominal_filter import advance, nis_of, read
from twinbench.baselines.nominal_iekf import NominalIEKF
from twinbench.baselines.nominal_imm import NominalIMM
from twinbench.baselines.nominal_mhe import NominalMHE
from twinbench.baselines.nominal_pf import NominalPF
from twinbench.baselines.nominal_ukf import NominalUKF
from twinbench.data.benchmark import DesignConfig, simulate_benchmark
from twinbench.machines.compressor import COMPRESSOR
from twinbench.methods import modes
from twinbench.methods.estimator import Sample
from twinbench.physics.compile import compiled
from twinbench.physics.jit import as_argument
from twinbench.physics.nominal import NOMINAL

U, U_SD = np.array([1.0, 298.0, 1400.0, 0.6]), np.array([1e-3, 0.2, 1.5, 0.0])
COLOURED = np.array([0.01, 0.4, 6e-4])


def filter_of_nominal():
    """The filter's record with slow errors, and a point well inside its bounds."""
    nx = len(NOMINAL.states)
    n = size_of(COMPRESSOR, NOMINAL, slow_errors=True)
    health = np.array([NOMINAL.index(name) for name in COMPRESSOR.health_names])
    bias = np.array([h.on_readings for h in COMPRESSOR.health])
    far = np.full(nx + len(health), 1e6)
    drift = np.split(COMPRESSOR.drift_shares, [len(COMPRESSOR.inputs)])
    model = Filter(
        NOMINAL.theta(), COMPRESSOR.coordinates, health, ~bias, bias, np.full(nx, 1e-4), 0.01 * np.eye(n),
        sensor_keep(COMPRESSOR), *drift, 0.99, 0.05, 1, -far, far,
    )  # fmt: skip
    z = np.zeros(n)
    z[:nx] = NOMINAL.initial(U, np.array([3.1, 430.0, 0.12]), NOMINAL.theta())
    z[nx:] = np.random.default_rng(0).normal(size=n - nx)
    z[-len(COMPRESSOR.estimated) :] *= 1e-4
    return model, z


def test_a_point_moves_and_reads_as_the_ekfs_mean():
    equations = compiled(NOMINAL)
    rhs, output = as_argument(equations.rhs), as_argument(equations.output)
    model, z = filter_of_nominal()
    after, _, _ = linearise(rhs, model, z, U, U_SD)
    np.testing.assert_array_equal(advance(rhs, model, z.copy(), U), after)
    measured = np.array([3.0, 428.0, 0.11])
    innovation, _, _ = measure(output, model, z, U, measured, COLOURED, COLOURED)
    np.testing.assert_allclose(read(output, model, z, U, COLOURED), measured - innovation, rtol=1e-13)


def test_a_point_beyond_the_bounds_moves_from_the_bound():
    rhs = as_argument(compiled(NOMINAL).rhs)
    model, z = filter_of_nominal()
    low = model.low.copy()
    low[0] = z[0]
    beyond = z.copy()
    beyond[0] -= 1.0
    np.testing.assert_array_equal(
        advance(rhs, model._replace(low=low), beyond, U), advance(rhs, model._replace(low=low), z.copy(), U)
    )  # fmt: skip


def test_nis_is_that_of_what_is_there():
    S = np.array([[2.0, 0.3, 0.1], [0.3, 1.0, 0.2], [0.1, 0.2, 0.5]])
    r = np.array([1.0, np.nan, -0.5])
    part = S[np.ix_([0, 2], [0, 2])]
    assert nis_of(r, S) == pytest.approx(r[[0, 2]] @ np.linalg.solve(part, r[[0, 2]]))
    assert np.isnan(nis_of(np.full(3, np.nan), S))


@pytest.fixture(scope="module")
def split():
    return simulate_benchmark(
        DesignConfig(n_train=2, n_validation=1, n_calibration=1, n_test=1, minutes=3.0, warmup_minutes=0.5)
    )


SETTINGS = {"calibration_minutes": 0.5, "slow_error": 0.0, "health_walk": 2.126, "state_walk": 126.8}
"""Wide walks and no slow errors: states nobody reads would leave the filters little to agree on in three minutes."""


def last_of(kind, split, **settings):
    estimator = kind(**{**SETTINGS, **settings})
    estimator.fit(split.train, split.validation, 0)
    state = estimator.init(1)
    for k in range(split.validation.measured.shape[1]):
        state, _ = estimator.step(state, Sample(split.validation.time_s[k], split.validation.measured[:1, k]))
    return state.mean[0], np.sqrt(np.diagonal(state.cov[0]))


@pytest.fixture(scope="module")
def ekf(split):
    return last_of(NominalEKF, split)


@pytest.mark.parametrize("kind", [NominalUKF, NominalEnKF, NominalMHE, NominalPF])
def test_all_follow_one_distribution(kind, split, ekf):
    """Three minutes from a wide prior: a mistake in the equations would be tens of standard deviations.

    What bends, leakage above all, leaves the filters without Jacobians surer of health than the EKF is.
    """
    mean, sd = last_of(kind, split)
    gap = np.abs(mean - ekf[0]) / ekf[1]
    assert gap[:5].max() < 1.5
    assert gap[5:].max() < 4.0
    assert ((sd / ekf[1] > 0.1) & (sd / ekf[1] < 1.5)).all()


def test_iterating_moves_little_but_the_bias_where_outputs_are_nearly_linear(split, ekf):
    mean, sd = last_of(NominalIEKF, split)
    gap = np.abs(mean - ekf[0]) / ekf[1]
    assert gap[:-1].max() < 0.1
    assert gap[-1] < 0.5
    np.testing.assert_allclose(sd[:-1] / ekf[1][:-1], 1.0, atol=0.1)


def test_modes_that_do_not_differ_are_the_nominal_ekf(split, ekf, monkeypatch):
    monkeypatch.setattr(modes, "failing_of", lambda machine: np.arange(0))
    mean, sd = last_of(NominalIMM, split, still=1.0, leap=0.0)
    np.testing.assert_allclose(mean, ekf[0], rtol=1e-6)
    np.testing.assert_allclose(sd, ekf[1], rtol=1e-6)


def test_slow_errors_of_the_model_are_followed_too(split):
    for kind in (NominalUKF, NominalEnKF):
        few, many = last_of(kind, split), last_of(kind, split, slow_error=1.0)
        assert np.isfinite(many[0]).all()
        assert (many[1] > few[1]).any()
