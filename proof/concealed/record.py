"""From clean readings to what the recorder wrote: jitter, coloured noise, quantisation."""

from __future__ import annotations

import numpy as np
from scipy.signal import lfilter

from twinbench.physics.simulator import Array
from twinbench.proof.concealed.integrate import Parameters
from twinbench.proof.concealed.machine import Machine, Noise
from twinbench.proof.concealed.severity import Take, readings

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


def written(machine: Machine, take: Take, p: Array, rng: np.random.Generator) -> tuple[Array, Array]:
    """What the recorder writes while a machine runs from rest under a take's first inputs.

    Args:
        p: (n_parameters,) of the machine, each in its unit.
        rng: what the errors are drawn from.

    Returns:
        Time stamps (N,) in s, and readings (N, C) in the channels' units, inputs before outputs.

    Raises:
        FloatingPointError: the machine diverges.
    """
    rest = machine.settled(take.u, p, take.start_s)
    clean = readings(machine, take, take.u, rest, Parameters.steady(p), machine.fine)
    if not np.isfinite(clean).all():
        raise FloatingPointError(f"machine {machine.name} diverged while {take.name} was recorded")
    channels = (*machine.inputs, *machine.outputs)
    time_s = np.round(take.start_s + np.arange(len(take.u)) * machine.period_s, 6)
    return time_s, recorded(machine, channels, np.concatenate((take.u, clean), axis=1), rng)


def _errors(noise: Noise, n: int, period_s: float, rng: np.random.Generator) -> Array:
    keep = np.exp(-period_s / noise.tau_s)
    drive = np.sqrt(1.0 - keep**2) * rng.standard_normal(n)
    drive[0] = rng.standard_normal()
    coloured = np.asarray(lfilter([1.0], [1.0, -keep], drive))
    return noise.white * rng.standard_normal(n) + noise.coloured * coloured
