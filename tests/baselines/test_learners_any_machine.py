"""The learnt baselines on machines other than the compressor: other sizes, another sample rate, other lags."""

import numpy as np
import pytest

from twinbench.baselines.deeponet import DeepONet
from twinbench.baselines.gru_kf import GRUKalman
from twinbench.baselines.layout import acting, actuators, layout_of
from twinbench.baselines.lstm_rls import LSTMRecursiveLeastSquares
from twinbench.baselines.pinn_ukf import PINNUnscentedKalman
from twinbench.baselines.recurrent import ticks_per_step
from twinbench.baselines.recursive_kalmannet import RecursiveKalmanNet
from twinbench.baselines.residual_ukf import ResidualUKF
from twinbench.baselines.s5_kf import S5Kalman
from twinbench.baselines.sequences import apart
from twinbench.data.benchmark import DesignConfig, simulate_benchmark
from twinbench.machines.compressor import COMPRESSOR
from twinbench.machines.motor import MOTOR
from twinbench.machines.two_tanks import TWO_TANKS
from twinbench.methods.estimator import Sample
from twinbench.methods.lags import lag_share, lags_of

LEARNERS = [
    GRUKalman,
    S5Kalman,
    LSTMRecursiveLeastSquares,
    DeepONet,
    PINNUnscentedKalman,
    ResidualUKF,
    RecursiveKalmanNet,
]
DESIGN = DesignConfig(n_train=2, n_validation=1, n_calibration=1, n_test=2, n_single=0, minutes=4.0, warmup_minutes=1.0)
TICKS, AHEAD = 150, 40


@pytest.fixture(
    scope="module", params=[pytest.param(TWO_TANKS, marks=pytest.mark.slow), MOTOR], ids=lambda machine: machine.name
)
def split(request):
    return simulate_benchmark(DESIGN, machine=request.param)


def run(estimator, batch):
    machine, state = batch.machine, estimator.init(len(batch))
    for k in range(TICKS):
        state, info = estimator.step(state, Sample(k * machine.sample_period_s, batch.measured[:, k]))
    inputs = batch.truth.inputs[:, TICKS : TICKS + AHEAD]
    return state, info, estimator.forecast(state, inputs)


@pytest.mark.parametrize("kind", LEARNERS, ids=lambda kind: kind.name)
def test_a_learner_runs_on_a_machine_of_other_sizes_and_is_the_same_from_a_file(kind, split, tmp_path):
    machine, batch = split.train.machine, split.test
    B, n, ny = len(batch), len(machine.quantities), len(machine.outputs)
    estimator = kind(machine, **kind.contract_settings)
    estimator.fit(split.train, split.validation, 0)
    state, info, ahead = run(estimator, batch)
    assert state.mean.shape == (B, n)
    assert state.cov.shape == (B, n, n)
    assert info.S.shape == (B, ny, ny)
    assert ahead.shape == (B, AHEAD, ny)
    assert all(np.isfinite(part).all() for part in (*state[:4], info.S, ahead))
    assert (state.low <= state.mean).all()
    assert (state.mean <= state.high).all()
    sd = np.sqrt(np.diagonal(state.cov, axis1=1, axis2=2))
    assert np.linalg.eigvalsh(state.cov / (sd[:, :, None] * sd[:, None])).min() > -1e-9
    estimator.save(tmp_path / "learnt.npz")
    again, _, ahead_again = run(kind.load(tmp_path / "learnt.npz", machine), batch)
    np.testing.assert_array_equal(again.mean, state.mean)
    np.testing.assert_array_equal(ahead_again, ahead)


def test_the_layout_names_what_sensors_see():
    layout = layout_of(COMPRESSOR, as_read=True)
    assert layout.columns.tolist() == [0, 1, 2, 3, 4, 5]
    assert np.flatnonzero(layout.seen).tolist() == [0, 1, 2, 4, 5]
    assert [tuple(at) for at in np.argwhere(layout.shift)] == [(2, 4), (5, 4)]
    motor = layout_of(MOTOR, as_read=True)
    assert motor.columns.tolist() == [0, 1, 2, 3]
    assert motor.read.tolist() == [1, 0, 3]
    assert [tuple(at) for at in np.argwhere(motor.shift)] == [(0, 4)]
    assert layout_of(TWO_TANKS).columns.tolist() == [0, 1]


@pytest.mark.parametrize("as_read", [False, True])
@pytest.mark.parametrize("machine", [COMPRESSOR, TWO_TANKS, MOTOR], ids=lambda machine: machine.name)
def test_readings_of_the_true_states_are_the_plants_and_slopes_are_their_derivatives(machine, as_read):
    layout = layout_of(machine, as_read)
    truth = simulate_benchmark(DESIGN, machine=machine).train.truth
    z = layout.targets(truth)
    span = truth.outputs.std(axis=(0, 1))
    # The compressor's plant has a gain of the flow meter that no reading knows.
    exact = [i for i in range(len(machine.outputs)) if (machine, i) != (COMPRESSOR, 2)]
    np.testing.assert_allclose((layout.readings(z) - truth.outputs)[..., exact] / span[exact], 0.0, atol=1e-6)
    rows = z[0, ::500]
    H, size = layout.slopes(rows), 1e-4
    for j in range(layout.size):
        ends = []
        for sign in (1.0, -1.0):
            moved = rows.copy()
            moved[:, j] += sign * size
            ends.append(layout.readings(moved))
        np.testing.assert_allclose(H[:, :, j], (ends[0] - ends[1]) / (2.0 * size), rtol=1e-4, atol=1e-6)
    free, _ = layout.freed(rows, np.tile(np.eye(layout.size), (len(rows), 1, 1)))
    np.testing.assert_allclose(free[:, : layout.zeta], truth.states[0, ::500][:, layout.columns], rtol=1e-6, atol=1e-6)


def test_lags_follow_states_and_inputs_and_their_rates_are_the_plants():
    tanks, motor, compressor = (lags_of(machine) for machine in (TWO_TANKS, MOTOR, COMPRESSOR))
    assert (tanks.state.tolist(), tanks.input.tolist()) == ([-1], [0])
    assert (motor.state.tolist(), motor.input.tolist()) == ([2], [-1])
    share, slope = lag_share(tanks, 0, np.zeros(2))
    assert (share, slope) == (pytest.approx(1.0 - np.exp(-0.2 / 1.5)), 0.0)
    x = np.array([1.0, 3.0, 430.0, 350.0, 0.64])
    share, slope = lag_share(compressor, 0, x)
    assert share == pytest.approx(1.0 - np.exp(-0.05 / (5.0 / 0.8)))
    x[4] += 1e-5
    assert slope == pytest.approx((lag_share(compressor, 0, x)[0] - share) / 1e-5, rel=1e-3)
    assert [part.tolist() for part in actuators(COMPRESSOR)] == [[6], [3]]
    assert acting(COMPRESSOR).tolist() == [True, True, True, True, False]


def test_the_memory_steps_every_other_second_at_any_sample_rate():
    assert [ticks_per_step(machine) for machine in (COMPRESSOR, TWO_TANKS)] == [40, 10]
    for ticks in (1, 2, 7, 10, 40, 46):
        assert ticks % apart(ticks) == 0
    assert (apart(40), apart(7), apart(46)) == (5, 1, 2)
