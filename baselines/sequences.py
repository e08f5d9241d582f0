"""Training of a slow-fast network on whole sequences, a stretch at a time, its memory carried over."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from twinbench.baselines.recurrent import TwoRates
from twinbench.methods.training import adamw

SLOW_STEPS = 75
"""Slow steps of back-propagation through time."""
READOUTS = 2
"""Ticks read out, and compared, after every slow step."""
READOUTS_HELD = 8
"""Ticks read out after every slow step of held-out sequences, where the network's error is learnt: more are alike."""

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
    ticks: int,
) -> list[float]:
    """Walk some sequences at a time from beginning to end, stretch after stretch.

    Args:
        network: that learns.
        read: (B, N, F) float32, standardised, what the network reads at each tick.
        target: (B, N, T) float32, standardised, what it is to say at each tick.
        loss: of predictions (..., outputs) and targets (..., T).
        rng: what sequences and ticks are drawn from.
        schedule: how long, and on how much at a time.
        ticks: how many a step of the memory has.
    """
    usable = read.shape[1] // ticks
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
        rows, begun = sequence[:, None], ticks * (at[:, None] + np.arange(steps))
        spread = begun[..., None] + rng.integers(ticks, size=READOUTS)
        predicted, after = network(
            torch.from_numpy(read[rows, begun]),
            torch.from_numpy(read[rows[..., None], spread]),
            tuple(part.detach() * goes_on for part in carried),
        )
        carried = after
        at[:] += steps
        return loss(predicted, torch.from_numpy(target[rows[..., None], spread]))

    return adamw(network, one, schedule.iterations, schedule.learning_rate)


def apart(ticks: int) -> int:
    """How many ticks those of held-out sequences are apart that are read out; a step of the memory is a multiple."""
    return next(every for every in range(max(1, ticks // READOUTS_HELD), 0, -1) if ticks % every == 0)


def read_out(network: TwoRates, read: np.ndarray, ticks: int, every: int) -> tuple[np.ndarray, np.ndarray]:
    """Ticks (M,), ``every`` apart, and what the network says there, (B, M, outputs) float64.

    Args:
        network: that is asked.
        read: (B, N, F) float32, standardised, what the network reads at each tick.
        ticks: how many a step of the memory has.
        every: a divisor of that.
    """
    asked = np.arange(0, read.shape[1] // ticks * ticks, every)
    slow = torch.from_numpy(read[:, : asked[-1] + 1 : ticks])
    fast = torch.from_numpy(read[:, asked]).unflatten(1, (slow.shape[1], -1))
    with torch.no_grad():
        out, _ = network(slow, fast, network.blank(len(read)))
    return asked, out.flatten(1, 2).double().numpy()
