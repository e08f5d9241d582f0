"""What every filter is told: the sensors' data sheet at the present readings, and how fast health wanders."""

from __future__ import annotations

import numpy as np

from data.batch import CHANNELS, SAMPLE_PERIOD_S, Array
from physics.health import d_theta_d_zeta
from physics.sensors import INPUT_NOISE, OUTPUT_NOISE, SensorNoise, speed_factor

HEALTH_WALK = np.array([4e-4, 4e-4, 1.2e-4, 2e-3, 0.05])
"""Standard deviation of what health moves by in a second, order HEALTH, before a filter's ``health_walk``."""


def health_walk_var(factor: float) -> Array:
    """Variance (5,) that one tick adds to the coordinates of health, which is a random walk in them."""
    return (factor * HEALTH_WALK / d_theta_d_zeta(np.zeros(len(HEALTH_WALK)))) ** 2 * SAMPLE_PERIOD_S


def _sizes(filled: Array, noises: tuple[SensorNoise, ...]) -> Array:
    """What the relative figures of the data sheet refer to, (B, len(noises))."""
    h = speed_factor(filled[:, CHANNELS.index("N_rpm")])
    columns = []
    for noise in noises:
        reading = np.abs(filled[:, CHANNELS.index(noise.channel)]) if noise.relative else np.ones(len(filled))
        columns.append(reading * h if noise.with_speed else reading)
    return np.stack(columns, axis=-1)


def output_sd(filled: Array) -> tuple[Array, Array]:
    """White and coloured sd (B, 3) of the outputs, from readings (B, 7)."""
    size = _sizes(filled, OUTPUT_NOISE)
    return size * [s.white for s in OUTPUT_NOISE], size * [s.coloured for s in OUTPUT_NOISE]


def input_sd(filled: Array) -> Array:
    """sd (B, 4) of the inputs, from readings (B, 7)."""
    return _sizes(filled, INPUT_NOISE) * [s.white for s in INPUT_NOISE]


def coloured_tau_s() -> Array:
    """Time constants (3,) of the outputs' coloured noise."""
    return np.array([s.tau_s for s in OUTPUT_NOISE])


def coloured_keep() -> Array:
    """AR(1) factors (3,) of the outputs' coloured noise from tick to tick."""
    return np.exp(-SAMPLE_PERIOD_S / coloured_tau_s())
