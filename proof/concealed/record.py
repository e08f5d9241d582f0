"""From clean readings to what the recorder wrote: jitter, coloured noise, quantisation."""

from __future__ import annotations

import numpy as np
from scipy.signal import lfilter

from twinbench.physics.simulator import Array
from twinbench.proof.concealed.machine import Machine, Noise

JITTER = 0.04
"""sd of the sampling instants around their time stamps, in sample periods."""


def recorded(machine: Machine, channels: tuple[str, ...], clean: Array, rng: np.random.Generator) -> Array:
    """Readings (N, C) of clean series (N, C).

    Args:
        clean: (N, C) in the channels' units, none missing.
        rng: what the errors are drawn from.
    """
    n = len(clean)
    late = JITTER * rng.standard_normal(n)
    measured = clean + late[:, None] * np.gradient(clean, axis=0)
    for c, name in enumerate(channels):
        noise = machine.noise[name]
        if noise.sigma > 0.0:
            measured[:, c] += _errors(noise, n, machine.period_s, rng)
        else:
            measured[:, c] = clean[:, c]  # a command is known exactly
        lsb = machine.lsb[name]
        measured[:, c] = lsb * np.round(measured[:, c] / lsb)
    return measured


def _errors(noise: Noise, n: int, period_s: float, rng: np.random.Generator) -> Array:
    keep = np.exp(-period_s / noise.tau_s)
    drive = np.sqrt(1.0 - keep**2) * rng.standard_normal(n)
    drive[0] = rng.standard_normal()
    coloured = np.asarray(lfilter([1.0], [1.0, -keep], drive))
    return noise.white * rng.standard_normal(n) + noise.coloured * coloured
