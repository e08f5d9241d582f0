"""Limits and play of what flows in: laws of an input or of a flux that the simulator takes as it comes.

A flux's law sees the flux itself (``Term.sees_own``). Limits have sharp knees: a term may jump in its slope, not in
its value, and the integrator's steps are halved until that no longer shows.
"""

from __future__ import annotations

import math

import numpy as np

from twinbench.mismatch.place import IN_FORCE, Range
from twinbench.mismatch.series import held, play
from twinbench.mismatch.structure import Pressure
from twinbench.physics.simulator import Array, Port, Series, Term, Variable

CRITICAL_RATIO = 0.528
"""Pressure ratio of air below which a flow is choked: (2/2.4)^3.5."""
WIDTH = 0.2
"""A typical dead zone or play is so many scales of a channel wide."""
OUTERMOST = 1.2
"""Scales from its middle within which a channel's limit is looked for. The channel is within one nearly always: a limit
farther off shows in too little, and a trial value there, of the three that are tried, would be lost."""
OFTEN = 0.5
"""Scales from its middle, on the other side, at which a channel's limit may lie at most: what is beyond its limit
nearly always has a bias and no limit."""


def dead_zone(index: int, v: Variable) -> Term:
    """An input that does nothing until it exceeds a width."""

    def term(x: Array, u: Array, theta: Array) -> float:
        return -min(max(u[index], -theta[-1]), theta[-1])

    size = _width(v, "dead_zone")
    says = f"small values of {v.name} have no effect (dead zone), larger ones that much less"
    formula = f"{v.name} less {{{size.name}}} either side of 0"
    return Term(f"dead_zone@{v.name}", says, Port("input", v.name), (size,), term=term, formula=formula)


def backlash(v: Variable) -> Series:
    """An input that follows its command only when the play is used up."""

    def series(time_s: Array, values: Array, theta: Array) -> Array:
        return play(held(np.asarray(values, dtype=np.float64)), theta[0])

    size = Variable(
        f"backlash_{v.name}", v.unit, 0.0, 5.0 * v.scale, WIDTH * v.scale, WIDTH * v.scale, "width of the play"
    )
    says = f"what {v.name} drives follows it only after some play (backlash, stiction) whenever it turns round"
    formula = f"{v.name} with a play of {{{size.name}}}"
    return Series(f"backlash@{v.name}", says, Port("input", v.name), (size,), series=series, formula=formula)


def dead_zone_unequal(index: int, v: Variable) -> Term:
    """A dead zone that is not as wide below zero as above."""

    def term(x: Array, u: Array, theta: Array) -> float:
        return -min(max(u[index], -theta[-1] * theta[-2]), theta[-2])

    size = _width(v, "dead_zone_unequal")
    name = f"dead_zone_unequal_backward_{v.name}"
    ratio = Variable(name, "1", 0.0, 3.0, 0.5, 0.5, "width below zero over width above")
    says = f"small values of {v.name} have no effect, and the dead zone is not the same on both sides"
    formula = f"{v.name} less {{{size.name}}} above 0 and {{{size.name}}} {{{name}}} below"
    port = Port("input", v.name)
    contains = f"dead_zone@{v.name}"
    name = f"dead_zone_unequal@{v.name}"
    return Term(name, says, port, (size, ratio), term=term, formula=formula, contains=contains)


def flux_dead_zone(v: Variable) -> Term:
    """A flux that does not flow until what drives it would give more than a width."""

    def term(x: Array, u: Array, theta: Array, own: float) -> float:
        return -min(max(own, -theta[-1]), theta[-1])

    size = _width(v, "dead_zone")
    says = f"{v.name} does not flow until it would exceed a width (dead zone), and is that much less beyond"
    formula = f"{v.name} less {{{size.name}}} either side of 0"
    port = Port("flux", v.name)
    return Term(f"dead_zone@{v.name}", says, port, (size,), term=term, formula=formula, sees_own=True)


def flux_saturation(v: Variable) -> Term:
    """A flux that does not go beyond its limits: one above, the same on both sides, or one on each side."""

    def above(x: Array, u: Array, theta: Array, own: float) -> float:
        return -theta[-2] * max(0.0, own - theta[-1])

    def either(x: Array, u: Array, theta: Array, own: float) -> float:
        return -theta[-2] * (max(0.0, own - theta[-1]) - max(0.0, -theta[-1] - own))

    def both(x: Array, u: Array, theta: Array, own: float) -> float:
        return -theta[-3] * (max(0.0, own - theta[-1]) - max(0.0, theta[-2] - own))

    limits = knees(v, "saturation", lower=v.low < 0.0)
    term = both if len(limits) > 1 else either if v.low < 0.0 else above
    size = Variable(f"saturation_{v.name}", "1", 0.0, 1.0, IN_FORCE, IN_FORCE, "part of the excess that does not flow")
    names = " and ".join("{" + limit.name + "}" for limit in limits)
    says = f"{v.name} does not go beyond {'a limit' if len(limits) == 1 else 'its limits'} (saturation)"
    formula = f"{v.name} less {{{size.name}}} of what is beyond {'+-' if term is either else ''}{names}"
    port = Port("flux", v.name)
    return Term(f"saturation@{v.name}", says, port, (size, *limits), term=term, formula=formula, sees_own=True)


