"""Recordings of a motor with something in it that its simulator lacks, written out here on its own."""

from __future__ import annotations

import operator
from collections.abc import Callable, Iterator

import numpy as np
from motor import MOTOR, rhs

from twinbench.data.recording import Recording
from twinbench.physics.simulator import Array

CHANNELS = tuple(v.name for v in (*MOTOR.inputs, *MOTOR.outputs))
NOISE = np.array([1.0, 0.5, 0.5])
TRUE = {"R_ohm": 0.65, "J_kg_m2": 1.35, "b_Nms": 0.06}
Extra = Callable[[float, list[float], list[float]], Array]


def pieces(rng: np.random.Generator, time_s: Array, low: float, high: float, mean_s: float) -> Array:
    """An input that jumps to a new level every few seconds."""
    jumps = np.cumsum(rng.uniform(0.3, 1.7, len(time_s)) * mean_s)
    levels = rng.uniform(low, high, len(time_s))
    return levels[np.searchsorted(jumps, time_s)]


def record(
    name: str,
    seed: int,
    extra: Extra = lambda t, x, u: np.zeros(3),
    sensor: Callable[[Array, Array], Array] = lambda t, y: y,
    reach: float = 1.0,
    seconds: float = 120.0,
    dt_s: float = 0.08,
) -> Recording:
    """One recording: Heun's method at a tenth of the sample period, coloured noise.

    Args:
        extra: ``extra(t, x, u)``, added to the rates of change (3,).
        sensor: what becomes of the clean readings (N, 3).
        reach: how far the inputs go.
    """
    rng = np.random.default_rng(seed)
    time_s = np.arange(0.0, seconds, dt_s)
    u = np.stack([pieces(rng, time_s, -200 * reach, 200 * reach, 8.0), pieces(rng, time_s, -20, 40 * reach, 6.0)], 1)
    theta = [TRUE.get(v.name, v.nominal) for v in MOTOR.parameters]
    inputs, x, y, h = u.tolist(), [0.0, 0.0, 305.0], np.empty((len(time_s), 3)), dt_s / 10

    def rates(t: float, x: list[float], now: list[float]) -> Iterator[float]:
        return map(operator.add, rhs(x, now, theta).tolist(), extra(t, x, now).tolist())

    for k, t in enumerate(time_s.tolist()):  # floats: arrays of three take three times as long
        y[k] = x[1], x[0], x[2]
        for i in range(10):
            first = [*rates(t + i * h, x, inputs[k])]
            ahead = [a + h * da for a, da in zip(x, first, strict=True)]
            second = rates(t + i * h + h, ahead, inputs[k])
            x = [a + 0.5 * h * (da + db) for a, da, db in zip(x, first, second, strict=True)]
    noise = rng.normal(size=y.shape)
    for k in range(1, len(noise)):
        noise[k] = 0.6 * noise[k - 1] + 0.8 * noise[k]
    return Recording(name, time_s, CHANNELS, np.concatenate((u, sensor(time_s, y) + NOISE * noise), axis=1))
