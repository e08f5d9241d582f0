"""A diagonal state-space memory for the slow-fast network.

Layers as in S5 (Smith et al., 2023): linear recurrences with a diagonal transition, many inputs and outputs, a gate
after each; their step is chosen by the input as in Mamba (Gu and Dao, 2023), so that a layer can hold what it knows or
let go of it at once. Decays are real: nothing in the machine oscillates at the pace of the memory. Being linear in
their states, the layers are trained by a parallel scan; online they are a recurrence.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor, nn
from torch.nn import functional

from twinbench.baselines.recurrent import STEP_S, TwoRates

QUICKEST_TAU_S, SLOWEST_TAU_S = 2.0, 1000.0
"""Time constants that the states of a layer have before training: from a step of the memory to most of a recording."""
FLAT_STEP = math.log(math.e - 1.0)
"""Whose softplus is one: a layer's step before training."""
NORM_EPS = 1e-5
"""Added to variances before a root, as torch does; dimensionless. Nothing depends on it but a constant input."""


def scan(keep: Tensor, drive: Tensor, start: Tensor) -> Tensor:
    """All states (B, S, P) of ``s = keep s + drive`` from ``start`` (B, P), by doubling: log2(S) steps, not S.

    Args:
        keep: (B, S, P) dimensionless.
        drive: (B, S, P) in the states' unit.
        start: (B, P) the state before the first step, in the states' unit.
    """
    shift = 1
    while shift < keep.shape[1]:
        drive = torch.cat([drive[:, :shift], drive[:, shift:] + keep[:, shift:] * drive[:, :-shift]], dim=1)
        keep = torch.cat([keep[:, :shift], keep[:, shift:] * keep[:, :-shift]], dim=1)
        shift *= 2
    return drive + keep * start[:, None]


class Layer(nn.Module):
    """One state-space layer with a gate, added to what comes in."""

    def __init__(self, hidden: int, states: int, step_s: float = STEP_S) -> None:
        super().__init__()
        tau_s = torch.logspace(math.log10(QUICKEST_TAU_S), math.log10(SLOWEST_TAU_S), states)
        self.log_rate = nn.Parameter(torch.log(step_s / tau_s))
        self.pace = nn.Linear(hidden, states)
        nn.init.zeros_(self.pace.weight)
        nn.init.constant_(self.pace.bias, FLAT_STEP)
        self.enter = nn.Linear(hidden, states, bias=False)
        self.leave = nn.Linear(states, hidden, bias=False)
        self.past = nn.Parameter(torch.ones(hidden))
        self.gate = nn.Linear(hidden, hidden)

    def forward(self, value: Tensor, start: Tensor) -> tuple[Tensor, Tensor]:
        """Values (B, S, hidden) after the layer, and its states (B, P) at the end.

        Args:
            value: (B, S, hidden) dimensionless.
            start: (B, P) states before, dimensionless.
        """
        read = functional.layer_norm(value, value.shape[-1:], eps=NORM_EPS)
        keep = torch.exp(-functional.softplus(self.pace(read)) * torch.exp(self.log_rate))
        states = scan(keep, (1.0 - keep) * self.enter(read), start)
        said = functional.silu(self.leave(states) + self.past * read)
        return value + said * torch.sigmoid(self.gate(said)), states[:, -1]


class StateSpace(TwoRates):
    """State-space layers, the last one's values read out at every tick."""

    def __init__(
        self, features: int, widths: tuple[int, int, int], readout: int, outputs: int, step_s: float = STEP_S
    ) -> None:
        """Widths: of the values between layers, of a layer's states, and how many layers; a step lasts ``step_s``."""
        hidden, states, layers = widths
        super().__init__(hidden, features, readout, outputs)
        self.states = states
        self.entry = nn.Linear(features, hidden)
        self.layers = nn.ModuleList(Layer(hidden, states, step_s) for _ in range(layers))

    def blank(self, batch: int) -> tuple[Tensor, ...]:
        """The layers' states before the first step, each (B, P)."""
        return tuple(torch.zeros(batch, self.states) for _ in self.layers)

    def remember(self, slow: Tensor, carried: tuple[Tensor, ...]) -> tuple[Tensor, tuple[Tensor, ...]]:
        """The last layer's values after each step."""
        value, after = self.entry(slow), []
        for layer, start in zip(self.layers, carried, strict=True):
            value, end = layer(value, start)
            after.append(end)
        return value, tuple(after)
