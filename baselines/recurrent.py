"""A slow recurrent memory with a fast readout, and its NumPy twin for the online cycle.

The cell steps every other second on the features of that tick (at every tick of a machine that is read more slowly);
a small network reads its hidden state and the present features at every tick. Health and thermal memory move in tens of
seconds, so nothing is lost, and a sequence of 30,000 samples at 20 Hz is 750 steps of back-propagation.
"""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn import functional

from twinbench.machines.machine import Machine

STEP_S = 2.0
"""From step to step of the memory. Half of it doubles the training's time and was not found to tell more."""


def ticks_per_step(machine: Machine) -> int:
    """How many ticks a step of the memory has, one at least."""
    return max(1, round(STEP_S / machine.sample_period_s))


class TwoRates(nn.Module):
    """Base of the networks: a subclass remembers, in ``blank`` and ``remember``; the readout is at every tick."""

    def __init__(self, hidden: int, features: int, readout: int, outputs: int) -> None:
        super().__init__()
        self.first = nn.Linear(hidden + features, readout)
        self.second = nn.Linear(readout, outputs)

    def blank(self, batch: int) -> tuple[Tensor, ...]:
        """The memory before the first step."""
        raise NotImplementedError

    def remember(self, slow: Tensor, carried: tuple[Tensor, ...]) -> tuple[Tensor, tuple[Tensor, ...]]:
        """What is read out after each of S slow steps, (B, S, hidden), and what is carried on.

        Args:
            slow: (B, S, F) standardised features at the steps.
            carried: one per part of the memory, (.., B, ..) dimensionless, as ``blank`` gives them.
        """
        raise NotImplementedError

    def forward(self, slow: Tensor, fast: Tensor, carried: tuple[Tensor, ...]) -> tuple[Tensor, tuple[Tensor, ...]]:
        """Readouts (B, S, K, outputs), the K of a step following it, and what is carried on.

        Args:
            slow: (B, S, F) standardised features at the S steps of the memory.
            fast: (B, S, K, F) standardised features at the K ticks that are read out after each.
            carried: one per part of the memory, dimensionless, as ``blank`` gives them.
        """
        hidden, after = self.remember(slow, carried)
        rows = hidden.unsqueeze(2).expand(-1, -1, fast.shape[2], -1)
        entry = functional.silu(self.first(torch.cat([rows, fast], dim=-1)))
        return self.second(entry), after


class SlowFast(TwoRates):
    """GRU or LSTM cell, its hidden state read out at every tick."""

    def __init__(self, cell: str, features: int, hidden: int, readout: int, outputs: int) -> None:
        super().__init__(hidden, features, readout, outputs)
        self.gated = cell == "gru"
        self.cell = (nn.GRU if self.gated else nn.LSTM)(features, hidden, batch_first=True)

    def blank(self, batch: int) -> tuple[Tensor, ...]:
        """The memory before the first step: hidden, and for the LSTM cell state, each (1, B, hidden)."""
        return tuple(torch.zeros(1, batch, self.cell.hidden_size) for _ in range(1 if self.gated else 2))

    def remember(self, slow: Tensor, carried: tuple[Tensor, ...]) -> tuple[Tensor, tuple[Tensor, ...]]:
        """The hidden state after each step."""
        hidden, after = self.cell(slow, carried[0] if self.gated else carried)
        return hidden, (after,) if self.gated else after


class ReadoutTwin:
    """The readout in NumPy, float32, one tick at a time; a subclass remembers in ``init`` and ``step``.

    Args:
        arrays: by name, weights of any shape, dimensionless; what does not start with ``prefix`` is left out.
        prefix: of the names.
    """

    def __init__(self, arrays: dict[str, np.ndarray], prefix: str = "net.") -> None:
        w = {n.removeprefix(prefix): np.asarray(a, np.float32) for n, a in arrays.items() if n.startswith(prefix)}
        self.first, self.first_bias = w["first.weight"].T.copy(), w["first.bias"]
        self.second, self.second_bias = w["second.weight"].T.copy(), w["second.bias"]
        self.weights = w

    def init(self, batch: int) -> tuple[np.ndarray, np.ndarray]:
        """The memory before the first step: what is read out (B, hidden), and the rest (B, ..)."""
        raise NotImplementedError

    def step(self, h: np.ndarray, c: np.ndarray, features: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """One slow step.

        Args:
            h: (B, hidden) dimensionless, what is read out.
            c: (B, ...) dimensionless, the rest of the memory.
            features: (B, F) standardised.
        """
        raise NotImplementedError

    def read(self, h: np.ndarray, features: np.ndarray) -> np.ndarray:
        """The readout, (B, outputs) float64.

        Args:
            h: (B, hidden) dimensionless hidden state.
            features: (B, F) standardised.
        """
        entry = np.concatenate([h, features], axis=1) @ self.first + self.first_bias
        return ((entry * _sigmoid(entry)) @ self.second + self.second_bias).astype(np.float64)


class SlowFastTwin(ReadoutTwin):
    """The GRU or LSTM in NumPy.

    Args:
        arrays: by name, weights of any shape, dimensionless; what does not start with ``prefix`` is left out.
        prefix: of the names.
    """

    def __init__(self, arrays: dict[str, np.ndarray], prefix: str = "net.") -> None:
        super().__init__(arrays, prefix)
        w = self.weights
        self.inner, self.outer = w["cell.weight_ih_l0"].T.copy(), w["cell.weight_hh_l0"].T.copy()
        self.inner_bias, self.outer_bias = w["cell.bias_ih_l0"], w["cell.bias_hh_l0"]
        self.hidden = self.outer.shape[0]
        self.gates = self.outer.shape[1] // self.hidden  # 3: GRU, 4: LSTM

    def init(self, batch: int) -> tuple[np.ndarray, np.ndarray]:
        """Hidden and cell state (the GRU leaves the second alone), each (B, hidden)."""
        return np.zeros((batch, self.hidden), np.float32), np.zeros((batch, self.hidden), np.float32)

    def step(self, h: np.ndarray, c: np.ndarray, features: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """One slow step.

        Args:
            h: (B, hidden) dimensionless hidden state.
            c: (B, hidden) dimensionless cell state.
            features: (B, F) standardised.
        """
        a = features @ self.inner + self.inner_bias
        b = h @ self.outer + self.outer_bias
        n = self.hidden
        if self.gates == 3:
            reset, update = _sigmoid(a[:, :n] + b[:, :n]), _sigmoid(a[:, n : 2 * n] + b[:, n : 2 * n])
            candidate = np.tanh(a[:, 2 * n :] + reset * b[:, 2 * n :])
            return (1 - update) * candidate + update * h, c
        s = a + b
        enter, forget, out = _sigmoid(s[:, :n]), _sigmoid(s[:, n : 2 * n]), _sigmoid(s[:, 3 * n :])
        c = forget * c + enter * np.tanh(s[:, 2 * n : 3 * n])
        return out * np.tanh(c), c


def _sigmoid(v: np.ndarray) -> np.ndarray:
    return 0.5 * (1.0 + np.tanh(0.5 * v))
