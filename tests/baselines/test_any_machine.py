"""Every filter of a model, and the trivial rows, on machines that are no compressor."""

from __future__ import annotations

import functools

import numpy as np
import pytest
from helpers.lone_tank import LONE_TANK

from twinbench.baselines.always_prior import AlwaysPrior
from twinbench.baselines.last_value import LastValue
from twinbench.baselines.nominal_ekf import NominalEKF
from twinbench.baselines.nominal_enkf import NominalEnKF
from twinbench.baselines.nominal_iekf import NominalIEKF
from twinbench.baselines.nominal_imm import NominalIMM
from twinbench.baselines.nominal_mhe import NominalMHE
from twinbench.baselines.nominal_pf import NominalPF
from twinbench.baselines.nominal_ukf import NominalUKF
from twinbench.baselines.oracle import Oracle
from twinbench.baselines.oracle_smoother import OracleSmoother
from twinbench.baselines.training_mean import TrainingMean
from twinbench.data.batch import Batch
from twinbench.data.benchmark import DesignConfig, Split, simulate_benchmark
from twinbench.machines.machine import Machine
from twinbench.machines.motor import MOTOR
from twinbench.machines.two_tanks import TWO_TANKS
from twinbench.methods import modes
from twinbench.methods.estimator import Estimator, Sample, State

MACHINES = pytest.mark.parametrize(
    "machine", [pytest.param(TWO_TANKS, marks=pytest.mark.slow), MOTOR, LONE_TANK], ids=lambda machine: machine.name
)
TRIVIAL = (AlwaysPrior, TrainingMean, LastValue)
NOMINAL = (NominalEKF, NominalUKF, NominalIEKF, NominalEnKF, NominalPF, NominalIMM, NominalMHE)
SOME_TICKS = 600


def on_machines(*kinds: type[Estimator]) -> pytest.MarkDecorator:
    """Each kind on each machine. What compiles a filter anew for one more machine takes a minute: those are slow tests,
    but for one filter and the oracle."""
    pairs = []
    for machine in (TWO_TANKS, MOTOR, LONE_TANK):
        for kind in kinds:
            usual = machine is LONE_TANK or (machine is MOTOR and kind in (*TRIVIAL, NominalEKF, Oracle))
            marks = () if usual else pytest.mark.slow
            pairs.append(pytest.param(machine, kind, marks=marks, id=f"{machine.name}-{kind.name}"))
    return pytest.mark.parametrize(("machine", "kind"), pairs)


@functools.cache
def population(machine: Machine, minutes: float, test: int, train: int = 2) -> Split:
    return simulate_benchmark(
        DesignConfig(
            n_train=train,
            n_validation=1,
            n_calibration=1,
            n_test=test,
            n_single=0,
            minutes=minutes + 1.0,
            warmup_minutes=1.0,
        ),
        machine=machine,
    )


@functools.cache
def fitted(kind: type[Estimator], machine: Machine) -> Estimator:
    split, estimator = population(machine, 4.0, 2), kind(machine, **kind.contract_settings)
    estimator.fit(split.train, split.validation, 0)
    return estimator


def stepped(estimator: Estimator, batch: Batch, ticks: int) -> tuple[State, np.ndarray]:
    """The state after so many ticks, and the means (B, ticks, n) on the way."""
    state, means = estimator.init(len(batch)), []
    for k in range(ticks):
        state, _ = estimator.step(state, Sample(float(batch.time_s[k]), batch.measured[:, k]))
        means.append(state.mean)
    return state, np.stack(means, axis=1)


