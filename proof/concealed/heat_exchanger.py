"""The concealed oil cooler: ``examples/heat_exchanger.py`` with what that leaves out.

Nobody tunes an engine on this machine.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from twinbench.physics.places import places
from twinbench.physics.simulator import Array
from twinbench.proof.concealed.integrate import LAW
from twinbench.proof.concealed.machine import Effect, Machine, Noise, clock, levels

_OWN = {"UA_oil_W_K": 1600.0, "UA_water_W_K": 2600.0, "M_oil_kg": 10.0, "M_water_kg": 5.0, "C_wall_J_K": 35000.0}
"""The machine's own constants, which the twin may calibrate."""
_PARAMETERS = _OWN | dict.fromkeys((
    "ripple", "ripple_phase", "ambient", "ambient_phase", "exponent",
    "bare_oil", "bare_wall1", "bare_wall2", "bare_water", "shell", "frame", "header", "churning", "sun", "pulse_oil",
    "pulse_water", "gap_oil", "gap_water", "play_oil", "play_water",
    "fouling", "thick_oil",
), 0.0)  # fmt: skip
_INPUTS = ("oil_kg_s", "water_kg_s", "T_oil_in_K", "T_water_in_K")
_OUTPUTS = ("T_oil_out_K", "T_water_out_K", "T_metal_K")
_STATES = ("oil1", "oil2", "wall1", "wall2", "water1", "water2", "T_shell", "T_frame", "T_header", "dirt")
P, X, U, Y = (places(names) for names in (_PARAMETERS, _STATES, _INPUTS, _OUTPUTS))


@njit(cache=True, error_model="numpy", inline="always")
def _lost(T, room, n):  # type: ignore[no-untyped-def]
    """Excess over the room (K), as natural convection feels it: a little steeper than in proportion."""
    excess = T - room
    return math.copysign(abs(excess) ** (n - 0.8), excess) * 40.0 ** (1.8 - n)


@njit(cache=True, error_model="numpy", inline="always")
def _beyond(flow, gap):  # type: ignore[no-untyped-def]
    """A flow behind a valve that opens late, with a soft knee."""
    return flow - gap * math.tanh(flow / gap) if gap > 0.0 else flow


@njit(LAW, cache=True, error_model="numpy")
def law(t, x, u, p, dx):  # type: ignore[no-untyped-def]
    """Rates of change: temperatures in K/s."""
    oil1, oil2, wall1, wall2 = x[X.oil1], x[X.oil2], x[X.wall1], x[X.wall2]
    water1, water2, n = x[X.water1], x[X.water2], p[P.exponent]
    room = 295.0 + p[P.ambient] * math.sin(2.0 * math.pi * t / 4000.0 + p[P.ambient_phase])
    oil, water = _beyond(u[U.oil_kg_s], p[P.gap_oil]), _beyond(u[U.water_kg_s], p[P.gap_water])

    # Heat through the two films, kW; the oil's film thickens as it cools, and the water's fouls with use.
    film = 1e-3 * p[P.UA_oil_W_K] * (max(oil, 0.0) / 0.8) ** 0.6
    film *= 1.0 + p[P.ripple] * math.sin(5.5 * oil + p[P.ripple_phase]) * math.cos(0.17 * (oil1 - wall1))
    film1 = film * (1.0 + p[P.thick_oil] * (0.5 * (oil1 + wall1) - 328.0) / 10.0)
    film2 = film * (1.0 + p[P.thick_oil] * (0.5 * (oil2 + wall2) - 328.0) / 10.0)
    scaled = 1e-3 * p[P.UA_water_W_K] * (max(water, 0.0) / 0.4) ** 0.8 / (1.0 + p[P.fouling] * x[X.dirt])
    hot1, hot2, cold1, cold2 = (
        film1 * (oil1 - wall1), film2 * (oil2 - wall2), scaled * (wall2 - water1), scaled * (wall1 - water2),
    )  # fmt: skip

    # Renewal of what is in a half, 1/s, and its heat capacity, kJ/K.
    new_oil, new_water = oil / p[P.M_oil_kg], water / p[P.M_water_kg]
    C_oil, C_water, C_wall = 2.0 * p[P.M_oil_kg], 4.18 * p[P.M_water_kg], 1e-3 * p[P.C_wall_J_K]
    wave = math.sin(2.0 * math.pi * t / 61.0 + 0.4)
    beat = (wave + 0.15 * math.sin(6.0 * math.pi * t / 61.0 + 1.2)) / 1.01
    dx[X.oil1] = new_oil * (u[U.T_oil_in_K] - oil1) - hot1 / C_oil
    dx[X.oil1] += p[P.churning] * (1.0 + 0.04 * math.tanh((oil1 - 335.0) / 15.0)) + p[P.pulse_oil] * beat
    dx[X.oil1] -= p[P.bare_oil] * _lost(oil1, room, n)
    dx[X.oil2] = new_oil * (oil1 - oil2) - hot2 / C_oil - p[P.shell] * (oil2 - x[X.T_shell])
    dx[X.wall1] = (hot1 - cold2) / C_wall - p[P.bare_wall1] * _lost(wall1, room, n)
    dx[X.wall1] -= p[P.frame] * (wall1 - x[X.T_frame])
    dx[X.wall2] = (hot2 - cold1) / C_wall - p[P.bare_wall2] * _lost(wall2, room, n)
    dx[X.water1] = new_water * (u[U.T_water_in_K] - water1) + cold1 / C_water
    dx[X.water1] += p[P.sun] * (1.0 - 0.04 * math.tanh((water1 - 303.0) / 15.0))
    dx[X.water1] -= p[P.header] * (water1 - x[X.T_header])
    dx[X.water2] = new_water * (water1 - water2) + cold2 / C_water + p[P.pulse_water] * beat
    dx[X.water2] -= p[P.bare_water] * _lost(water2, room, n)
    # The second masses, each a little quicker the further it lags behind.
    dx[X.T_shell] = (oil2 - x[X.T_shell]) * (1.0 + 0.01 * abs(oil2 - x[X.T_shell])) / 140.0
    dx[X.T_frame] = (wall1 - x[X.T_frame]) * (1.0 + 0.01 * abs(wall1 - x[X.T_frame])) / 220.0
    dx[X.T_header] = (water1 - x[X.T_header]) * (1.0 + 0.01 * abs(water1 - x[X.T_header])) / 90.0
    dx[X.dirt] = (0.1 * (wall1 - water2) - x[X.dirt]) / 500.0
    return 0.0


