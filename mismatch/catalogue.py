"""What any machine may lack, chosen by what its variables are: states that move, stores, temperatures.

Faults of sensors and actuators - saturation, lag and delay of inputs and outputs among them - are in
``mismatch.faults``: no record can tell an actuator that is late from a reading of it that is early.
"""

from __future__ import annotations

import functools
from typing import NamedTuple

from twinbench.mismatch import effects, friction, heat, limits
from twinbench.mismatch.natures import CONTENTS, SPEEDS, TEMPERATURES
from twinbench.mismatch.place import Place
from twinbench.mismatch.reversal import Turned
from twinbench.mismatch.structure import chokes, flows, positions_of, typical_rates
from twinbench.physics.simulator import Mechanism, Series, Simulator, Term, Variable

FRICTION = ("viscous_friction", "quadratic_friction", "cubic_friction", "coulomb_friction")
LOSSES = ("linear_loss", "quadratic_loss", "cubic_loss", "constant_drop")
_FASTEST_1_S = 1e12  # scales of a state in a second: faster is no machine, and overflows where it is squared


class _Course(NamedTuple):
    """What is known of a variable's course: a law that needs a reversal is offered where this is true."""

    crosses: bool
    nears: bool
    reverses: bool


def _course(v: Variable, turned: Turned | None) -> _Course:
    """By the recordings, as far as the variable's bounds allow it."""
    both, zero = v.low < 0.0 < v.high, v.low <= 0.0 <= v.high
    if turned is None:
        return _Course(both, zero, True)
    return _Course(both and v.name in turned.crossed, zero and v.name in turned.near, v.name in turned.reversed)


@functools.cache
def generic(
    simulator: Simulator, periods_s: tuple[float, float, float] | None = None, turned: Turned | None = None
) -> tuple[Mechanism, ...]:
    """Effects that the machine's balances, fluxes and inputs may lack.

    - every balance: an unknown constant rate, a periodic force, a rate that is wrong as a whole (a time constant);
    - a state that moves (by its unit, or because it is the rate of another state) or can be negative: linear,
      quadratic, cubic and dry friction, dry friction unequal by direction if it turns round, Stribeck friction if it
      moves, hysteresis of two kinds if it moves and turns round; and where its position is a state too (by the
      equations, or as the k-th of unit m belongs to the k-th of unit m/s) a hardening spring and free play;
    - a store (never negative): leaks by several laws, overflow, spilling into the next store of the same unit;
    - a temperature: loss to ambient, radiation, a second thermal mass, heat from a temperature that the equations do
      not couple it with;
    - an input: backlash if it reverses, and a dead zone if it can be zero;
    - a flux: saturation, a dead zone if it can be zero; the end of choking for a mass flow in proportion to the
      pressure before it.

    The balance of a position is its velocity and lacks nothing. Of a simulator that can only be stepped nothing is
    asked but whole records: of its inputs.

    Typical sizes come from the states' scales and from how fast the simulator's own equations move
    them around the nominal point.

    Args:
        periods_s: least, typical and greatest of a periodic force; one, ten and a hundred times a state's own time
            if left out.
        turned: which variables turned round in the recordings; if left out, all that their bounds let turn round.

    Raises:
        ValueError: a state that moves faster than any does.
    """
    if simulator.stepped is not None:
        return tuple(m for m in _inputs(simulator, turned) if isinstance(m, Series))
    rates = typical_rates(simulator)
    for v, rate in zip(simulator.states, rates, strict=True):
        if not rate < _FASTEST_1_S * v.scale:
            raise ValueError(
                f"simulator {simulator.name!r}: {v.name} moves by {rate:.3g} {v.unit} a second near its nominal value; "
                "mend its equation, or its unit"
            )
    places = [Place(i, v, float(rates[i])) for i, v in enumerate(simulator.states)]
    return (*_balances(simulator, places, periods_s, turned), *_inputs(simulator, turned), *_fluxes(simulator, turned))


def _balances(
    simulator: Simulator, places: list[Place], periods_s: tuple[float, float, float] | None, turned: Turned | None
) -> list[Term]:
    positions, found = positions_of(simulator), []
    for p in places:
        if p.index in positions.values():
            continue
        found += [effects.offset(p), effects.time_constant(p)]
        found += [*_by_nature(p, simulator, places, positions, turned), effects.periodic(p, periods_s)]
        if p.index in positions:
            q = positions[p.index]
            of = simulator.states[q]
            found.append(effects.hardening_spring(p, q, of))
            found += [effects.spring_backlash(p, q, of)] if _course(of, turned).crosses else []
    return found + heat.exchanges(simulator, [p for p in places if p.index not in positions.values()])


def _inputs(simulator: Simulator, turned: Turned | None) -> list[Mechanism]:
    found: list[Mechanism] = []
    for i, v in enumerate(simulator.inputs):
        course = _course(v, turned)
        found += [limits.dead_zone(i, v)] if course.nears else []
        found += [limits.dead_zone_unequal(i, v)] if course.crosses else []
        found += [limits.backlash(v)] if course.reverses else []
    return found


def _fluxes(simulator: Simulator, turned: Turned | None) -> list[Term]:
    found = []
    for i, v in enumerate(simulator.fluxes):
        if v.unit in TEMPERATURES or not flows(simulator, i):
            continue
        found.append(limits.flux_saturation(v))
        found += [limits.flux_dead_zone(v)] if _course(v, turned).nears else []
        found += [limits.unchoked(v, up, down) for up, down in chokes(simulator, i) if limits.unchokes(up, down)]
    return found


def _by_nature(
    p: Place, simulator: Simulator, places: list[Place], positions: dict[int, int], turned: Turned | None
) -> list[Term]:
    v, moves = p.variable, p.variable.unit in SPEEDS or p.index in positions
    if v.unit in TEMPERATURES:
        return heat.thermal(p, simulator)
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
            (effects.linear, effects.quadratic, effects.cubic, friction.coulomb), names, words, strict=True
        )
    ]
    if _course(v, turned).crosses:
        found.append(friction.coulomb_unequal(p, f"{names[-1]}_unequal", words[-1]))
    if moves:
        found.append(friction.stribeck(p))
        # The bounds of a speed may not say that it turns round, and a store of force works with one direction too.
        found += [friction.hysteresis(p), friction.bouc_wen(p)] if turned is None or v.name in turned.crossed else []
    return found
