"""What every filter is told: the sensors' data sheet at the present readings, and how fast health wanders."""

from __future__ import annotations

import numpy as np
from numba import njit

from twinbench.data.batch import CHANNELS, SAMPLE_PERIOD_S, Array
from twinbench.physics.health import d_theta_d_zeta
from twinbench.physics.sensors import INPUT_NOISE, OUTPUT_NOISE, PRESSURE_DRIFT_TAU_S, speed_factor

HEALTH_WALK = np.array([4e-4, 4e-4, 1.2e-4, 2e-3, 0.05])
"""Standard deviation of what health moves by in a second, order HEALTH, before a filter's ``health_walk``."""


def health_walk_var(factor: float) -> Array:
    """Variance (5,) that one tick adds to the coordinates of health, which is a random walk in them."""
    return (factor * HEALTH_WALK / d_theta_d_zeta(np.zeros(len(HEALTH_WALK)))) ** 2 * SAMPLE_PERIOD_S


_speed_factor = njit(cache=True)(speed_factor)
_SPEED = CHANNELS.index("N_rpm")
_READ = np.array([CHANNELS.index(s.channel) for s in OUTPUT_NOISE])
_RELATIVE = np.array([s.relative for s in OUTPUT_NOISE])
_WITH_SPEED = np.array([s.with_speed for s in OUTPUT_NOISE])
_WHITE = np.array([s.white for s in OUTPUT_NOISE])
_COLOURED = np.array([s.coloured for s in OUTPUT_NOISE])


@njit(cache=True)
def output_sd_of(filled, white, coloured):  # type: ignore[no-untyped-def]
    """``output_sd`` of one machine: readings (7,), written into ``white`` and ``coloured`` (3,)."""
    for c in range(_WHITE.size):
        size = abs(filled[_READ[c]]) if _RELATIVE[c] else 1.0
        if _WITH_SPEED[c]:
            size *= _speed_factor(filled[_SPEED])
        white[c], coloured[c] = size * _WHITE[c], size * _COLOURED[c]


@njit(cache=True)
def _output_sd(filled, white, coloured):  # type: ignore[no-untyped-def]
    for b in range(filled.shape[0]):
        output_sd_of(filled[b], white[b], coloured[b])


def output_sd(filled: Array) -> tuple[Array, Array]:
    """White and coloured sd (B, 3) of the outputs, from readings (B, 7): what is relative refers to these.

    Args:
        filled: (B, 7) readings in the channels' units, order CHANNELS, gaps filled.
    """
    white, coloured = (np.empty((len(filled), len(OUTPUT_NOISE))) for _ in range(2))
    _output_sd(filled, white, coloured)
    return white, coloured


def input_sd(filled: Array) -> Array:
    """sd (B, 4) of the inputs, from readings (B, 7).

    Args:
        filled: (B, 7) readings in the channels' units, order CHANNELS, gaps filled.
    """
    sizes = [np.abs(filled[:, CHANNELS.index(s.channel)]) if s.relative else np.ones(len(filled)) for s in INPUT_NOISE]
    return np.stack(sizes, axis=-1) * [s.white for s in INPUT_NOISE]


def coloured_tau_s() -> Array:
    """Time constants (3,) of the outputs' coloured noise."""
    return np.array([s.tau_s for s in OUTPUT_NOISE])


def coloured_keep() -> Array:
    """AR(1) factors (3,) of the outputs' coloured noise from tick to tick."""
    return np.exp(-SAMPLE_PERIOD_S / coloured_tau_s())


def drift_keep() -> float:
    """AR(1) factor from tick to tick of the drift that the pressure sensors share."""
    return float(np.exp(-SAMPLE_PERIOD_S / PRESSURE_DRIFT_TAU_S))
