"""The state-space memory: its scan is the recurrence, and the compiled recurrence is torch's network."""

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from twinbench.baselines.gru_kf import GRUKalman
from twinbench.baselines.s5_kf import S5Kalman
from twinbench.baselines.sequences import Schedule, fit_sequences, read_out
from twinbench.baselines.state_space import StateSpace, scan
from twinbench.baselines.state_space_twin import StateSpaceTwin
from twinbench.methods.training import weights_of

TICKS = 40


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 10_000), st.integers(1, 40))
def test_scan_is_the_recurrence_written_out(seed, steps):
    rng = np.random.default_rng(seed)
    keep, drive, s = rng.random((2, steps, 3)), rng.normal(size=(2, steps, 3)), rng.normal(size=(2, 3))
    states = scan(*(torch.from_numpy(a) for a in (keep, drive, s))).numpy()
    for k in range(steps):
        s = keep[:, k] * s + drive[:, k]
        np.testing.assert_allclose(states[:, k], s, rtol=1e-12, atol=1e-12)


def shaken(network):
    """Weights as after training: none of them zero."""
    with torch.no_grad():
        for parameter in network.parameters():
            parameter += 0.3 * torch.randn_like(parameter) / np.sqrt(parameter.shape[-1])
    return network


def test_compiled_recurrence_equals_torch_tick_by_tick():
    torch.manual_seed(0)
    network = shaken(StateSpace(6, (8, 10, 3), readout=11, outputs=4))
    twin = StateSpaceTwin(weights_of(network))
    read = np.random.default_rng(0).normal(size=(2, 7 * TICKS, 6)).astype(np.float32)
    ticks, whole = read_out(network, read, TICKS, every=1)
    h, c = twin.init(2)
    for k in ticks:
        if k % TICKS == 0:
            h, c = twin.step(h, c, read[:, k])
        np.testing.assert_allclose(twin.read(h, read[:, k]), whole[:, k], atol=2e-5)


def test_stretches_with_the_memory_carried_over_equal_the_whole():
    torch.manual_seed(1)
    network = shaken(StateSpace(3, (6, 5, 2), readout=4, outputs=2))
    slow = torch.randn(2, 20, 3)
    whole, end = network.remember(slow, network.blank(2))
    first, carried = network.remember(slow[:, :13], network.blank(2))
    second, last = network.remember(slow[:, 13:], carried)
    torch.testing.assert_close(torch.cat([first, second], dim=1), whole, atol=1e-5, rtol=1e-5)
    for ours, theirs in zip(last, end, strict=True):
        torch.testing.assert_close(ours, theirs, atol=1e-5, rtol=1e-5)


def test_it_remembers_what_only_the_past_of_the_sequence_tells():
    """The target is the sequence's first reading: no stretch but the first shows it."""
    rng = np.random.default_rng(0)
    torch.manual_seed(0)
    said = rng.choice([-1.0, 1.0], size=(64, 1, 1))
    read = np.zeros((64, 160 * TICKS, 2), np.float32)
    read[:, : 10 * TICKS, :1] = said
    target = np.broadcast_to(said, (*read.shape[:2], 1)).astype(np.float32)
    network = StateSpace(2, (12, 12, 1), 12, 1)
    fit_sequences(network, read, target, torch.nn.functional.mse_loss, rng, Schedule(150, 16, 2e-2), TICKS)
    _, out = read_out(network, read, TICKS, every=TICKS)
    assert np.mean((out[:, 80:] - said) ** 2) < 0.2


@pytest.mark.parametrize("setting", ["iterations", "batch", "copies"])
def test_all_but_the_memory_is_as_with_the_recurrent_network(setting):
    assert S5Kalman.settings[setting] == GRUKalman.settings[setting]
