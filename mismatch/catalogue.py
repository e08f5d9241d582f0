"""What any machine may lack, chosen by what its variables are: states that move, stores, temperatures.

Faults of sensors and actuators - saturation, lag and delay of inputs and outputs among them - are in
``mismatch.faults``: no record can tell an actuator that is late from a reading of it that is early.
"""

from __future__ import annotations

import functools
import re

import numpy as np

from twinbench.mismatch import effects
from twinbench.mismatch.place import Place
from twinbench.physics.compose import plain_rhs
from twinbench.physics.simulator import Array, Mechanism, Simulator, Term, Variable

TEMPERATURES = {
    "K": (240.0, 325.0, 295.0),
    "kelvin": (240.0, 325.0, 295.0),
    "degC": (-30.0, 50.0, 20.0),
    "°C": (-30.0, 50.0, 20.0),
    "celsius": (-30.0, 50.0, 20.0),
    "degF": (-20.0, 120.0, 70.0),
}
"""Units of temperature, and in each a cold, a hot and a common ambient."""
AMBIENT = re.compile(r"(?<![a-z])t?amb(ient)?(?![a-z])")
"""Names of an ambient temperature: T_amb_K, Tamb, ambient; not T_chamber_K."""
SPEEDS = {"rpm", "r/min", "1/min", "Hz", "rad/s", "rad/min", "deg/s", "m/s", "cm/s", "mm/s", "km/h"}
"""Units of states that move: friction holds them back even if they never turn round."""
CONTENTS = {"m", "cm", "mm", "m3", "m^3", "l", "L", "kg", "V", "%"}
"""Units of the content of a vessel, which can spill into the next."""
FRICTION = ("viscous_friction", "quadratic_friction", "cubic_friction", "coulomb_friction")
LOSSES = ("linear_loss", "quadratic_loss", "cubic_loss", "constant_drop")
STRUCTURE_POINTS = 5
"""Points at which the equations are asked which state is whose rate."""
_FASTEST_1_S = 1e12  # scales of a state in a second: faster is no machine, and overflows where it is squared
_SLOWEST_S = 10.0  # a state that nothing seems to move: its scale in ten times this


@functools.cache
def generic(simulator: Simulator, periods_s: tuple[float, float, float] | None = None) -> tuple[Mechanism, ...]:
    """Effects that the machine's balances and inputs may lack.

    - every balance: an unknown constant rate, a periodic force;
    - a state that moves (by its unit, or because it is the rate of another state) or can be negative: linear,
      quadratic, cubic and dry friction, dry friction unequal by direction if it can turn round, hysteresis if it
      moves; and where its position is a state too (by the equations, or as the k-th of unit m belongs to the k-th
      of unit m/s) a hardening spring and free play;
    - a store (never negative): leaks by several laws, overflow, spilling into the next store of the same unit;
    - a temperature: loss to ambient, a second thermal mass;
    - an input: backlash, and a dead zone if it can be zero.

    The balance of a position is its velocity and lacks nothing.

    Typical sizes come from the states' scales and from how fast the simulator's own equations move
    them around the nominal point.

    Args:
        periods_s: least, typical and greatest of a periodic force; one, ten and a hundred times a state's own time
            if left out.

    Raises:
        ValueError: a state that moves faster than any does.
    """
    rates = typical_rates(simulator)
    for v, rate in zip(simulator.states, rates, strict=True):
        if not rate < _FASTEST_1_S * v.scale:
            raise ValueError(
                f"simulator {simulator.name!r}: {v.name} moves by {rate:.3g} {v.unit} a second near its nominal value; "
                "mend its equation, or its unit"
            )
    places = [Place(i, v, float(rates[i])) for i, v in enumerate(simulator.states)]
    positions = positions_of(simulator)
    found: list[Mechanism] = []
    for p in places:
        if p.index in positions.values():
            continue
        moves = p.variable.unit in SPEEDS or p.index in positions
        found += [effects.offset(p), *_by_nature(p, simulator, places, moves), effects.periodic(p, periods_s)]
        if p.index in positions:
            q = positions[p.index]
            of = simulator.states[q]
            found += [effects.hardening_spring(p, q, of), effects.spring_backlash(p, q, of)]
    for i, v in enumerate(simulator.inputs):
        found += [effects.dead_zone(i, v)] if v.low <= 0.0 <= v.high else []
        found.append(effects.backlash(v))
    return tuple(found)


