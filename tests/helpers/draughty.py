"""An oven through which a draught goes that its simulator lacks, stronger from some time on; all of it is linear."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from helpers.oven import OVEN
from twinbench.data.recording import Recording
from twinbench.physics.simulator import Array, Term, Variable

PERIOD_S, NOISE_C, TAU_S = 0.5, 0.3, 20.0
KNOWN = replace(OVEN, calibrate=())
"""The oven with nothing to calibrate."""


def draught(x: Array, u: Array, theta: Array) -> float:
    return -theta[-1]  # type: ignore[no-any-return]


DRAUGHT = Term(
    "draught",
    "a draught cools it",
    "balance:T_C",
    (Variable("draught_K_s", "K/s", 0.0, 10.0, 1.0, 1.0, "cooling"),),
    term=draught,
)


def record(name: str, seed: int, cooling: Callable[[float], float], begin_s: float, samples: int = 360) -> Recording:
    """A recording by fine Euler steps; ``cooling`` is told the time on the recordings' clock."""
    rng = np.random.default_rng(seed)
    heater = np.repeat(rng.uniform(60.0, 300.0, samples // 30), 30)
    time_s, parts = begin_s + PERIOD_S * np.arange(samples), 20
    x, readings = 150.0, np.empty(samples)
    for k in range(samples):
        readings[k] = x
        for i in range(parts):
            t = time_s[k] + PERIOD_S * i / parts
            x += PERIOD_S / parts * ((heater[k] - x) / TAU_S - cooling(t))
    values = np.stack([heater, readings + rng.normal(0.0, NOISE_C, samples)], axis=-1)
    return Recording(name, time_s, ("heater_C", "probe_C"), values)