@njit(LAW, cache=True, error_model="numpy")
def reading(t, x, u, p, y):  # type: ignore[no-untyped-def]
    """T_oil_out_K, T_water_out_K, T_metal_K."""
    y[Y.T_oil_out_K], y[Y.T_water_out_K], y[Y.T_metal_K] = x[X.oil2], x[X.water2], x[X.wall1]
    return 0.0


def ripple_arguments(x: Array, u: Array) -> Array:
    """Of the oil film's ripple, (N, 2): the oil's flow and its excess over the wall where it enters, scaled.

    Args:
        x: (N, nx) each state in its unit.
        u: (N, nu) inputs in their units.
    """
    return np.stack([5.5 * u[:, U.oil_kg_s], 0.17 * (x[:, X.oil1] - x[:, X.wall1])], axis=-1)


def operate(rng: np.random.Generator, seconds: float, regime: str) -> Array:
    """Inputs (N, 4): both flows in held pieces, both inlet temperatures in slower ones."""
    oil, water, T_oil, T_water = {
        "train": ((0.4, 1.2), (0.2, 0.6), (338.0, 358.0), (285.0, 295.0)),
        "held": ((0.5, 1.45), (0.25, 0.75), (342.0, 366.0), (288.0, 300.0)),
        "poor": ((0.8, 0.801), (0.4, 0.401), (350.0, 350.2), (290.0, 290.1)),
    }[regime]
    t = clock(seconds, 1.0)
    pieces = ((oil, (20.0, 200.0)), (water, (20.0, 200.0)), (T_oil, (60.0, 400.0)), (T_water, (100.0, 600.0)))
    return np.stack([levels(rng, t, limits, hold, (4.0, 30.0)) for limits, hold in pieces], axis=-1)


def start(u: Array, p: Array) -> Array:
    """A guess of the state under inputs u (4,).

    Args:
        u: (4,) inputs in their units.
        p: (n_parameters,) the law's own, each in its unit.
    """
    hot, cold = u[U.T_oil_in_K], u[U.T_water_in_K]
    shares = {"oil1": 0.75, "oil2": 0.6, "wall1": 0.5, "wall2": 0.4, "water1": 0.2, "water2": 0.35}
    x = np.zeros(len(X))
    for name, share in shares.items():
        x[_STATES.index(name)] = cold + share * (hot - cold)
    x[X.T_shell], x[X.T_frame], x[X.T_header] = x[X.oil2], x[X.wall1], x[X.water1]
    x[X.dirt] = 0.1 * (x[X.wall1] - x[X.water2])
    return x


