"""The concealed tanks: two in series with what ``examples/two_tanks.py`` leaves out."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from twinbench.physics.simulator import Array
from twinbench.proof.concealed.integrate import LAW
from twinbench.proof.concealed.machine import Effect, Machine, Noise, clock, levels

_NAMES = (
    "pump_cm3_s_V", "hole1_cm2", "hole2_cm2",
    "ripple", "ripple_phase", "ambient", "ambient_phase", "exponent",
    "crack1", "crack2", "seep1", "seep2", "gush1", "brim1", "brim2", "feed1", "feed2", "wave1", "wave2", "gap", "play",
    "vortex", "clogging",
)  # fmt: skip


@njit(LAW, cache=True, error_model="numpy")
def law(t, x, u, p, dx):  # type: ignore[no-untyped-def]
    """States: two levels, pump drive, pipe between the tanks, both levels as sensed, dirt in the outlet."""
    h1, h2 = max(x[0], 0.0), max(x[1], 0.0)
    n = p[7]
    V = u[0]
    if p[19] > 0.0:
        V -= p[19] * math.tanh(u[0] / p[19])
    if p[20] > 0.0:
        V = x[2]
    drift = 1.0 + p[5] * math.sin(2.0 * math.pi * t / 5000.0 + p[6])
    pumped = p[0] * V * drift * (1.0 + p[3] * math.sin(1.7 * V + p[4]) * math.cos(0.21 * h1))
    hole = p[1] * (1.0 - p[21] * math.exp(-h1 / 6.0))
    between = hole * math.sqrt(2.0 * 981.0 * h1)
    out = p[2] * (1.0 - p[22] * x[6]) * math.sqrt(2.0 * 981.0 * h2)

    lost1 = p[8] * h1 ** (0.25 * n) + p[10] * h1 ** (0.5 * n) * 20.0 ** (1.0 - 0.5 * n)
    lost1 += p[12] * h1**n * 20.0 ** (2.0 - n)
    lost1 += p[13] * 0.5 * math.log1p(math.exp(min((h1 - 18.0) / 0.5, 60.0)))
    lost2 = p[9] * max(h2 - 8.0, 0.0) ** (0.25 * n) + p[11] * h2 ** (0.5 * n) * 20.0 ** (1.0 - 0.5 * n)
    lost2 += p[14] * 0.5 * math.log1p(math.exp(min((h2 - 18.0) / 0.5, 60.0)))
    dx[0] = (pumped - x[3]) / 154.0 - lost1 + p[15] + p[17] * math.sin(2.0 * math.pi * t / 130.0 + 0.4)
    dx[1] = (x[3] - out) / 154.0 - lost2 + p[16] + p[18] * math.sin(2.0 * math.pi * t / 130.0 + 0.4)
    behind = u[0] - x[2]
    dx[2] = (max(behind - 0.5 * p[20], 0.0) + min(behind + 0.5 * p[20], 0.0)) / 0.1
    dx[3] = (between - x[3]) / 0.1
    dx[4] = (x[0] - x[4]) / 0.1
    dx[5] = (x[1] - x[5]) / 0.1
    dx[6] = (h2 / 20.0 - x[6]) / 400.0
    return 0.0


@njit(LAW, cache=True, error_model="numpy")
def reading(t, x, u, p, y):  # type: ignore[no-untyped-def]
    """level1_cm, level2_cm."""
    y[0], y[1] = x[4], x[5]
    return 0.0


def operate(rng: np.random.Generator, seconds: float, regime: str) -> Array:
    """Inputs (N, 1): the pump's voltage in held pieces."""
    limits = {"train": (2.0, 6.2), "held": (3.5, 6.8), "poor": (4.8, 4.81)}[regime]
    t = clock(seconds, 0.5)
    return levels(rng, t, limits, (10.0, 200.0), (1.0, 15.0))[:, None]


