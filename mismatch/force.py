"""Terms of a balance that is a sum of forces over an inertia, or of heat flows over a heat capacity, said as those.

A term is added to a state's rate of change. That is an acceleration where the state is a speed, and times the inertia
it is a force. Where the state is a temperature it is a heat flow over a capacity. Which parameter is the inertia or the
capacity is asked of the equations themselves, and of the units.
"""

from __future__ import annotations

import functools
import re
from typing import NamedTuple

import numpy as np

from twinbench.common.errors import BadInput
from twinbench.data.units import convert
from twinbench.mismatch.natures import SPEEDS, TEMPERATURES
from twinbench.mismatch.structure import at_points, scattered
from twinbench.physics.compose import plain_rhs
from twinbench.physics.simulator import Simulator, Variable

FORCES = ("N", "N m")
"""What a mass times an acceleration may be: a force, or with an inertia a torque."""
POWER = "W"
"""What a heat capacity times the rate of a temperature is."""
HIGHEST_POWER = 4
"""A size may be a force over so high a power of a state: radiation is of the fourth."""
_BRACKETS = re.compile(r"(\([^()]+\))\^(\d)")
_DEGREES = {
    degree: re.compile(rf"(?<![^\W\d_])({names})(?![^\W\d_])")
    for degree, names in (("K", "degC|°C|celsius|kelvin"), ("degR", "degF"))
}
"""Differences of temperature have no zero: those in degC are in kelvin, those in degF in degrees Rankine."""
INVERSE_ROUND_OFF = 1e-6
"""Relative error up to which the equations count as inversely proportional to a parameter: that of rounding."""


class Inertia(NamedTuple):
    """What makes rates of forces or of heat: ``parameter`` stands at ``at`` in theta; ``force`` is N, N m or W."""

    parameter: Variable
    at: int
    force: str

    @property
    def word(self) -> str:
        """What a size times it is called."""
        return "heat flow" if self.force == POWER else "force"


@functools.cache
def inertia(simulator: Simulator, state: int) -> Inertia | None:
    """The one parameter that a speed's rate is a constant and a force over, or a temperature's a heat flow over.

    None if there is none, or several.
    """
    v = simulator.states[state]
    if v.unit not in SPEEDS and v.unit not in TEMPERATURES:
        return None
    kinds = (POWER,) if v.unit in TEMPERATURES else FORCES
    found = [
        Inertia(p, i, force)
        for i, p in enumerate(simulator.parameters)
        for force in kinds
        if factor(f"({p.unit})*({v.unit})/s", force) is not None and _divides(simulator, state, i)
    ]
    return found[0] if len(found) == 1 else None


def as_force(size_unit: str, simulator: Simulator, state: int, of: Inertia) -> tuple[float, str] | None:
    """What makes newtons or watts of a size times the inertia, and their unit; None if nothing does.

    The unit reads ``N``, ``N m/(rad/s)``, ``W/(K)``.
    """
    whole = f"({of.parameter.unit})*({size_unit})"
    variables = (simulator.states[state], *simulator.states)
    units = dict.fromkeys("K" if v.unit in TEMPERATURES else v.unit for v in variables)
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
    """A unit with its powers of brackets as products, which is how units are read here; differences in kelvin."""
    for degree, pattern in _DEGREES.items():
        unit = pattern.sub(degree, unit)
    return _BRACKETS.sub(lambda m: f"({'*'.join([m[1]] * int(m[2]))})", unit)


def _divides(simulator: Simulator, state: int, parameter: int) -> bool:
    """Is a state's rate a constant plus something over the parameter, everywhere?"""
    rhs, (x, u) = plain_rhs(simulator), scattered(simulator)
    rates = []
    for times in (1.0, 2.0, 4.0):
        theta = simulator.theta()
        theta[parameter] *= times
        rates.append(at_points(rhs, x.shape[1], x, u, theta)[:, state])
    first, second = rates[0] - rates[1], rates[1] - rates[2]
    size = np.abs(np.array(rates)).max()
    return bool(
        np.isfinite(size)
        and np.abs(first).max() > INVERSE_ROUND_OFF * size
        and np.allclose(first, 2.0 * second, rtol=INVERSE_ROUND_OFF, atol=INVERSE_ROUND_OFF * size)
    )
