"""What the recurrent baselines read: the gated readings, standardised, with their running means.

Running means over half a second to five minutes carry the machine's slow memory (wall and head
metal answer in minutes) to networks that step every two seconds. Fed tick by tick they are the same
numbers as over whole sequences.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.signal import lfilter

from twinbench.data.batch import Array
from twinbench.machines.machine import Machine
from twinbench.methods.frontend import Clean, FrontEnd, Memory

TAUS_S = (0.5, 2.0, 30.0, 300.0)
"""Time constants of the running means."""
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


def keep_of(machine: Machine) -> Array:
    """What of each running mean is kept from tick to tick, (4,) dimensionless, order TAUS_S."""
    return np.exp(-machine.sample_period_s / np.array(TAUS_S))


def width(channels: int) -> int:
    """Features of that many channels."""
    return channels * (1 + len(TAUS_S))


def init(batch: int, channels: int) -> FeatureMemory:
    """Before the first sample."""
    return FeatureMemory(np.zeros((batch, len(TAUS_S), channels)), np.zeros(batch, bool))


def step(memory: FeatureMemory, values: Array, kept: Array) -> tuple[FeatureMemory, Array]:
    """One tick of standardised values (B, C): features (B, 5 C), the values first, then each mean.

    Args:
        memory: of the tick before.
        values: (B, C) standardised.
        kept: (4,) dimensionless, as ``keep_of`` gives it.
    """
    values = np.clip(values, -FEATURE_LIMIT, FEATURE_LIMIT)
    keep = np.where(memory.started[:, None], kept, 0.0)[..., None]
    means = keep * memory.means + (1.0 - keep) * values[:, None]
    flat = np.concatenate([values, means.reshape(len(values), -1)], axis=1)
    return FeatureMemory(means, np.ones_like(memory.started)), flat


def run(values: Array, kept: Array) -> np.ndarray:
    """Features (B, N, 5 C) float32 of whole sequences (B, N, C).

    Args:
        values: (B, N, C) standardised.
        kept: (4,) dimensionless, as ``keep_of`` gives it.
    """
    values = np.clip(values, -FEATURE_LIMIT, FEATURE_LIMIT)
    channels = values.shape[-1]
    out = np.empty((*values.shape[:2], width(channels)), np.float32)
    out[..., :channels] = values
    for i, keep in enumerate(kept):
        at = slice(channels * (i + 1), channels * (i + 2))
        out[..., at], _ = lfilter([1.0 - keep], [1.0, -keep], values, axis=1, zi=keep * values[:, :1])
    return out


def clean_step(front_end: FrontEnd, memory: Memory, measured: Array) -> tuple[Memory, Clean, Array]:
    """One tick through the gate: its memory, what it let through, and the standardised values (B, C).

    Args:
        front_end: fitted.
        memory: its own, of the tick before.
        measured: (B, C) readings in the channels' units, inputs first; NaN means missing.
    """
    memory, clean = front_end.step(memory, measured)
    return memory, clean, front_end.standardise(clean.filled)