def _by_nature(p: Place, simulator: Simulator, places: list[Place], moves: bool) -> list[Term]:
    v = p.variable
    if v.unit in TEMPERATURES:
        return [_loss_to_ambient(p, simulator), effects.second_thermal_mass(p)]
    if moves:
        names, words = FRICTION, ("viscous friction", "drag", "drag", "dry (Coulomb) friction")
    elif v.low < 0.0:
        names, words = LOSSES, ("a loss", "a loss", "a loss", "a drop")
    else:
        before = [q for q in places[: p.index] if q.variable.unit == v.unit and q.variable.low >= 0.0]
        return [
            effects.leak(p),
            effects.linear(p, "linear_leak", "a leak"),
            effects.quadratic(p, "quadratic_leak", "a leak"),
            effects.overflow(p),
            *(effects.spill(p, q) for q in before[-1:] if v.unit in CONTENTS),
        ]
    found = [
        make(p, name, word)
        for make, name, word in zip(
            (effects.linear, effects.quadratic, effects.cubic, effects.coulomb), names, words, strict=True
        )
    ]
    if v.low < 0.0:
        found.append(effects.coulomb_unequal(p, f"{names[-1]}_unequal", words[-1]))
    if moves:
        found.append(effects.hysteresis(p))
    return found


def _loss_to_ambient(p: Place, simulator: Simulator) -> Term:
    """To the machine's own ambient, if an input or a parameter of that name is there."""
    for kind, variables in (("input", simulator.inputs), ("parameter", simulator.parameters)):
        for at, v in enumerate(variables):
            if AMBIENT.search(v.name.lower()) and v.unit == p.variable.unit:
                return effects.loss_to_ambient(p, kind, at, v.name)
    return effects.loss_to_unknown_ambient(p, *TEMPERATURES[p.variable.unit])


def positions_of(simulator: Simulator) -> dict[int, int]:
    """For each state that is the rate of another, where that other stands: by the equations, else by the units."""
    states = simulator.states
    found = _rates_of_others(simulator)
    for i, v in enumerate(states):
        if i not in found and v.unit in SPEEDS and v.unit.endswith("/s"):
            free = [j for j, w in enumerate(states) if f"{w.unit}/s" == v.unit and j not in found.values()]
            found.update((i, j) for j in free[:1])
    return found


def _rates_of_others(simulator: Simulator) -> dict[int, int]:
    """States that the equations take for another's rate as they are, and that other, wherever the machine is."""
    rhs, theta, rng = plain_rhs(simulator), simulator.theta(), np.random.default_rng(0)
    x, u = (scattered(group, rng) for group in (simulator.states, simulator.inputs))
    with np.errstate(all="ignore"):
        rates = np.array([rhs(*point, theta) for point in zip(x, u, strict=True)], dtype=np.float64)
    pairs = ((i, j) for j in range(x.shape[1]) for i in range(x.shape[1]) if i != j)
    return {i: j for i, j in pairs if np.array_equal(rates[:, j], x[:, i])}


def scattered(variables: tuple[Variable, ...], rng: np.random.Generator) -> Array:
    """Points (5, n) within a scale of the nominal ones."""
    nominal, scale = (np.array([getattr(v, name) for v in variables], dtype=float) for name in ("nominal", "scale"))
    low, high = ([getattr(v, name) for v in variables] for name in ("low", "high"))
    return np.clip(nominal + scale * rng.uniform(-1.0, 1.0, (STRUCTURE_POINTS, len(variables))), low, high)


def typical_rates(simulator: Simulator) -> Array:
    """How fast each state commonly changes, (nx,), in its unit per second.

    The root sum of squares of what one scale of each state and input does to its rate at the nominal
    point; where that is nothing, the rate there; where that is nothing too, a slow guess.
    """
    rhs, theta = plain_rhs(simulator), simulator.theta()
    x, u = (np.array([v.nominal for v in group], dtype=np.float64) for group in (simulator.states, simulator.inputs))
    scales = np.array([v.scale for v in simulator.states])
    with np.errstate(all="ignore"):
        base = np.asarray(rhs(x, u, theta), dtype=np.float64)
        moved = [np.asarray(rhs(x + step, u, theta)) - base for step in np.diag(scales)]
        moved += [np.asarray(rhs(x, u + step, theta)) - base for step in np.diag([v.scale for v in simulator.inputs])]
    rates = np.sqrt(np.sum(np.square(np.nan_to_num(moved, posinf=0.0, neginf=0.0)), axis=0))
    rates = np.where(rates > 0.0, rates, np.abs(np.nan_to_num(base, posinf=0.0, neginf=0.0)))
    return np.where(rates > 0.0, rates, scales / _SLOWEST_S)
