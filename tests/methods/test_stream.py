"""The streaming operator is the windowed network, and its Jacobian is autograd's."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from twinbench.machines.compressor import COMPRESSOR
from twinbench.methods.deeponet_kalman.layout import pack, scratch_type, stream_type
from twinbench.methods.deeponet_kalman.stream import heads, heads_with_jacobian, push
from twinbench.methods.operator import WINDOW, Operator, acting
from twinbench.methods.training import weights_of

N_STATES, N_ZETA = len(COMPRESSOR.estimated), len(acting(COMPRESSOR))
TIME = torch.tensor([COMPRESSOR.sample_period_s])


@pytest.fixture(scope="module")
def operator():
    torch.manual_seed(3)
    return Operator()


@pytest.fixture(scope="module")
def samples():
    rng = np.random.default_rng(0)
    n = 2000
    values = rng.normal(size=(n, 7)).astype(np.float32)
    masks = (rng.random((n, 7)) > 0.1).astype(np.float32)
    query = rng.normal(size=(n, 5)).astype(np.float32)
    return values, masks, query


def streamed(operator: Operator, samples, ticks: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Weights, stream and scratch of a machine after so many ticks."""
    weights = pack(COMPRESSOR, weights_of(operator))
    stream, room = np.zeros(1, stream_type(weights)), np.zeros(1, scratch_type(weights))
    for k in range(ticks):
        push(weights[0], stream[0], room[0], *(s[k].copy() for s in samples))
    return weights, stream, room


def windowed_base(operator: Operator, samples, stream: np.ndarray, ticks: int) -> tuple[torch.Tensor, np.ndarray]:
    """The heads' first layer from the whole window, padded with the first sample where it is short."""
    values, masks, query = samples
    k = ticks - 1
    index = np.maximum(np.arange(k - WINDOW, k + 1), 0)
    slow = (values[k, 5] - stream["slow"]).astype(np.float32)
    latent = operator.latent(
        torch.from_numpy(values[index][None]),
        torch.from_numpy(masks[index[1:]][None]),
        torch.from_numpy(slow),
        torch.from_numpy(query[k][None]),
        TIME,
    )
    return latent, operator.heads.from_latent(latent).detach().numpy()


@pytest.mark.parametrize("ticks", [1, 5, 64, 65, 200, 2000])
def test_stream_equals_window(operator, samples, ticks):
    _, stream, _ = streamed(operator, samples, ticks)
    _, base = windowed_base(operator, samples, stream, ticks)
    assert stream["base"] == pytest.approx(base, abs=1e-5)


def test_jacobian_equals_autograd_and_central_differences(operator, samples):
    weights, stream, room = streamed(operator, samples, 100)
    latent, _ = windowed_base(operator, samples, stream, 100)
    base = stream["base"][0]

    def increments(condition: np.ndarray) -> np.ndarray:
        out = np.empty(N_STATES, np.float32)
        heads(weights[0], room[0], base, condition, out)
        return out

    for seed in range(5):
        c = np.random.default_rng(seed).normal(size=N_STATES + N_ZETA).astype(np.float32)
        heads_with_jacobian(weights[0], room[0], base, c)
        jacobian, out = room["jacobian"][0].copy(), room["out"][0].copy()
        plain = torch.func.jacrev(lambda at: operator(latent, at[None], TIME)[0])(torch.from_numpy(c))
        assert jacobian == pytest.approx(plain.detach().numpy(), abs=1e-5)
        assert out == pytest.approx(increments(c), abs=1e-6)
        step = 0.05
        for j in range(len(c)):
            ahead, behind = c.copy(), c.copy()
            ahead[j] += step
            behind[j] -= step
            slope = (increments(ahead) - increments(behind)) / (2 * step)
            assert jacobian[:, j] == pytest.approx(slope, abs=5e-4)


def test_neither_state_nor_health_reaches_the_branch(operator, samples):
    """The latent is the same whatever the condition: it is not an argument."""
    values, masks, query = (torch.from_numpy(s[None, :65]) for s in samples)
    latent = operator.latent(values, masks[:, 1:], torch.zeros(1, 2), query[:, -1], TIME)
    moved = [operator(latent, torch.full((1, 9), value), TIME) for value in (0.0, 1.0)]
    assert not torch.allclose(*moved)


def test_weight_budget(operator):
    assert sum(p.numel() for p in operator.parameters()) == pytest.approx(100_000, rel=0.05)