def health_error(estimator: Estimator, batch: Batch) -> float:
    """Mean absolute error of health in shares of a life, the first fifth left out."""
    assert batch.truth is not None
    said = stepped(estimator, batch, len(batch.time_s))[1][..., len(batch.machine.estimated) :]
    late = slice(len(batch.time_s) // 5, None)
    return float(np.abs((said - batch.truth.health) / batch.machine.span)[:, late].mean())


@on_machines(*TRIVIAL, *NOMINAL, Oracle, OracleSmoother)
def test_shapes_are_the_machines_and_what_is_saved_goes_on_as_it_was(machine, kind, tmp_path):
    estimator, batch = fitted(kind, machine), population(machine, 4.0, 2).test
    n, ny = len(machine.quantities), len(machine.outputs)
    ticks = min(SOME_TICKS, len(batch.time_s) - 60)
    state, _ = stepped(estimator, batch, ticks)
    assert state.mean.shape == state.low.shape == state.high.shape == (2, n)
    assert state.cov.shape == (2, n, n)
    assert (state.low <= state.mean).all()
    assert (state.mean <= state.high).all()
    after, info = estimator.step(state, Sample(0.0, batch.measured[:, ticks]))
    assert np.isfinite(after.mean).all()
    assert info.innovation.shape == info.accepted.shape == (2, ny)
    assert info.S.shape == (2, ny, ny)
    assert info.age_s.shape == (2, len(machine.channels))
    ahead = estimator.forecast(state, batch.truth.inputs[:, ticks : ticks + 40])
    assert ahead.shape == (2, 40, ny)
    assert np.isfinite(ahead).all()
    estimator.save(tmp_path / "kept.npz")
    again = kind.load(tmp_path / "kept.npz", machine)
    np.testing.assert_array_equal(again.step(state, Sample(0.0, batch.measured[:, ticks]))[0].mean, after.mean)
    np.testing.assert_array_equal(again.forecast(state, batch.truth.inputs[:, ticks : ticks + 40]), ahead)


@on_machines(*NOMINAL)
def test_a_filter_follows_the_states_that_it_reads(machine, kind):
    estimator, batch = fitted(kind, machine), population(machine, 4.0, 2).test
    ticks = min(SOME_TICKS, len(batch.time_s))
    late = slice(ticks - 100, ticks)
    _, said = stepped(estimator, batch, ticks)
    for reading, noise in zip(machine.readings, machine.noise[len(machine.inputs) :], strict=True):
        if not reading.bias and reading.state in machine.estimated:
            at = machine.estimated.index(reading.state)
            off = said[:, late, at] - batch.truth.states[:, late, at]
            assert np.sqrt(np.mean(off**2)) < np.hypot(noise.white, noise.coloured) / reading.gain


@pytest.mark.parametrize(
    "machine", [TWO_TANKS, LONE_TANK, pytest.param(MOTOR, marks=pytest.mark.slow)], ids=lambda m: m.name
)
def test_the_oracle_knows_more_of_health_than_the_prior(machine):
    split = population(machine, 15.0, 8, 6)
    errors = []
    for kind in (Oracle, AlwaysPrior):
        estimator = kind(machine)
        estimator.fit(split.train, split.validation, 0)
        errors.append(health_error(estimator, split.test))
    assert errors[0] < 0.9 * errors[1]


@pytest.mark.parametrize(
    "machine", [*(pytest.param(m, marks=pytest.mark.slow) for m in (TWO_TANKS, MOTOR)), LONE_TANK], ids=lambda m: m.name
)
def test_where_modes_are_alike_hindsight_is_the_filter_at_the_end_and_surer_before(machine, monkeypatch):
    monkeypatch.setattr(modes, "failing_of", lambda machine: np.arange(0))
    oracle, batch = OracleSmoother(machine, still=1.0, leap=0.0), population(machine, 4.0, 2).test.select([0])
    oracle.arrays = fitted(OracleSmoother, machine).arrays
    oracle.restore()
    last = min(SOME_TICKS, len(batch.time_s)) - 1
    state, _ = stepped(oracle, batch, last + 1)
    known = oracle.smooth(batch.measured[:, : last + 1], np.array([last // 2, last]))
    sd = np.sqrt(np.diagonal(known.cov, axis1=1, axis2=2))
    np.testing.assert_allclose(known.mean[1] / sd[1], state.mean[0] / sd[1], atol=1e-3)
    halfway, _ = stepped(oracle, batch, last // 2 + 1)
    assert np.median(sd[0] ** 2 / np.diagonal(halfway.cov[0])) < 1.0
