"""The operator network, Eq. (3): a branch over the measurement window, a trunk over the query.

It predicts the increment of the five states over the query time from the window, the previous
state and the health coordinates. State and health enter the heads only, never the branch: the
sensitivities of the filter then cost one small pass, and the window cannot stand in for them.
"""

from __future__ import annotations

import torch
from torch import Tensor, nn
from torch.nn import functional

from twinbench.data.batch import CHANNELS, SAMPLE_PERIOD_S

WINDOW = 64
KERNEL = 4  # samples per column of a block; block 2 reaches KERNEL**2 samples
TOKENS = WINDOW // KERNEL**2
N_CHANNELS = len(CHANNELS)
COLUMNS = 3  # of a channel: values, first differences, masks
N_COLUMNS = COLUMNS * N_CHANNELS
N_SLOW = 2  # discharge temperature against its 30 s and 300 s running means
SLOW_TAU_S = (30.0, 300.0)
N_QUERY = 5  # N_rpm, pressure ratio, T_suc, p_suc, valve
SINUSOIDS = (1.0, 2.0, 4.0)  # of pi times the query time over 0.1 s
N_STATES = 5
N_ZETA = 4  # the sensor's bias does not act on the machine
HEAD_OF_STATE = (0, 0, 1, 2, 3)  # pressures, gas temperature, wall temperature, flow memory
N_HEADS = 4


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
        self,
        width_1: int,
        width_2: int,
        attention: int,
        latents: int,
        n_slow: int = N_SLOW,
        window: int = WINDOW,
        channels: int = N_CHANNELS,
    ) -> None:
        super().__init__()
        self.block_1 = nn.Linear(KERNEL * COLUMNS * channels, width_1)
        self.block_2 = nn.Linear(KERNEL * width_1, width_2)
        self.mix_2 = nn.Linear(width_2, width_2)
        self.gate_tanh = nn.Linear(width_2, attention)
        self.gate_sigmoid = nn.Linear(width_2, attention)
        self.score = nn.Linear(attention, 1, bias=False)
        self.position = nn.Parameter(torch.zeros(window // KERNEL**2))
        self.project = nn.Linear(2 * width_2 + 2 * channels + n_slow, latents)

    def forward(self, values: Tensor, masks: Tensor, slow: Tensor) -> Tensor:
        """What the window says, (B, latents).

        Args:
            values: (B, window + 1, 7) standardised, order CHANNELS; the first sample only for its difference.
            masks: (B, window, 7) dimensionless, 1 where accepted.
            slow: (B, n_slow) standardised discharge temperature less its running means.
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

    def __init__(self, width: int, embedding: int, latents: int) -> None:
        super().__init__()
        self.embedding = nn.Linear(2, embedding)  # of speed and pressure ratio
        self.hidden = nn.Linear(N_QUERY + embedding + 1 + 2 * len(SINUSOIDS), width)
        self.project = nn.Linear(width, latents)

    def forward(self, query: Tensor, time_s: Tensor) -> Tensor:
        """What the query says, (B, latents).

        Args:
            query: (B, 5) standardised, order N, pressure ratio, T_suc, p_suc, valve.
            time_s: (B,) seconds from the window's end to the time asked about.
        """
        phase = time_s.unsqueeze(-1) * (torch.pi / 0.1) * torch.tensor(SINUSOIDS, dtype=query.dtype)
        time = torch.cat([time_s.unsqueeze(-1) / SAMPLE_PERIOD_S, torch.sin(phase), torch.cos(phase)], dim=-1)
        embedded = functional.silu(self.embedding(query[:, :2]))
        return second_moment_norm(
            self.project(functional.silu(self.hidden(torch.cat([query, embedded, time], dim=-1))))
        )


class Heads(nn.Module):
    """Four small heads on the latent product, conditioned on the previous state and on zeta."""

    def __init__(self, latents: int, width: int) -> None:
        super().__init__()
        self.from_latent = nn.Linear(latents, N_HEADS * width)
        self.from_condition = nn.Linear(N_STATES + N_ZETA, N_HEADS * width, bias=False)
        self.hidden_weight = nn.Parameter(torch.empty(N_HEADS, width, width))
        self.hidden_bias = nn.Parameter(torch.zeros(N_HEADS, width))
        self.out_weight = nn.Parameter(torch.empty(N_STATES, width))
        self.out_bias = nn.Parameter(torch.zeros(N_STATES))
        for weight in (self.hidden_weight, self.out_weight):
            nn.init.uniform_(weight, -(width**-0.5), width**-0.5)

    def forward(self, latent: Tensor, condition: Tensor) -> Tensor:
        """Scaled increments (B, 5) of one tick, order STATES.

        Args:
            latent: (B, latents) dimensionless, as ``Operator.latent`` gives it.
            condition: (B, 9) dimensionless: the standardised state, and zeta / 4.
        """
        first = functional.silu(self.from_latent(latent) + self.from_condition(condition))
        per_head = first.unflatten(-1, (N_HEADS, -1)).transpose(0, 1)  # (heads, B, width)
        second = functional.silu(torch.baddbmm(self.hidden_bias.unsqueeze(1), per_head, self.hidden_weight))
        of_state = second[list(HEAD_OF_STATE)]  # (5, B, width)
        return (of_state * self.out_weight.unsqueeze(1)).sum(-1).T + self.out_bias


class Operator(nn.Module):
    """Branch, trunk and heads. Outputs are increments in units of their counterfactual spread."""

    def __init__(
        self,
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
        self.branch = Branch(width_1, width_2, attention, latents, window=window)
        self.trunk = Trunk(trunk, embedding, latents)
        self.heads = Heads(latents, head)

    def latent(self, values: Tensor, masks: Tensor, slow: Tensor, query: Tensor, time_s: Tensor) -> Tensor:
        """The latent product of branch and trunk, (B, latents).

        Args:
            values: (B, window + 1, 7) standardised, order CHANNELS; the first sample only for its difference.
            masks: (B, window, 7) dimensionless, 1 where accepted.
            slow: (B, n_slow) standardised discharge temperature less its running means.
            query: (B, 5) standardised, order N, pressure ratio, T_suc, p_suc, valve.
            time_s: (B,) seconds from the window's end to the time asked about.
        """
        return self.branch(values, masks, slow) * self.trunk(query, time_s)

    def forward(self, latent: Tensor, condition: Tensor, time_s: Tensor) -> Tensor:
        """Scaled increments (B, 5) over ``time_s``.

        Args:
            latent: (B, latents) dimensionless, as ``Operator.latent`` gives it.
            condition: (B, 9) dimensionless: the standardised state, and zeta / 4.
            time_s: (B,) seconds from the window's end to the time asked about.
        """
        return self.heads(latent, condition) * (time_s / SAMPLE_PERIOD_S).unsqueeze(-1)
