"""Terms that any machine can lack: each function makes one ``Mechanism`` at a place.

``theta[-1]`` is a term's last parameter, ``x[-1]`` its own state: a mechanism's own entries stand last.
"""

from __future__ import annotations

import math

import numpy as np

from twinbench.mismatch.limits import OUTERMOST
from twinbench.mismatch.place import CLOCK, TYPICAL_SHARE, Place, Range, bracketed
from twinbench.physics.simulator import Array, Term, Variable

RIM = 1000.0
"""What runs over a rim may grow to this many times its typical value."""
SLOWEST, FASTEST = -0.8, 4.0
"""A wrong time constant: from a fifth of the speed to five times the speed."""


def offset(p: Place) -> Term:
    def term(x: Array, u: Array, theta: Array) -> float:
        return theta[-1]

    says = f"something unknown adds to {p.name}, or takes from it, at a constant rate"
    return p.add("offset", says, "{0}", term, p.size("offset", f"{p.unit}/s", low=-1.0))


def linear(p: Place, effect: str, words: str) -> Term:
    i = p.index

    def term(x: Array, u: Array, theta: Array) -> float:
        return -theta[-1] * x[i]

    says = f"{words} in proportion to {p.name} takes from it"
    return p.add(effect, says, "-{0} {x}", term, p.size(effect, "1/s", p.reach))


def quadratic(p: Place, effect: str, words: str) -> Term:
    i = p.index

    def term(x: Array, u: Array, theta: Array) -> float:
        return -theta[-1] * x[i] * abs(x[i])

    says = f"{words} that grows with the square of {p.name} takes from it"
    size = p.size(effect, f"1/{p.unit}/s", p.reach**2)
    return p.add(effect, says, "-{0} {x} |{x}|", term, size)


def cubic(p: Place, effect: str, words: str) -> Term:
    i = p.index

    def term(x: Array, u: Array, theta: Array) -> float:
        return -theta[-1] * x[i] * x[i] * x[i]

    says = f"{words} that grows with the cube of {p.name} takes from it"
    size = p.size(effect, f"1/{p.unit}^2/s", p.reach**3)
    return p.add(effect, says, "-{0} {x}^3", term, size)


def hardening_spring(p: Place, position: int, of: Variable) -> Term:
    """On the balance of a velocity, by the position that it moves."""

    def term(x: Array, u: Array, theta: Array) -> float:
        return -theta[-1] * x[position] * x[position] * x[position]

    says = f"a spring pulls {of.name} back and hardens with its cube"
    size = p.size("hardening_spring", f"{p.unit}/s/{bracketed(of.unit)}^3", max(abs(of.nominal), of.scale) ** 3)
    return p.add("hardening_spring", says, f"-{{0}} {of.name}^3", term, size)


def spring_backlash(p: Place, position: int, of: Variable) -> Term:
    """A stop on either side of a free play: no force inside the gap."""

    def term(x: Array, u: Array, theta: Array) -> float:
        q = x[position]
        return -theta[-2] * (q - min(max(q, -theta[-1]), theta[-1]))

    says = f"{of.name} has free play (backlash) and meets a spring beyond it"
    size = p.size("backlash", f"{p.unit}/s/{bracketed(of.unit)}", of.scale)
    gap = p.shape("backlash", "gap", of.unit, Range(0.0, 2.0 * of.scale, 0.5 * of.scale), "half the free play")
    return p.add("backlash", says, f"-{{0}} ({of.name} beyond +-{{1}})", term, size, gap)


def leak(p: Place) -> Term:
    """Outflow by Torricelli's law, to a level or pressure that a fit finds."""
    i = p.index

    def term(x: Array, u: Array, theta: Array) -> float:
        return -theta[-2] * math.sqrt(max(x[i] - theta[-1], 0.0))

    v = p.variable
    says = f"{p.name} leaks through an opening, with the square root of what drives it"
    size = p.size("leak", f"{p.unit}^0.5/s", math.sqrt(p.reach))
    floor = max(v.low, 0.0)  # an opening may be at any height, and drain to below the floor
    within = Range(floor - v.scale, max(floor, v.nominal) + v.scale, floor)
    to = p.shape("leak", "to", v.unit, within, f"{p.name} at which the leak ends")
    return p.add("leak", says, "-{0} sqrt(max(0, {x} - {1}))", term, size, to)


def overflow(p: Place) -> Term:
    i = p.index

    def term(x: Array, u: Array, theta: Array) -> float:
        return -theta[-2] * max(0.0, x[i] - theta[-1])

    says = f"{p.name} overflows, or a relief opens, above a limit"
    return p.add("overflow", says, "-{0} max(0, {x} - {1})", term, *_above(p, "overflow", p))


def spill(p: Place, source: Place) -> Term:
    """What overflows at one state runs into the next."""
    j = source.index

    def term(x: Array, u: Array, theta: Array) -> float:
        return theta[-2] * max(0.0, x[j] - theta[-1])

    says = f"what overflows from {source.name} runs into {p.name}"
    formula = f"{{0}} max(0, {source.name} - {{1}})"
    return p.add(f"spill_from_{source.name}", says, formula, term, *_above(p, f"spill_from_{source.name}", source))


def time_constant(p: Place) -> Term:
    """The whole rate is multiplied: a wrong inertia, capacity or time constant that no parameter stands for."""

    def term(x: Array, u: Array, theta: Array, own: float) -> float:
        return theta[-1] * own

    says = f"{p.name} moves faster or slower than its balance says: an inertia, a capacity or a time constant is wrong"
    size = Variable(f"time_constant_{p.name}", "1", SLOWEST, FASTEST, TYPICAL_SHARE, TYPICAL_SHARE, "part of its rate")
    return p.add("time_constant", says, "{0} d({x})/dt", term, size, sees_own=True)


def periodic(p: Place, periods_s: tuple[float, float, float] | None) -> Term:
    """A sine in time, from a clock of its own; ``periods_s`` are the least, a typical and the greatest period."""

    def term(x: Array, u: Array, theta: Array) -> float:
        return theta[-3] * math.sin(2.0 * math.pi * x[-1] / theta[-2] + theta[-1])

    def derivative(x: Array, u: Array, theta: Array) -> Array:
        return np.array([1.0])

    says = f"something drives {p.name} to and fro with a fixed period"
    size = p.size("periodic", f"{p.unit}/s")
    least, typical, greatest = periods_s or (p.tau_s, 10.0 * p.tau_s, 100.0 * p.tau_s)
    period = p.shape("periodic", "period_s", "s", Range(least, greatest, typical), "period")
    phase = p.shape("periodic", "phase", "rad", Range(-math.pi, math.pi, 0.0), "phase when the recordings' clock began")
    clock = Variable(f"{CLOCK}_{p.name}", "s", -math.inf, math.inf, 0.0, p.tau_s, "time by the recordings' clock")
    memory = {"states": (clock,), "derivative": derivative}
    return p.add("periodic", says, "{0} sin(2 pi t/{1} + {2})", term, size, period, phase, **memory)


def _above(p: Place, effect: str, of: Place) -> tuple[Variable, Variable]:
    """Size and threshold of what happens to a balance when a state exceeds a limit."""
    v = of.variable
    low, high = max(v.low, v.nominal - v.scale), min(v.high, v.nominal + OUTERMOST * v.scale)
    limit = p.shape(
        effect, "above", v.unit, Range(low, high, v.nominal + 0.5 * v.scale), f"{v.name} at which it begins"
    )
    # Over a rim all runs off that comes.
    return p.size(effect, "1/s", v.scale, generous=RIM), limit
