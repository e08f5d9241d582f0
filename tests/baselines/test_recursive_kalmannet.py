"""Recursive KalmanNet: its compiled tick is what was trained, its start is the Kalman filter, its covariance is one."""

import numpy as np
import pytest
import torch

from twinbench.baselines.gain_training import Carried, Equations, GainNetwork, likelihood, tick, told_of
from twinbench.baselines.learned_gain import Rules, correct
from twinbench.baselines.recursive_kalmannet import RecursiveKalmanNet
from twinbench.data.benchmark import DesignConfig, simulate_benchmark
from twinbench.machines.compressor import COMPRESSOR
from twinbench.methods.estimator import Sample
from twinbench.methods.kalman import gain, update
from twinbench.methods.training import load_weights

TICKS = 200
N_OUT, CHANNELS = len(COMPRESSOR.outputs), len(COMPRESSOR.channels)


@pytest.fixture(scope="module")
def split():
    return simulate_benchmark(
        DesignConfig(n_train=3, n_validation=1, n_calibration=1, n_test=2, n_single=0, minutes=2.5, warmup_minutes=0.5)
    )


@pytest.fixture(scope="module")
def fitted(split):
    estimator = RecursiveKalmanNet(**RecursiveKalmanNet.contract_settings)
    estimator.fit(split.train, split.validation, 0)
    return estimator


def shaken(fitted, by):
    """The same with weights at random: a gain that nobody would choose."""
    rng = np.random.default_rng(3)
    other = RecursiveKalmanNet(**fitted.config)
    other.arrays = {
        name: a + (by * rng.normal(size=a.shape)).astype(a.dtype) if name.startswith(("net.cell", "net.head")) else a
        for name, a in fitted.arrays.items()
    }
    other.restore()
    return other


def run(estimator, batch):
    state, said = estimator.init(len(batch)), []
    for k in range(TICKS):
        state, info = estimator.step(state, Sample(k * COMPRESSOR.sample_period_s, batch.measured[:, k]))
        said.append((state, info))
    return said


def test_compiled_recurrence_equals_torch_tick_by_tick(fitted, split):
    ours = shaken(fitted, 0.05)
    network = GainNetwork(ours.config["hidden"], *np.ones((2, len(ours._rules.unit), N_OUT)), CHANNELS)
    load_weights(network, ours.arrays)
    lessons = ours.lessons(split.test)
    said = run(ours, split.test)
    # The compiled filter does not predict before the first sample: torch begins after it.
    z, P, h, noise = (torch.from_numpy(part) for part in said[0][0].memory[:4])
    at = Carried(z, P, h.float(), noise)
    told = told_of(COMPRESSOR, lessons.filled[:, :TICKS], lessons.accepted[:, :TICKS])
    equations = Equations(ours._rhs, ours._output, ours._rules)
    with torch.no_grad():
        for k in range(1, TICKS):
            now = tuple(np.ascontiguousarray(part[:, k - 1]) for part in told)
            at = tick(network, equations, at, now, lessons.values[:, k].astype(np.float64))
            z, P = said[k][0].memory[:2]
            sd = np.sqrt(np.diagonal(P, axis1=1, axis2=2))
            np.testing.assert_allclose(at.z.numpy() / sd, z / sd, atol=2e-3, err_msg=f"tick {k}")
            scaled = sd[:, :, None] * sd[:, None]
            np.testing.assert_allclose(at.P.numpy() / scaled, P / scaled, atol=2e-3, err_msg=f"tick {k}")


def test_the_gradient_is_that_of_the_filter_as_it_runs(fitted, split):
    """Central differences of three ticks' loss along the gain's biases, against back-propagation.

    What the network reads carries no gradient, so it reads nothing here.
    """
    size = len(fitted._rules.unit)
    torch.manual_seed(0)
    network = GainNetwork(7, *0.05 * np.ones((2, size, N_OUT)), CHANNELS)
    network.cell.double()
    network.head.double()
    lessons = fitted.lessons(split.test)
    told = told_of(COMPRESSOR, lessons.filled[:, 200:204], lessons.accepted[:, 200:204])
    z, P = (torch.from_numpy(part) for part in fitted.start(2))
    equations = Equations(fitted._rhs, fitted._output, fitted._rules)

    def loss():
        at = Carried(z, P, torch.zeros(2, 7, dtype=torch.float64), torch.zeros(2, size + N_OUT, dtype=torch.float64))
        for k in range(3):
            now = tuple(np.ascontiguousarray(part[:, k]) for part in told)
            at = tick(network, equations, at, now, lessons.values[:, 201 + k].astype(np.float64))
        return likelihood(at, torch.from_numpy(lessons.truth[:, 203]).double(), lessons.judged, fitted._rules.unit)[
            0
        ].mean()

    loss().backward()
    bias = network.head.bias
    analytic, step = bias.grad.clone(), 1e-5
    largest = torch.argsort(analytic.abs(), descending=True)[:5]
    for i in largest:
        with torch.no_grad():
            ends = []
            for sign in (1.0, -2.0):
                bias[i] += sign * step
                ends.append(loss().item())
            bias[i] += step
        assert (ends[0] - ends[1]) / (2.0 * step) == pytest.approx(analytic[i].item(), rel=0.05)


def test_under_the_kalman_gain_a_correction_is_the_kalman_filters(fitted):
    rules = fitted._rules
    rng = np.random.default_rng(0)
    z, P = (part[0] for part in fitted.start(1))
    H = 1e-2 * rng.normal(size=(N_OUT, len(z)))
    R, innovation = np.diag([0.2, 0.5, 0.1]), np.array([0.1, np.nan, -0.2])
    K, S, _ = gain(P, innovation, H, R)
    G = K * np.sqrt(np.diagonal(S)) / np.sqrt(np.diagonal(P))[:, None]
    got, want = correct(rules, z, P, innovation, H, R, S, G), update(z, P, innovation, H, R, np.inf)
    sd = np.sqrt(np.diagonal(P))
    np.testing.assert_allclose((got[0] - want[0]) / sd, 0.0, atol=1e-9)
    np.testing.assert_allclose((got[1] - want[1]) / (sd[:, None] * sd), 0.0, atol=1e-9)


@pytest.mark.parametrize("by", [0.0, 0.05, 0.5])
def test_the_covariance_stays_positive_definite_under_any_gain(by, fitted, split):
    for state, info in run(shaken(fitted, by), split.test):
        sd = np.sqrt(np.diagonal(state.cov, axis1=1, axis2=2))
        assert np.linalg.eigvalsh(state.cov / (sd[:, :, None] * sd[:, None])).min() > 0.0
        assert np.linalg.eigvalsh(info.S).min() > 0.0


def test_no_deviation_grows_beyond_its_limit(fitted, split):
    state, _ = run(shaken(fitted, 0.5), split.test)[-1]
    assert isinstance(fitted._rules, Rules)
    grown = np.sqrt(np.diagonal(state.memory[1], axis1=1, axis2=2)) / fitted._rules.unit
    assert grown.max() <= 3.0 + 1e-9
