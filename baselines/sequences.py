"""Training of a slow-fast network on whole sequences, a stretch at a time, its memory carried over."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from twinbench.baselines.recurrent import TICKS_PER_STEP, TwoRates
from twinbench.methods.training import adamw

SLOW_STEPS = 75
"""Slow steps of back-propagation through time."""
READOUTS = 2
"""Ticks read out, and compared, after every slow step."""

Loss = Callable[[Tensor, Tensor], Tensor]


class Schedule(NamedTuple):
    """How long a network is trained, on how many sequences at a time, and how fast."""

    iterations: int
    batch: int
    learning_rate: float


def fit_sequences(
    network: TwoRates,
    read: np.ndarray,
    target: np.ndarray,
    loss: Loss,
    rng: np.random.Generator,
    schedule: Schedule,
) -> list[float]:
    """Walk some sequences at a time from beginning to end, stretch after stretch.

    Args:
        read: (B, N, F) float32, standardised, what the network reads at each tick.
        target: (B, N, T) float32, standardised, what it is to say at each tick.
        loss: of predictions (..., outputs) and targets (..., T).
    """
    usable = read.shape[1] // TICKS_PER_STEP
    steps, batch = min(SLOW_STEPS, usable), schedule.batch
    sequence = rng.integers(len(read), size=batch)
    at = steps * rng.integers(usable // steps, size=batch)
    carried = network.blank(batch)

    def one(_: int) -> Tensor:
        nonlocal carried
        over = at + steps > usable
        sequence[over] = rng.integers(len(read), size=over.sum())
        at[over] = 0
        goes_on = torch.from_numpy(~over).to(torch.float32)[:, None]
        rows, ticks = sequence[:, None], TICKS_PER_STEP * (at[:, None] + np.arange(steps))
        spread = ticks[..., None] + rng.integers(TICKS_PER_STEP, size=READOUTS)
        predicted, after = network(
            torch.from_numpy(read[rows, ticks]),
            torch.from_numpy(read[rows[..., None], spread]),
            tuple(part.detach() * goes_on for part in carried),
        )
        carried = after
        at[:] += steps
        return loss(predicted, torch.from_numpy(target[rows[..., None], spread]))

    return adamw(network, one, schedule.iterations, schedule.learning_rate)


def read_out(network: TwoRates, read: np.ndarray, every: int) -> tuple[np.ndarray, np.ndarray]:
    """Ticks (M,), ``every`` apart, and what the network says there, (B, M, outputs) float64.

    Args:
        read: (B, N, F) float32, standardised, what the network reads at each tick.
    """
    ticks = np.arange(0, read.shape[1] // TICKS_PER_STEP * TICKS_PER_STEP, every)
    slow = torch.from_numpy(read[:, : ticks[-1] + 1 : TICKS_PER_STEP])
    fast = torch.from_numpy(read[:, ticks]).unflatten(1, (slow.shape[1], -1))
    with torch.no_grad():
        out, _ = network(slow, fast, network.blank(len(read)))
    return ticks, out.flatten(1, 2).double().numpy()
