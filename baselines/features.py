"""What the recurrent baselines read: the gated readings, standardised, with their running means.

Running means over half a second to five minutes carry the machine's slow memory (wall and head
metal answer in minutes) to networks that step once a second. Fed tick by tick they are the same
numbers as over whole sequences.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.signal import lfilter

from twinbench.data.batch import SAMPLE_PERIOD_S, Array
from twinbench.methods.frontend import Clean, FrontEnd, Memory

TAUS_S = (0.5, 2.0, 30.0, 300.0)
"""Time constants of the running means."""
SLOW_KEEP = np.exp(-SAMPLE_PERIOD_S / np.array(TAUS_S))
FEATURE_LIMIT = 8.0
"""Standardised values are held within this many spreads of the training mean."""


class FeatureMemory(NamedTuple):
    """What is carried from tick to tick, B machines of C channels.

    Attributes:
        means: (B, 4, C) standardised running means, order TAUS_S.
        started: (B,) bool, has it seen a sample?
    """

    means: Array
    started: np.ndarray


def width(channels: int) -> int:
    """Features of that many channels."""
    return channels * (1 + len(TAUS_S))


def init(batch: int, channels: int) -> FeatureMemory:
    """Before the first sample."""
    return FeatureMemory(np.zeros((batch, len(TAUS_S), channels)), np.zeros(batch, bool))


def step(memory: FeatureMemory, values: Array) -> tuple[FeatureMemory, Array]:
    """One tick of standardised values (B, C): features (B, 5 C), the values first, then each mean.

    Args:
        values: (B, C) standardised.
    """
    values = np.clip(values, -FEATURE_LIMIT, FEATURE_LIMIT)
    keep = np.where(memory.started[:, None], SLOW_KEEP, 0.0)[..., None]
    means = keep * memory.means + (1.0 - keep) * values[:, None]
    flat = np.concatenate([values, means.reshape(len(values), -1)], axis=1)
    return FeatureMemory(means, np.ones_like(memory.started)), flat


def run(values: Array) -> np.ndarray:
    """Features (B, N, 5 C) float32 of whole sequences (B, N, C).

    Args:
        values: (B, N, C) standardised.
    """
    values = np.clip(values, -FEATURE_LIMIT, FEATURE_LIMIT)
    channels = values.shape[-1]
    out = np.empty((*values.shape[:2], width(channels)), np.float32)
    out[..., :channels] = values
    for i, keep in enumerate(SLOW_KEEP):
        at = slice(channels * (i + 1), channels * (i + 2))
        out[..., at], _ = lfilter([1.0 - keep], [1.0, -keep], values, axis=1, zi=keep * values[:, :1])
    return out


def clean_step(front_end: FrontEnd, memory: Memory, measured: Array) -> tuple[Memory, Clean, Array]:
    """One tick through the gate: its memory, what it let through, and the standardised values (B, 7).

    Args:
        measured: (B, 7) readings in the channels' units, order CHANNELS; NaN means missing.
    """
    memory, clean = front_end.step(memory, measured)
    return memory, clean, front_end.standardise(clean.filled)