def unchoked(v: Variable, up: Pressure, down: Pressure) -> Term:
    """A flow that the simulator takes as choked, in proportion to the pressure before it, and which is not always.

    Beyond the critical ratio r_c of the pressures it falls as ISO 6358 says, with sqrt(1 - ((r - r_c)/(1 - r_c))^2).
    """
    before, before_u, behind, behind_u = up.at, up.is_input, down.at, down.is_input
    names = up.variable.name, down.variable.name

    def term(x: Array, u: Array, theta: Array, own: float) -> float:
        high = u[before] if before_u else x[before]
        low = u[behind] if behind_u else x[behind]
        share = min(max((low / high - theta[-1]) / (1.0 - theta[-1]), 0.0), 1.0) if high > 0.0 else 1.0
        return -theta[-2] * own * (1.0 - math.sqrt(1.0 - share * share))

    effect = f"unchoked_by_{names[1]}"
    size = Variable(f"{effect}_{v.name}", "1", 0.0, 1.0, IN_FORCE, IN_FORCE, "part of the law that holds")
    within = Range(0.2, 0.7, CRITICAL_RATIO)
    shape = f"{effect}_ratio_{v.name}"
    ratio = Variable(shape, "1", *within, (within.high - within.low) / 6.0, "critical ratio of the pressures")
    says = f"{v.name} is no longer choked when {names[1]} comes near {names[0]}, and falls"
    formula = f"{v.name} (1 - {{{size.name}}} (1 - sqrt(1 - s^2))), s from {{{shape}}} to 1 of {names[1]}/{names[0]}"
    port = Port("flux", v.name)
    return Term(f"{effect}@{v.name}", says, port, (size, ratio), term=term, formula=formula, sees_own=True)


def unchokes(up: Pressure, down: Pressure) -> bool:
    """May the pressures' ratio come above the critical one, within two scales of where they are?"""
    least = max(up.variable.low, up.variable.nominal - 2.0 * up.variable.scale)
    most = min(down.variable.high, down.variable.nominal + 2.0 * down.variable.scale)
    return most > CRITICAL_RATIO * least


def knees(v: Variable, effect: str, lower: bool) -> tuple[Variable, ...]:
    """Where a channel saturates: at one limit if it is symmetrical, else at one above, and one below if ``lower``."""
    half = 0.5 * v.scale
    if v.low == -v.high:
        reach = abs(v.nominal)
        least = max(reach - OFTEN * v.scale, OFTEN * half)
        within = Range(min(least, v.high), min(v.high, reach + OUTERMOST * v.scale), reach + half)
        return (knee(v, f"{effect}_limit", within, f"largest magnitude of {v.name}"),)
    within = upper_limit(v)
    above = knee(v, f"{effect}_limit", within, f"highest value of {v.name}")
    if not lower:
        return (above,)
    most = min(v.high, v.nominal + OFTEN * v.scale)
    below = Range(max(v.low, v.nominal - OUTERMOST * v.scale), most, max(v.low, v.nominal - half))
    return (knee(v, f"{effect}_lower_limit", below, f"lowest value of {v.name}"), above)


def upper_limit(v: Variable) -> Range:
    """Where a channel saturates: from a little below its middle on, typically half a scale above."""
    low, high = max(v.low, v.nominal - OFTEN * v.scale), min(v.high, v.nominal + OUTERMOST * v.scale)
    return Range(low, high, min(v.nominal + 0.5 * v.scale, high))


def knee(v: Variable, what: str, within: Range, says: str) -> Variable:
    """One of a channel's limits."""
    typical = min(max(within.typical, within.low), within.high)
    return Variable(f"{what}_{v.name}", v.unit, within.low, within.high, typical, v.scale, says)


def _width(v: Variable, effect: str) -> Variable:
    return Variable(
        f"{effect}_{v.name}", v.unit, 0.0, 5.0 * v.scale, WIDTH * v.scale, WIDTH * v.scale, "half its width"
    )
