"""Training windows for the operator: gathered from whole sequences, never copied out beforehand."""

from __future__ import annotations

from typing import NamedTuple, Self

import numpy as np
import torch
from scipy.signal import lfilter
from torch import Tensor

from twinbench.data.batch import Array, Batch
from twinbench.machines.machine import Machine
from twinbench.methods.frontend import FrontEnd
from twinbench.methods.operator import SLOW_TAU_S, WINDOW, slow_channels


def query_of(machine: Machine, filled: Array) -> Array:
    """Query coordinates (..., q) of measured channels (..., C), in the order of the machine's ``operating``.

    Args:
        machine: whose channels.
        filled: (..., C) values in the channels' units, inputs first.
    """
    return np.stack([machine.along(expression, filled) for expression in machine.operating], axis=-1)


class WindowBatch(NamedTuple):
    """What the operator reads, float32.

    Attributes:
        values: (B, window + 1, C) standardised, inputs first; the first sample only for its difference.
        masks: (B, window, C) dimensionless, 1 where accepted.
        slow: (B, slow) standardised slow channels less their running means.
        query: (B, q) standardised, in the order of the machine's ``operating``.
    """

    values: Tensor
    masks: Tensor
    slow: Tensor
    query: Tensor


class WindowSource:
    """Sequences after the front end, standardised, ready to be cut into windows.

    Attributes:
        query_mean: (q,) means of the query in its units.
        query_scale: (q,) their spreads in the same units.
        window: samples in a window.
        machine: what they are of.
    """

    def __init__(
        self, batch: Batch, front_end: FrontEnd, query_mean: Array, query_scale: Array, window: int = WINDOW
    ) -> None:
        self.window = window
        self.front_end = front_end
        filled, accepted, _ = front_end.run(batch.measured, hindsight=True)
        self.values = front_end.standardise(filled).astype(np.float32)
        self.masks = accepted
        self.query_mean, self.query_scale = query_mean, query_scale
        self.machine = machine = batch.machine
        self.query = ((query_of(machine, filled) - query_mean) / query_scale).astype(np.float32)
        slow = []
        for k, channel in enumerate(slow_channels(machine)):
            reading = self.values[..., channel].astype(np.float64)
            keep = np.exp(-machine.sample_period_s / SLOW_TAU_S[k % len(SLOW_TAU_S)])
            mean, _ = lfilter([1 - keep], [1, -keep], reading, axis=1, zi=keep * reading[:, :1])
            slow.append(reading - mean)
        self.slow = np.stack(slow, axis=-1).astype(np.float32)

    @classmethod
    def fit(cls, train: Batch, front_end: FrontEnd, window: int = WINDOW) -> Self:
        """Standardise the query on the training sequences themselves."""
        filled, _, _ = front_end.run(train.measured[:, ::20])
        query = query_of(train.machine, filled)
        return cls(train, front_end, query.mean(axis=(0, 1)), query.std(axis=(0, 1)), window)

    def at(self, sequence: np.ndarray, sample: np.ndarray) -> WindowBatch:
        """Windows that end at the given samples, the sample itself included.

        Args:
            sequence: (M,) integers, positions in the batch.
            sample: (M,) integers, positions in the sequence.
        """
        rows = sequence[:, None]
        ticks = sample[:, None] + np.arange(-self.window, 1)
        return WindowBatch(
            torch.from_numpy(self.values[rows, ticks]),
            torch.from_numpy(self.masks[rows, ticks[:, 1:]].astype(np.float32)),
            torch.from_numpy(self.slow[sequence, sample]),
            torch.from_numpy(self.query[sequence, sample]),
        )
