"""The operator network, Eq. (3): a branch over the measurement window, a trunk over the query.

It predicts the increment of the estimated states over the query time from the window, the previous
state and the health coordinates. State and health enter the heads only, never the branch: the
sensitivities of the filter then cost one small pass, and the window cannot stand in for them.
"""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn import functional

from twinbench.machines.compressor import COMPRESSOR
from twinbench.machines.machine import Machine

WINDOW = 64
KERNEL = 4  # samples per column of a block; block 2 reaches KERNEL**2 samples
TOKENS = WINDOW // KERNEL**2
SLOW_TAU_S = (30.0, 300.0)
"""Of the running means that slow channels are held against."""
SINUSOIDS = (1.0, 2.0, 4.0)  # of pi times the query time over two ticks
EMBEDDED = 2
"""Entries of the query that are embedded, the first ones: what says most about the operating point."""


def acting(machine: Machine) -> np.ndarray:
    """Positions among the health parameters of those that act on the machine, as a sensor's bias does not."""
    return np.flatnonzero([not h.on_readings for h in machine.health])


def slow_channels(machine: Machine) -> np.ndarray:
    """Positions of the channels that are held against running means, once for each of SLOW_TAU_S."""
    names = machine.slow or machine.outputs
    return np.repeat([machine.channels.index(name) for name in names], len(SLOW_TAU_S))


def head_of_state(machine: Machine) -> np.ndarray:
    """Which head says how each estimated state moves, (n,): those that are alike share one."""
    group = {name: names[0] for names in machine.alike for name in names}
    heads: dict[str, int] = {}
    return np.array([heads.setdefault(group.get(name, name), len(heads)) for name in machine.estimated])


def time_features(time_s: Tensor, period_s: float) -> Tensor:
    """What the trunk sees of a query time, (B, 1 + 2 * 3).

    Args:
        time_s: (B,) seconds from the window's end to the time asked about.
        period_s: from tick to tick.
    """
    time_s = time_s.unsqueeze(-1)
    phase = time_s * (torch.pi / (2.0 * period_s)) * torch.tensor(SINUSOIDS, dtype=time_s.dtype)
    return torch.cat([time_s / period_s, torch.sin(phase), torch.cos(phase)], dim=-1)


def second_moment_norm(features: Tensor) -> Tensor:
    """Unit second moment over the last axis, so that neither factor dominates the product.

    Args:
        features: (..., n) dimensionless.
    """
    return features * torch.rsqrt(features.square().mean(dim=-1, keepdim=True) + 1e-6)


