"""Training windows for the operator: gathered from whole sequences, never copied out beforehand."""

from __future__ import annotations

from typing import NamedTuple, Self

import numpy as np
import torch
from scipy.signal import lfilter
from torch import Tensor

from twinbench.data.batch import SAMPLE_PERIOD_S, Array, Batch
from twinbench.methods.frontend import FrontEnd
from twinbench.methods.operator import SLOW_TAU_S, WINDOW


def query_of(filled: Array) -> Array:
    """Query coordinates (..., 5) of measured channels (..., 7): N, pressure ratio, T_suc, p_suc, valve.

    Args:
        filled: (..., 7) values in the channels' units, order CHANNELS.
    """
    p_suc, T_suc, N, valve, p_dis = (filled[..., i] for i in range(5))
    return np.stack([N, p_dis / p_suc, T_suc, p_suc, valve], axis=-1)


class WindowBatch(NamedTuple):
    """What the operator reads, float32.

    Attributes:
        values: (B, window + 1, 7) standardised, order CHANNELS; the first sample only for its difference.
        masks: (B, window, 7) dimensionless, 1 where accepted.
        slow: (B, n_slow) standardised discharge temperature less its running means.
        query: (B, 5) standardised, order N, pressure ratio, T_suc, p_suc, valve.
    """

    values: Tensor
    masks: Tensor
    slow: Tensor
    query: Tensor


class WindowSource:
    """Sequences after the front end, standardised, ready to be cut into windows.

    Attributes:
        query_mean: (5,) means of the query in its units: rpm, 1, K, bar, 1.
        query_scale: (5,) their spreads in the same units.
        window: samples in a window.
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
        self.query = ((query_of(filled) - query_mean) / query_scale).astype(np.float32)
        temperature = self.values[..., 5].astype(np.float64)
        slow = []
        for tau_s in SLOW_TAU_S:
            keep = np.exp(-SAMPLE_PERIOD_S / tau_s)
            mean, _ = lfilter([1 - keep], [1, -keep], temperature, axis=1, zi=keep * temperature[:, :1])
            slow.append(temperature - mean)
        self.slow = np.stack(slow, axis=-1).astype(np.float32)

    @classmethod
    def fit(cls, train: Batch, front_end: FrontEnd, window: int = WINDOW) -> Self:
        """Standardise the query on the training sequences themselves."""
        filled, _, _ = front_end.run(train.measured[:, ::20])
        query = query_of(filled)
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
