"""The concealed tanks: two in series with what ``examples/two_tanks.py`` leaves out."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from twinbench.physics.places import places
from twinbench.physics.simulator import Array
from twinbench.proof.concealed.integrate import LAW
from twinbench.proof.concealed.machine import Effect, Machine, Noise, clock, levels

_OWN = {"pump_cm3_s_V": 20.0, "hole1_cm2": 0.5, "hole2_cm2": 0.5}
"""The machine's own constants, which the twin may calibrate."""
_PARAMETERS = _OWN | dict.fromkeys((
    "ripple", "ripple_phase", "ambient", "ambient_phase", "exponent",
    "crack1", "crack2", "seep1", "seep2", "gush1", "brim1", "brim2", "feed1", "feed2", "wave1", "wave2", "gap", "play",
    "vortex", "clogging",
), 0.0)  # fmt: skip
_INPUTS = ("pump_V",)
_OUTPUTS = ("level1_cm", "level2_cm")
_STATES = ("h1", "h2", "dirt")
P, X, U, Y = (places(names) for names in (_PARAMETERS, _STATES, _INPUTS, _OUTPUTS))


@njit(LAW, cache=True, error_model="numpy")
def law(t, x, u, p, dx):  # type: ignore[no-untyped-def]
    """Rates of change: levels in cm/s."""
    h1, h2 = max(x[X.h1], 0.0), max(x[X.h2], 0.0)
    n = p[P.exponent]
    V = u[U.pump_V]
    if p[P.gap] > 0.0:
        V -= p[P.gap] * math.tanh(u[U.pump_V] / p[P.gap])
    drift = 1.0 + p[P.ambient] * math.sin(2.0 * math.pi * t / 5000.0 + p[P.ambient_phase])
    ripple = 1.0 + p[P.ripple] * math.sin(1.7 * V + p[P.ripple_phase]) * math.cos(0.21 * h1)
    pumped = p[P.pump_cm3_s_V] * V * drift * ripple
    hole = p[P.hole1_cm2] * (1.0 - p[P.vortex] * math.exp(-h1 / 6.0))
    between = hole * math.sqrt(2.0 * 981.0 * h1)
    out = p[P.hole2_cm2] * (1.0 - p[P.clogging] * x[X.dirt]) * math.sqrt(2.0 * 981.0 * h2)

    lost1 = p[P.crack1] * h1 ** (0.25 * n) + p[P.seep1] * h1 ** (0.5 * n) * 20.0 ** (1.0 - 0.5 * n)
    lost1 += p[P.gush1] * h1**n * 20.0 ** (2.0 - n)
    lost1 += p[P.brim1] * 0.5 * math.log1p(math.exp(min((h1 - 18.0) / 0.5, 60.0)))
    lost2 = p[P.crack2] * max(h2 - 8.0, 0.0) ** (0.25 * n) + p[P.seep2] * h2 ** (0.5 * n) * 20.0 ** (1.0 - 0.5 * n)
    lost2 += p[P.brim2] * 0.5 * math.log1p(math.exp(min((h2 - 18.0) / 0.5, 60.0)))
    wave = math.sin(2.0 * math.pi * t / 130.0 + 0.4)
    dx[X.h1] = (pumped - between) / 154.0 - lost1 + p[P.feed1] + p[P.wave1] * wave
    dx[X.h2] = (between - out) / 154.0 - lost2 + p[P.feed2] + p[P.wave2] * wave
    dx[X.dirt] = (h2 / 20.0 - x[X.dirt]) / 400.0
    return 0.0


@njit(LAW, cache=True, error_model="numpy")
def reading(t, x, u, p, y):  # type: ignore[no-untyped-def]
    """level1_cm, level2_cm."""
    y[Y.level1_cm], y[Y.level2_cm] = x[X.h1], x[X.h2]
    return 0.0


def ripple_arguments(x: Array, u: Array) -> Array:
    """Of the pump's ripple, (N, 2): its voltage and the level that it pumps into, scaled.

    Args:
        x: (N, nx) each state in its unit.
        u: (N, nu) inputs in their units.
    """
    return np.stack([1.7 * u[:, U.pump_V], 0.21 * x[:, X.h1]], axis=-1)


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
    flow = p[P.pump_cm3_s_V] * u[U.pump_V]
    h1, h2 = ((flow / hole) ** 2 / (2.0 * 981.0) for hole in (p[P.hole1_cm2], p[P.hole2_cm2]))
    x = np.empty(len(X))
    x[X.h1], x[X.h2], x[X.dirt] = h1, h2, h2 / 20.0
    return x


def _on(state: str, effect: str, slot: str, typical: float, most: float, *ports: str) -> Effect:
    return Effect(f"{effect}@{state}", slot, typical, most, ports, f"{effect}_{state}")


_1, _2, _PUMP = "h1_cm", "h2_cm", "pump_V"
_IN1, _IN2 = ("balance:h1_cm", "flux:pumped_cm3_s"), ("balance:h2_cm", "flux:out_cm3_s")
_BETWEEN = ("flux:between_cm3_s", "balance:h1_cm", "balance:h2_cm")
_DRIVE = ("input:pump_V", "flux:pumped_cm3_s", "balance:h1_cm")
MACHINE = Machine(
    name="two_tanks",
    simulator="examples/two_tanks.py:TANKS",
    values={},
    calibrate=tuple(_OWN),
    inputs=_INPUTS,
    outputs=_OUTPUTS,
    parameters=_PARAMETERS,
    spread=dict.fromkeys(_OWN, 0.15),
    exponent=(1.9, 2.1),
    ambient=2e-4,
    law=law,
    reading=reading,
    start=start,
    slow={X.h1: 0.3, X.h2: 0.3},
    operate=operate,
    settle_s=300.0,
    period_s=0.5,
    fine=20,
    coarse=2,
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
        _on(_1, "offset", "feed1", 0.02, 0.5, *_DRIVE),
        _on(_2, "offset", "feed2", 0.02, 0.5, *_IN2),
        _on(_1, "periodic", "wave1", 0.02, 0.5, *_IN1),
        _on(_2, "periodic", "wave2", 0.02, 0.5, *_IN2),
        _on(_PUMP, "dead_zone", "gap", 0.5, 2.0, *_DRIVE),
        _on(_PUMP, "backlash", "play", 0.2, 2.0, *_DRIVE),
    ),
    foreign=(
        Effect("vortex_in_the_outlet", "vortex", 0.2, 0.9, _BETWEEN),
        Effect("outlet_clogs_with_use", "clogging", 0.02, 0.4, _IN2),
    ),
    rippled="pump_cm3_s_V",
    ripple_arguments=ripple_arguments,
    played={"pump_V": "play"},
)
