"""From clean readings to what the recorder wrote: noise, drift, jitter, spikes, gaps."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.signal import lfilter

from twinbench.common.errors import BadInput
from twinbench.data.batch import CHANNELS, INPUTS, OUTPUTS, SAMPLE_PERIOD_S, Array
from twinbench.physics.sensors import (
    INPUT_NOISE,
    OUTPUT_NOISE,
    PRESSURE_DRIFT_SHARE,
    PRESSURE_DRIFT_TAU_S,
    SensorNoise,
    speed_factor,
)


@dataclass(frozen=True)
class Corruption:
    """How bad the sensors are. Noise and drift are multiples of the data sheet in ``physics.sensors``.

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


def corrupt(u: Array, y: Array, level: Corruption, rng: np.random.Generator) -> Array:
    """Readings (N, 7) of one sequence, order CHANNELS, NaN where missing.

    Args:
        u: (N, 4) true inputs in the channels' units, order INPUTS.
        y: (N, 3) clean outputs in the channels' units, order OUTPUTS.
        level: how bad the sensors are.
        rng: what the errors are drawn from.
    """
    clean = np.concatenate([u, y], axis=-1)
    n = len(clean)
    h = speed_factor(u[:, INPUTS.index("N_rpm")])
    late = level.jitter_s * rng.standard_normal(n) / SAMPLE_PERIOD_S
    slope = np.gradient(clean, axis=0)
    measured = clean + late[:, None] * slope
    drift = level.drift * PRESSURE_DRIFT_SHARE * _ar1(n, PRESSURE_DRIFT_TAU_S, rng)
    for c, noise in enumerate(INPUT_NOISE + OUTPUT_NOISE):
        assert noise.channel == CHANNELS[c]
        size = _size(noise, clean[:, c], h) * level.noise
        error = noise.white * rng.standard_normal(n)
        if noise.coloured:
            error += noise.coloured * _ar1(n, noise.tau_s, rng)
        measured[:, c] += size * error
        if noise.channel in ("p_suc_bar", "p_dis_bar"):
            measured[:, c] += drift * clean[:, c]
        if noise.white == 0.0:
            measured[:, c] = clean[:, c]  # a command is known exactly
            continue
        spiked = np.flatnonzero(rng.random(n) < level.spikes)
        height = rng.uniform(*SPIKE_SIZE, len(spiked)) * rng.choice([-1.0, 1.0], len(spiked))
        measured[spiked, c] += height * size[spiked] * np.hypot(noise.white, noise.coloured)
    return np.where(_dropped(n, level.dropout, rng), np.nan, measured)


def _size(noise: SensorNoise, clean: Array, h: Array) -> Array:
    size = np.abs(clean) if noise.relative else np.ones(len(clean))
    return size * h if noise.with_speed else size


def _ar1(n: int, tau_s: float, rng: np.random.Generator) -> Array:
    """AR(1) of unit variance, stationary from the first sample, (n,)."""
    keep = np.exp(-SAMPLE_PERIOD_S / tau_s)
    drive = np.sqrt(1.0 - keep**2) * rng.standard_normal(n)
    drive[0] = rng.standard_normal()
    return lfilter([1.0], [1.0, -keep], drive)


def _dropped(n: int, share: float, rng: np.random.Generator) -> np.ndarray:
    """(n, 7) bool: single samples and bursts, half of the share each."""
    channels = len(INPUTS) + len(OUTPUTS)
    kept = np.sqrt(1.0 - share)  # by each of the two, so that together they drop the share, large ones too
    single = rng.random((n, channels)) < 1.0 - kept
    starts = rng.random((n, channels)) < 1.0 - kept ** (1.0 / BURST)
    burst = np.zeros_like(starts)
    for shift in range(BURST):
        burst[shift:] |= starts[: n - shift]
    return single | burst