class Branch(nn.Module):
    """Two dilated causal convolutions and gated attention over the window.

    The convolutions have kernel 4 and dilations 1 and 4. Of a single window only every 4th and
    every 16th column is needed, so there they run strided; on a stream they run dilated, with the
    same weights. The window is a multiple of 16 samples.
    """

    def __init__(
        self, width_1: int, width_2: int, attention: int, latents: int, slow: int, channels: int, window: int = WINDOW
    ) -> None:
        super().__init__()
        self.block_1 = nn.Linear(KERNEL * 3 * channels, width_1)  # values, first differences, masks
        self.block_2 = nn.Linear(KERNEL * width_1, width_2)
        self.mix_2 = nn.Linear(width_2, width_2)
        self.gate_tanh = nn.Linear(width_2, attention)
        self.gate_sigmoid = nn.Linear(width_2, attention)
        self.score = nn.Linear(attention, 1, bias=False)
        self.position = nn.Parameter(torch.zeros(window // KERNEL**2))
        self.project = nn.Linear(2 * width_2 + 2 * channels + slow, latents)

    def forward(self, values: Tensor, masks: Tensor, slow: Tensor) -> Tensor:
        """What the window says, (B, latents).

        Args:
            values: (B, window + 1, C) standardised, inputs first; the first sample only for its difference.
            masks: (B, window, C) dimensionless, 1 where accepted.
            slow: (B, slow) standardised slow channels less their running means.
        """
        batch, length = masks.shape[:2]
        window = values[:, 1:]
        columns = torch.cat([window, values[:, 1:] - values[:, :-1], masks], dim=-1)
        first = functional.silu(self.block_1(columns.reshape(batch, length // KERNEL, -1)))
        second = functional.silu(self.block_2(first.reshape(batch, length // KERNEL**2, -1)))
        tokens = second + functional.silu(self.mix_2(second))
        gated = torch.tanh(self.gate_tanh(tokens)) * torch.sigmoid(self.gate_sigmoid(tokens))
        weights = torch.softmax(self.score(gated).squeeze(-1) + self.position, dim=-1)
        attended = (weights.unsqueeze(-1) * tokens).sum(dim=1)
        mean = window.mean(dim=1)
        spread = torch.sqrt((window - mean.unsqueeze(1)).square().mean(dim=1) + 1e-6)
        summary = torch.cat([attended, tokens[:, -1], mean, spread, slow], dim=-1)
        return second_moment_norm(self.project(summary))


class Trunk(nn.Module):
    """The query: when, and under what inputs."""

    def __init__(self, width: int, embedding: int, latents: int, query: int, period_s: float) -> None:
        super().__init__()
        self.embedding = nn.Linear(min(EMBEDDED, query), embedding)
        self.hidden = nn.Linear(query + embedding + 1 + 2 * len(SINUSOIDS), width)
        self.project = nn.Linear(width, latents)
        self.period_s = period_s

    def forward(self, query: Tensor, time_s: Tensor) -> Tensor:
        """What the query says, (B, latents).

        Args:
            query: (B, q) standardised, in the order of the machine's ``operating``.
            time_s: (B,) seconds from the window's end to the time asked about.
        """
        time = time_features(time_s, self.period_s)
        embedded = functional.silu(self.embedding(query[:, : self.embedding.in_features]))
        return second_moment_norm(
            self.project(functional.silu(self.hidden(torch.cat([query, embedded, time], dim=-1))))
        )


class Heads(nn.Module):
    """Small heads on the latent product, conditioned on the previous state and on zeta. Alike states share one.

    Args:
        latents: how many.
        width: of each head.
        of_state: (n,) dimensionless, which head each state has.
        acting: how many health parameters act on the machine.
    """

    def __init__(self, latents: int, width: int, of_state: np.ndarray, acting: int) -> None:
        super().__init__()
        states, heads = len(of_state), int(of_state.max()) + 1
        self.of_state = of_state.tolist()
        self.from_latent = nn.Linear(latents, heads * width)
        self.from_condition = nn.Linear(states + acting, heads * width, bias=False)
        self.hidden_weight = nn.Parameter(torch.empty(heads, width, width))
        self.hidden_bias = nn.Parameter(torch.zeros(heads, width))
        self.out_weight = nn.Parameter(torch.empty(states, width))
        self.out_bias = nn.Parameter(torch.zeros(states))
        for weight in (self.hidden_weight, self.out_weight):
            nn.init.uniform_(weight, -(width**-0.5), width**-0.5)

    def forward(self, latent: Tensor, condition: Tensor) -> Tensor:
        """Scaled increments (B, n) of one tick.

        Args:
            latent: (B, latents) dimensionless, as ``Operator.latent`` gives it.
            condition: (B, n + acting) dimensionless: the standardised state, and zeta / 4 of what acts.
        """
        first = functional.silu(self.from_latent(latent) + self.from_condition(condition))
        per_head = first.unflatten(-1, (len(self.hidden_bias), -1)).transpose(0, 1)  # (heads, B, width)
        second = functional.silu(torch.baddbmm(self.hidden_bias.unsqueeze(1), per_head, self.hidden_weight))
        of_state = second[self.of_state]  # (n, B, width)
        return (of_state * self.out_weight.unsqueeze(1)).sum(-1).T + self.out_bias


class Operator(nn.Module):
    """Branch, trunk and heads. Outputs are increments in units of their counterfactual spread."""

    def __init__(
        self,
        machine: Machine = COMPRESSOR,
        latents: int = 96,
        width_1: int = 32,
        width_2: int = 64,
        attention: int = 32,
        trunk: int = 96,
        embedding: int = 8,
        head: int = 72,
        window: int = WINDOW,
    ) -> None:
        super().__init__()
        slow, channels = len(slow_channels(machine)), len(machine.channels)
        self.period_s = machine.sample_period_s
        self.branch = Branch(width_1, width_2, attention, latents, slow, channels, window)
        self.trunk = Trunk(trunk, embedding, latents, len(machine.operating), self.period_s)
        self.heads = Heads(latents, head, head_of_state(machine), len(acting(machine)))

    def latent(self, values: Tensor, masks: Tensor, slow: Tensor, query: Tensor, time_s: Tensor) -> Tensor:
        """The latent product of branch and trunk, (B, latents).

        Args:
            values: (B, window + 1, C) standardised, inputs first; the first sample only for its difference.
            masks: (B, window, C) dimensionless, 1 where accepted.
            slow: (B, slow) standardised slow channels less their running means.
            query: (B, q) standardised, in the order of the machine's ``operating``.
            time_s: (B,) seconds from the window's end to the time asked about.
        """
        return self.branch(values, masks, slow) * self.trunk(query, time_s)

    def forward(self, latent: Tensor, condition: Tensor, time_s: Tensor) -> Tensor:
        """Scaled increments (B, n) over ``time_s``.

        Args:
            latent: (B, latents) dimensionless, as ``Operator.latent`` gives it.
            condition: (B, n + acting) dimensionless: the standardised state, and zeta / 4 of what acts.
            time_s: (B,) seconds from the window's end to the time asked about.
        """
        return self.heads(latent, condition) * (time_s / self.period_s).unsqueeze(-1)