def _on(state: str, effect: str, slot: str, typical: float, most: float, *ports: str) -> Effect:
    return Effect(f"{effect}@{state}", slot, typical, most, (f"balance:{state}", *ports), f"{effect}_{state}")


def _valve(flow: str, effect: str, slot: str, *states: str) -> Effect:
    ports = (f"input:{flow}", *(f"balance:{s}" for s in states))
    return Effect(f"{effect}@{flow}", slot, 0.02, 0.4, ports, f"{effect}_{flow}")


_OIL1, _OIL2, _WALL1, _WALL2, _WATER1, _WATER2 = "oil_1_K", "oil_2_K", "wall_1_K", "wall_2_K", "water_1_K", "water_2_K"
_HOT1, _HOT2, _COLD1, _COLD2 = (
    "flux:oil_wall_1_W", "flux:oil_wall_2_W", "flux:wall_water_1_W", "flux:wall_water_2_W",
)  # fmt: skip
_PROBE = Noise(0.12, 0.08, 6.0)
MACHINE = Machine(
    name="heat_exchanger",
    simulator="examples/heat_exchanger.py:COOLER",
    values={},
    calibrate=tuple(_OWN),
    inputs=_INPUTS,
    outputs=_OUTPUTS,
    parameters=_PARAMETERS,
    spread=dict.fromkeys(_OWN, 0.15),
    exponent=(1.9, 2.1),
    ambient=1.0,
    law=law,
    reading=reading,
    start=start,
    slow={X.oil1: 1.0, X.oil2: 1.0, X.wall1: 1.0, X.wall2: 1.0, X.water1: 1.0, X.water2: 1.0},
    operate=operate,
    settle_s=1000.0,
    period_s=1.0,
    fine=20,
    coarse=4,
    seconds={"train": (1500.0, 1500.0, 1500.0), "held": (1500.0, 1500.0)},
    noise={
        "oil_kg_s": Noise(0.0005, 0.0, 1.0), "water_kg_s": Noise(0.0003, 0.0, 1.0), "T_oil_in_K": Noise(0.02, 0.0, 1.0),
        "T_water_in_K": Noise(0.02, 0.0, 1.0), "T_oil_out_K": _PROBE, "T_water_out_K": _PROBE, "T_metal_K": _PROBE,
    },
    lsb={"oil_kg_s": 0.0005, "water_kg_s": 0.0002, "T_oil_in_K": 0.02, "T_water_in_K": 0.02, "T_oil_out_K": 0.03,
         "T_water_out_K": 0.03, "T_metal_K": 0.03},
    effects=(
        _on(_OIL1, "loss_to_ambient", "bare_oil", 2e-4, 0.05),
        _on(_WALL1, "loss_to_ambient", "bare_wall1", 2e-4, 0.05),
        _on(_WALL2, "loss_to_ambient", "bare_wall2", 2e-4, 0.05),
        _on(_WATER2, "loss_to_ambient", "bare_water", 2e-4, 0.05),
        _on(_OIL2, "second_thermal_mass", "shell", 2e-3, 0.1),
        _on(_WALL1, "second_thermal_mass", "frame", 2e-3, 0.2),
        _on(_WATER1, "second_thermal_mass", "header", 2e-3, 0.2),
        _on(_OIL1, "offset", "churning", 0.01, 1.0),
        _on(_WATER1, "offset", "sun", 0.01, 1.0),
        _on(_OIL1, "periodic", "pulse_oil", 0.01, 1.0),
        _on(_WATER2, "periodic", "pulse_water", 0.01, 1.0),
        _valve("oil_kg_s", "dead_zone", "gap_oil", _OIL1, _OIL2),
        _valve("water_kg_s", "dead_zone", "gap_water", _WATER1, _WATER2),
        _valve("oil_kg_s", "backlash", "play_oil", _OIL1, _OIL2),
        _valve("water_kg_s", "backlash", "play_water", _WATER1, _WATER2),
    ),
    foreign=(
        Effect("water_side_fouls_with_use", "fouling", 0.02, 1.0, (_COLD1, _COLD2)),
        Effect("oil_film_thickens_when_cold", "thick_oil", 0.02, 0.3, (_HOT1, _HOT2)),
    ),
    rippled="UA_oil_W_K",
    ripple_arguments=ripple_arguments,
    kind="untuned",
    played={"oil_kg_s": "play_oil", "water_kg_s": "play_water"},
)  # fmt: skip
