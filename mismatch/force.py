"""Terms of a balance that is a sum of forces divided by an inertia, said as forces.

A term is added to a state's rate of change, so it is an acceleration where the state is a speed. Times the inertia it
is a force. Which parameter is the inertia is asked of the equations themselves, and of the units.
"""

from __future__ import annotations

import functools
import re
from typing import NamedTuple

import numpy as np

from twinbench.common.errors import BadInput
from twinbench.data.units import convert
from twinbench.mismatch.catalogue import SPEEDS, scattered
from twinbench.physics.compose import plain_rhs
from twinbench.physics.simulator import Simulator, Variable

FORCES = ("N", "N m")
"""What a mass times an acceleration may be: a force, or with an inertia a torque."""
HIGHEST_POWER = 3
"""A size may be a force over so high a power of a state: cubic friction, a hardening spring."""
_BRACKETS = re.compile(r"(\([^()]+\))\^(\d)")
INVERSE_ROUND_OFF = 1e-6
"""Relative error up to which the equations count as inversely proportional to a parameter: that of rounding."""


class Inertia(NamedTuple):
    """What makes accelerations of forces: ``parameter`` stands at ``at`` in theta; ``force`` is N or N m."""

    parameter: Variable
    at: int
    force: str


@functools.cache
def inertia(simulator: Simulator, state: int) -> Inertia | None:
    """The one parameter that a speed's rate is a constant and a force over; None if there is none, or several."""
    v = simulator.states[state]
    if v.unit not in SPEEDS:
        return None
    found = [
        Inertia(p, i, force)
        for i, p in enumerate(simulator.parameters)
        for force in FORCES
        if factor(f"({p.unit})*({v.unit})/s", force) is not None and _divides(simulator, state, i)
    ]
    return found[0] if len(found) == 1 else None


def as_force(size_unit: str, simulator: Simulator, state: int, of: Inertia) -> tuple[float, str] | None:
    """What makes newtons of a size times the inertia, and their unit: ``N``, ``N m/(rad/s)``; None if nothing does."""
    whole = f"({of.parameter.unit})*({size_unit})"
    units = dict.fromkeys((simulator.states[state].unit, *(v.unit for v in simulator.states)))
    for unit in units:
        for power in range(HIGHEST_POWER + 1):
            over = f"/({unit})^{power}" if power > 1 else f"/({unit})" if power else ""
            times = factor(whole, f"({of.force}){over}")
            if times is not None:
                return times, f"{of.force}{over}"
    return None


def factor(given: str, wanted: str) -> float | None:
    """So many of one unit is another; None if they are of different kinds, or one is no unit."""
    try:
        return float(convert(np.array([1.0]), _multiplied(given), _multiplied(wanted), "")[0])
    except BadInput:
        return None


def _multiplied(unit: str) -> str:
    """A unit with its powers of brackets as products, which is how units are read here."""
    return _BRACKETS.sub(lambda m: f"({'*'.join([m[1]] * int(m[2]))})", unit)


def _divides(simulator: Simulator, state: int, parameter: int) -> bool:
    """Is a state's rate a constant plus something over the parameter, everywhere?"""
    rhs, rng = plain_rhs(simulator), np.random.default_rng(0)
    x, u = (scattered(group, rng) for group in (simulator.states, simulator.inputs))
    rates = []
    for times in (1.0, 2.0, 4.0):
        theta = simulator.theta()
        theta[parameter] *= times
        with np.errstate(all="ignore"):
            rates.append(np.array([rhs(*point, theta)[state] for point in zip(x, u, strict=True)], dtype=np.float64))
    first, second = rates[0] - rates[1], rates[1] - rates[2]
    size = np.abs(np.array(rates)).max()
    return bool(
        np.isfinite(size)
        and np.abs(first).max() > INVERSE_ROUND_OFF * size
        and np.allclose(first, 2.0 * second, rtol=INVERSE_ROUND_OFF, atol=INVERSE_ROUND_OFF * size)
    )
