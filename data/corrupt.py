"""From clean readings to what the recorder wrote: noise, drift, jitter, spikes, gaps."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.signal import lfilter

from twinbench.common.errors import BadInput
from twinbench.machines.coordinates import Array
from twinbench.machines.machine import Machine
from twinbench.machines.sensors import Noise


@dataclass(frozen=True)
class Corruption:
    """How bad the sensors are. Noise and drift are multiples of the machine's data sheet.

    ``dropout`` and ``spikes`` are shares of all samples; half of the dropped samples come in bursts
    of half a second. ``jitter_s`` is the sd of the sampling instant around its time stamp.
    """

    noise: float = 1.0
    drift: float = 1.0
    dropout: float = 0.005
    spikes: float = 0.002
    jitter_s: float = 0.005

    def __post_init__(self) -> None:
        for name, high in (("noise", 100.0), ("drift", 100.0), ("dropout", 0.99), ("spikes", 1.0), ("jitter_s", 0.025)):
            value = getattr(self, name)
            if not 0.0 <= value <= high:
                raise BadInput(f"corruption: {name} is {value}, must lie in [0, {high}]")


BURST = 10
SPIKE_SIZE = (8.0, 40.0)  # standard deviations of the channel's noise


def corrupt(machine: Machine, u: Array, y: Array, level: Corruption, rng: np.random.Generator) -> Array:
    """Readings (N, nu + ny) of one sequence, NaN where missing.

    Args:
        machine: what it is of.
        u: (N, nu) true inputs in the channels' units.
        y: (N, ny) clean outputs in the channels' units.
        level: how bad the sensors are.
        rng: what the errors are drawn from.
    """
    clean = np.concatenate([u, y], axis=-1)
    n, period_s = len(clean), machine.sample_period_s
    late = level.jitter_s * rng.standard_normal(n) / period_s
    slope = np.gradient(clean, axis=0)
    measured = clean + late[:, None] * slope
    drift = level.drift * machine.drift.share * _ar1(n, machine.drift.tau_s / period_s, rng)
    for c, noise in enumerate(machine.noise):
        assert noise.channel == machine.channels[c]
        size = _size(machine, noise, clean, c) * level.noise
        error = noise.white * rng.standard_normal(n)
        if noise.coloured:
            error += noise.coloured * _ar1(n, noise.tau_s / period_s, rng)
        measured[:, c] += size * error
        if noise.channel in machine.drift.channels:
            measured[:, c] += drift * clean[:, c]
        if noise.white == 0.0:
            measured[:, c] = clean[:, c]  # a command is known exactly
            continue
        spiked = np.flatnonzero(rng.random(n) < level.spikes)
        height = rng.uniform(*SPIKE_SIZE, len(spiked)) * rng.choice([-1.0, 1.0], len(spiked))
        measured[spiked, c] += height * size[spiked] * np.hypot(noise.white, noise.coloured)
    return np.where(_dropped(n, clean.shape[1], level.dropout, rng), np.nan, measured)


def _size(machine: Machine, noise: Noise, clean: Array, c: int) -> Array:
    size = np.abs(clean[:, c]) if noise.relative else np.ones(len(clean))
    if noise.grows is None:
        return size
    return size * noise.grows.factor(clean[:, machine.channels.index(noise.grows.channel)])


def _ar1(n: int, tau: float, rng: np.random.Generator) -> Array:
    """AR(1) of unit variance, stationary from the first sample, (n,); ``tau`` in samples."""
    keep = np.exp(-1.0 / tau)
    drive = np.sqrt(1.0 - keep**2) * rng.standard_normal(n)
    drive[0] = rng.standard_normal()
    return lfilter([1.0], [1.0, -keep], drive)


def _dropped(n: int, channels: int, share: float, rng: np.random.Generator) -> np.ndarray:
    """(n, channels) bool: single samples and bursts, half of the share each."""
    kept = np.sqrt(1.0 - share)  # by each of the two, so that together they drop the share, large ones too
    single = rng.random((n, channels)) < 1.0 - kept
    starts = rng.random((n, channels)) < 1.0 - kept ** (1.0 / BURST)
    burst = np.zeros_like(starts)
    for shift in range(BURST):
        burst[shift:] |= starts[: n - shift]
    return single | burst
