"""Each network's NumPy twin against torch, and all budgets against the proposed method's."""

import numpy as np
import pytest
import torch

from twinbench.baselines import features
from twinbench.baselines.deeponet import DeepONet, network_of, query_width
from twinbench.baselines.gru_kf import GRUKalman
from twinbench.baselines.lstm_rls import LSTMRecursiveLeastSquares
from twinbench.baselines.pinn_ukf import PINNUnscentedKalman
from twinbench.baselines.recurrent import SlowFast, SlowFastTwin
from twinbench.baselines.recursive_kalmannet import RecursiveKalmanNet
from twinbench.baselines.s5_kf import S5Kalman
from twinbench.baselines.sequences import Schedule, fit_sequences, read_out
from twinbench.data.benchmark import DesignConfig, simulate_benchmark
from twinbench.machines.compressor import COMPRESSOR
from twinbench.methods.operator import WINDOW, Operator
from twinbench.methods.training import weights_of

TICKS = 40


@pytest.mark.parametrize("cell", ["gru", "lstm"])
def test_recurrent_twin_equals_torch_tick_by_tick(cell):
    torch.manual_seed(0)
    network = SlowFast(cell, features=6, hidden=9, readout=11, outputs=4)
    twin = SlowFastTwin(weights_of(network))
    read = np.random.default_rng(0).normal(size=(2, 5 * TICKS, 6)).astype(np.float32)
    ticks, whole = read_out(network, read, TICKS, every=1)
    h, c = twin.init(2)
    for k in ticks:
        if k % TICKS == 0:
            h, c = twin.step(h, c, read[:, k])
        np.testing.assert_allclose(twin.read(h, read[:, k]), whole[:, k], atol=1e-6)


def test_sequence_training_remembers_what_only_the_past_of_the_sequence_tells():
    """The target is the sequence's first reading: no stretch but the first shows it."""
    rng = np.random.default_rng(0)
    torch.manual_seed(0)
    said = rng.choice([-1.0, 1.0], size=(64, 1, 1))
    read = np.zeros((64, 160 * TICKS, 2), np.float32)
    read[:, : 10 * TICKS, :1] = said
    target = np.broadcast_to(said, (*read.shape[:2], 1)).astype(np.float32)
    network = SlowFast("gru", 2, 12, 12, 1)
    fit_sequences(network, read, target, torch.nn.functional.mse_loss, rng, Schedule(150, 16, 2e-2), TICKS)
    _, out = read_out(network, read, TICKS, every=TICKS)
    assert np.mean((out[:, 80:] - said) ** 2) < 0.2


def test_running_means_tick_by_tick_equal_whole_sequences():
    values = np.random.default_rng(1).normal(size=(3, 200, 7))
    memory = features.init(3, 7)
    kept = features.keep_of(COMPRESSOR)
    whole = features.run(values, kept)
    assert whole.shape[-1] == features.width(7)
    for k in range(200):
        memory, row = features.step(memory, values[:, k], kept)
        np.testing.assert_allclose(row, whole[:, k], atol=1e-6)


def test_deeponet_twin_equals_torch():
    torch.manual_seed(0)
    estimator = DeepONet()
    network = network_of(estimator.config, COMPRESSOR)
    estimator._w = {n.removeprefix("net."): a for n, a in weights_of(network).items()}
    estimator.arrays = {"target.mean": np.zeros(11), "target.scale": np.ones(11)}
    rng = np.random.default_rng(0)
    window = rng.normal(size=(4, WINDOW + 1, 7)).astype(np.float32)
    masks = (rng.random((4, WINDOW, 7)) < 0.9).astype(np.float32)
    slow = rng.normal(size=(4, 28)).astype(np.float32)
    query = rng.normal(size=(4, 3, query_width(4))).astype(np.float32)
    with torch.no_grad():
        branch = network.branch(*map(torch.from_numpy, (window, masks, slow)))
        wanted = network(branch, torch.from_numpy(query)).numpy()
    twin = estimator._branch(window, masks, slow)
    np.testing.assert_allclose(twin, branch.numpy(), atol=1e-5)
    np.testing.assert_allclose(estimator._answer(twin, query), wanted, atol=1e-5)


@pytest.mark.parametrize(
    "kind", [GRUKalman, S5Kalman, LSTMRecursiveLeastSquares, DeepONet, PINNUnscentedKalman, RecursiveKalmanNet]
)
def test_every_network_has_the_budget_of_the_proposed_one(kind):
    split = simulate_benchmark(
        DesignConfig(n_train=1, n_validation=1, n_calibration=1, n_test=1, n_single=0, minutes=2.5, warmup_minutes=0.5)
    )
    estimator = kind(**kind.contract_settings)
    estimator.fit(split.train, split.validation, 0)
    weights = sum(a.size for name, a in estimator.arrays.items() if name.startswith("net."))
    assert weights == pytest.approx(sum(p.numel() for p in Operator().parameters()), rel=0.05)
