"""The residual UKF: without its residual the nominal UKF, with it nearer to the plant."""

import numpy as np
import pytest
import torch

from twinbench.baselines.nominal_ukf import NominalUKF
from twinbench.baselines.perceptron import network_input, perceptron
from twinbench.baselines.residual import residual_rates
from twinbench.baselines.residual_ukf import ResidualUKF
from twinbench.baselines.slow_errors import slow_error_sd
from twinbench.data.benchmark import DesignConfig, simulate_benchmark
from twinbench.machines.compressor import COMPRESSOR
from twinbench.methods.estimator import Sample
from twinbench.methods.training import load_weights
from twinbench.methods.transitions import draw_transitions
from twinbench.physics.integrate import Varying, advance

DESIGN = DesignConfig(n_train=3, n_validation=1, n_calibration=1, n_test=2, n_single=0, minutes=2.5, warmup_minutes=0.5)
TICKS = 300
N, PERIOD_S = len(COMPRESSOR.estimated), COMPRESSOR.sample_period_s


@pytest.fixture(scope="module")
def split():
    return simulate_benchmark(DESIGN)


@pytest.fixture(scope="module")
def fitted(split):
    estimator = ResidualUKF(**{**ResidualUKF.contract_settings, "iterations": 400, "calibration_minutes": 1.0})
    estimator.fit(split.train, split.validation, 0)
    return estimator


def with_arrays(kind, fitted, **changed):
    same = {name: value for name, value in fitted.config.items() if name in kind.settings}
    estimator = kind(**same)
    estimator.arrays = {**fitted.arrays, **changed}
    estimator.restore()
    return estimator


def run(estimator, batch):
    state = estimator.init(len(batch))
    said = []
    for k in range(TICKS):
        state, info = estimator.step(state, Sample(k * PERIOD_S, batch.measured[:, k]))
        said.append((state.mean, state.cov, info.innovation, info.S))
    inputs = np.nan_to_num(batch.measured[:, TICKS : TICKS + 100, : len(COMPRESSOR.inputs)], nan=1.0)
    return said, estimator.forecast(state, inputs)


def test_with_a_zero_residual_it_is_the_nominal_ukf(fitted, split):
    nothing = {f"net.4.{part}": np.zeros_like(fitted.arrays[f"net.4.{part}"]) for part in ("weight", "bias")}
    ours, ours_ahead = run(with_arrays(ResidualUKF, fitted, **nothing), split.test)
    theirs, theirs_ahead = run(with_arrays(NominalUKF, fitted), split.test)
    for mine, other in zip(ours, theirs, strict=True):
        for part, peer in zip(mine, other, strict=True):
            np.testing.assert_allclose(part, peer, rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(ours_ahead, theirs_ahead, rtol=1e-12)


def test_with_its_residual_it_is_another_filter(fitted, split):
    ours, _ = run(fitted, split.test)
    theirs, _ = run(with_arrays(NominalUKF, fitted), split.test)
    assert np.abs(ours[-1][0] - theirs[-1][0]).max() > 1e-3


def test_compiled_residual_equals_torch(fitted):
    a = fitted.arrays
    network = perceptron(len(a["input.mean"]), fitted.config["hidden"], N)
    load_weights(network, a)
    read = np.random.default_rng(0).normal(size=(50, len(a["input.mean"])))
    with torch.no_grad():
        wanted = network(torch.from_numpy(read.astype(np.float32))).numpy() * a["rate.scale"]
    said = residual_rates(fitted._net, a["input.mean"] + a["input.scale"] * read)
    np.testing.assert_allclose(said / a["rate.scale"], wanted / a["rate.scale"], atol=1e-5)


def test_most_of_what_the_nominal_model_leaves_out_is_learnt(fitted, split):
    train, moves = split.train, draw_transitions(split.train, 2000, np.random.default_rng(7))
    at = (moves.sequence, moves.sample)
    x = np.concatenate([moves.x, train.truth.states[*at, N:]], axis=1)
    health = Varying(COMPRESSOR.health_names, moves.theta)
    known = advance(fitted.simulator(), x, train.truth.inputs[at], PERIOD_S, 1, health)[:, :N]
    missing = (moves.x_next - known) / PERIOD_S
    left = missing - residual_rates(fitted._net, network_input(train, moves))
    share = np.sqrt((left**2).mean(axis=0) / (missing**2).mean(axis=0))
    # Intake pressure is left out: the reduced model has it nearly right.
    assert (share[1:] < 0.5).all(), share


def test_what_it_errs_by_for_minutes_is_its_own_and_not_the_nominal_models(fitted, split):
    nominal = slow_error_sd(fitted.simulator(), split.validation)
    assert (fitted.arrays["slow_error.sd"] != nominal).all()
    nothing = slow_error_sd(fitted.simulator(), split.validation, 1, lambda x, u, theta: np.zeros((len(x), N)))
    np.testing.assert_array_equal(nothing, nominal)


def test_the_covariance_stays_positive_definite(fitted, split):
    for _, cov, _, S in run(fitted, split.test)[0]:
        assert np.linalg.eigvalsh(cov).min() > 0.0
        assert np.linalg.eigvalsh(S).min() > 0.0