def start(u: Array, p: Array) -> Array:
    """A guess of the state under input u (1,).

    Args:
        u: (1,) inputs in their units.
        p: (n_parameters,) the law's own, each in its unit.
    """
    flow = p[0] * u[0]
    h1, h2 = ((flow / hole) ** 2 / (2.0 * 981.0) for hole in (p[1], p[2]))
    return np.array([h1, h2, u[0], flow, h1, h2, h2 / 20.0])


def _on(
    state: str, effect: str, slot: str, typical: float, most: float, *ports: str, also: tuple[str, ...] = ()
) -> Effect:
    return Effect(f"{effect}@{state}", slot, typical, most, (f"{effect}@{state}", *also), ports, f"{effect}_{state}")


_1, _2, _PUMP = "h1_cm", "h2_cm", "pump_V"
_IN1, _IN2 = ("balance:h1_cm", "flux:pumped_cm3_s"), ("balance:h2_cm", "flux:out_cm3_s")
_BETWEEN = ("flux:between_cm3_s", "balance:h1_cm", "balance:h2_cm")
_DRIVE = ("input:pump_V", "flux:pumped_cm3_s", "balance:h1_cm")
MACHINE = Machine(
    name="two_tanks",
    simulator="examples/two_tanks.py:TANKS",
    values={},
    calibrate=_NAMES[:3],
    inputs=("pump_V",),
    outputs=("level1_cm", "level2_cm"),
    parameters=dict(zip(_NAMES, (20.0, 0.5, 0.5) + (0.0,) * 20, strict=True)),
    spread=dict.fromkeys(_NAMES[:3], 0.15),
    exponent=(1.9, 2.1),
    ambient=2e-4,
    law=law,
    reading=reading,
    start=start,
    slow={0: 0.3, 1: 0.3},
    operate=operate,
    settle_s=300.0,
    period_s=0.5,
    fine=20,
    coarse=6,
    seconds={"train": (1200.0, 1200.0, 1200.0), "held": (1200.0, 1200.0)},
    noise={
        "pump_V": Noise(0.002, 0.0, 1.0),
        "level1_cm": Noise(0.12, 0.08, 4.0),
        "level2_cm": Noise(0.12, 0.08, 4.0),
    },
    lsb={"pump_V": 0.001, "level1_cm": 0.03, "level2_cm": 0.03},
    effects=(
        _on(_1, "leak", "crack1", 0.01, 0.3, *_IN1),
        _on(_2, "leak", "crack2", 0.01, 0.3, *_IN2),
        _on(_1, "linear_leak", "seep1", 1e-3, 0.05, *_IN1),
        _on(_2, "linear_leak", "seep2", 1e-3, 0.05, *_IN2),
        _on(_1, "quadratic_leak", "gush1", 5e-5, 2e-3, *_IN1),
        _on(_1, "overflow", "brim1", 0.02, 1.0, *_IN1),
        _on(_2, "overflow", "brim2", 0.02, 1.0, *_IN2),
        _on(_1, "offset", "feed1", 0.02, 0.5, *_DRIVE, also=("input_bias@pump_V",)),
        _on(_2, "offset", "feed2", 0.02, 0.5, *_IN2),
        _on(_1, "periodic", "wave1", 0.02, 0.5, *_IN1),
        _on(_2, "periodic", "wave2", 0.02, 0.5, *_IN2),
        _on(_PUMP, "dead_zone", "gap", 0.5, 2.0, *_DRIVE, also=("input_bias@pump_V", "offset@h1_cm")),
        _on(_PUMP, "backlash", "play", 0.2, 2.0, *_DRIVE),
    ),
    foreign=(
        Effect("vortex_in_the_outlet", "vortex", 0.2, 0.9, (), _BETWEEN),
        Effect("outlet_clogs_with_use", "clogging", 0.02, 0.4, (), _IN2),
    ),
    confusable=(
        ("leak@h1_cm", "linear_leak@h1_cm"),
        ("linear_leak@h1_cm", "quadratic_leak@h1_cm"),
        ("overflow@h1_cm", "quadratic_leak@h1_cm"),
        ("offset@h2_cm", "linear_leak@h2_cm"),
    ),
)
