"""Terms that any machine can lack: each function makes one ``Mechanism`` at a place.

``theta[-1]`` is a term's last parameter, ``x[-1]`` its own state: a mechanism's own entries stand last.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from twinbench.mismatch.place import CLOCK, Memory, Place, Range, bracketed
from twinbench.mismatch.series import held, play
from twinbench.physics.simulator import Array, Port, Series, Term, Variable

RIM = 1000.0
"""What runs over a rim may grow to this many times its typical value."""
SMOOTH = 0.05
"""Dry friction turns round within this many scales of standstill, so that it can be integrated."""


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


def coulomb(p: Place, effect: str, words: str) -> Term:
    i, width = p.index, SMOOTH * p.variable.scale

    def term(x: Array, u: Array, theta: Array) -> float:
        return -theta[-1] * math.tanh(x[i] / width)

    says = f"{words} of constant size acts against {p.name}, whichever way it goes"
    return p.add(effect, says, "-{0} sign({x})", term, p.size(effect, f"{p.unit}/s"))


def coulomb_unequal(p: Place, effect: str, words: str) -> Term:
    i, width = p.index, SMOOTH * p.variable.scale

    def term(x: Array, u: Array, theta: Array) -> float:
        back = 1.0 if x[i] > 0.0 else theta[-1]
        return -theta[-2] * back * math.tanh(x[i] / width)

    says = f"{words} acts against {p.name} and is not the same in both directions"
    size = p.size(effect, f"{p.unit}/s")
    ratio = p.shape(effect, "backward", "1", Range(0.0, 3.0, 0.5), "size backward over size forward")
    simpler = f"{effect.removesuffix('_unequal')}@{p.name}"
    return replace(p.add(effect, says, "-{0} ({x} > 0), +{0} {1} ({x} < 0)", term, size, ratio), contains=simpler)


def hysteresis(p: Place) -> Term:
    """Bouc-Wen: a force that builds up over a distance of travel and stays when travel stops."""
    i, limit_s = p.index, 0.1 * p.tau_s

    def term(x: Array, u: Array, theta: Array) -> float:
        return -theta[-2] * x[-1]

    def derivative(x: Array, u: Array, theta: Array) -> Array:
        # The force turns round no faster than 1/limit_s, however short the distance: else it is stiff.
        return np.array([(x[i] - abs(x[i]) * x[-1]) / (theta[-1] + limit_s * abs(x[i]))])

    says = f"a hysteretic force acts against {p.name}: it depends on which way the machine came"
    travel = p.variable.scale * p.tau_s
    unit = p.variable.unit.removesuffix("/s") if p.variable.unit.endswith("/s") else f"{p.unit} s"
    size = p.size("hysteresis", f"{p.unit}/s")
    reach = p.shape(
        "hysteresis", "travel", unit, Range(0.05 * travel, 5.0 * travel, 0.5 * travel), "travel to full force"
    )
    own = Variable(f"hysteresis_force_{p.name}", "1", -1.0, 1.0, 0.0, 0.5, "hysteretic force over its largest")
    formula = "-{0} z, z' = ({x} - |{x}| z)/{1}"
    found = p.add("hysteresis", says, formula, term, size, reach, memory=Memory((own,), derivative))
    # Over a short travel it is dry friction.
    return replace(found, contains=f"coulomb_friction@{p.name}")


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
    floor = max(v.low, 0.0)
    to = p.shape(
        "leak", "to", v.unit, Range(floor - v.scale, floor + v.scale, floor), f"{p.name} at which the leak ends"
    )
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


def loss_to_ambient(p: Place, kind: str, at: int, ambient: str) -> Term:
    """Heat lost in proportion to the excess over an ambient that is an input or a parameter of the machine."""
    i = p.index

    def to_input(x: Array, u: Array, theta: Array) -> float:
        return -theta[-1] * (x[i] - u[at])

    def to_parameter(x: Array, u: Array, theta: Array) -> float:
        return -theta[-1] * (x[i] - theta[at])

    says = f"{p.name} loses heat to the surroundings"
    term = to_input if kind == "input" else to_parameter
    size = p.size("loss_to_ambient", "1/s", p.variable.scale)
    return p.add("loss_to_ambient", says, f"-{{0}} ({p.name} - {ambient})", term, size)


def loss_to_unknown_ambient(p: Place, low: float, high: float, typical: float) -> Term:
    i = p.index

    def term(x: Array, u: Array, theta: Array) -> float:
        return -theta[-2] * (x[i] - theta[-1])

    says = f"{p.name} loses heat to surroundings of constant temperature"
    size = p.size("loss_to_ambient", "1/s", p.variable.scale)
    ambient = p.shape(
        "loss_to_ambient", "temperature", p.variable.unit, Range(low, high, typical), "ambient temperature"
    )
    return p.add("loss_to_ambient", says, "-{0} ({x} - {1})", term, size, ambient)


def second_thermal_mass(p: Place) -> Term:
    i, v = p.index, p.variable

    def term(x: Array, u: Array, theta: Array) -> float:
        return -theta[-2] * (x[i] - x[-1])

    def derivative(x: Array, u: Array, theta: Array) -> Array:
        return np.array([(x[i] - x[-1]) / theta[-1]])

    def initial(x0: Array, u0: Array, theta: Array) -> Array:
        return np.array([x0[i]])

    says = f"a second thermal mass exchanges heat with {p.name}, which so follows changes late"
    size = p.size("second_thermal_mass", "1/s", v.scale)
    tau = p.shape(
        "second_thermal_mass", "tau_s", "s", Range(p.tau_s, 100.0 * p.tau_s, 10.0 * p.tau_s), "its time constant"
    )
    own = Variable(f"second_mass_{p.name}", v.unit, v.low, v.high, v.nominal, v.scale, "temperature of the second mass")
    formula = "-{0} ({x} - T_2), T_2' = ({x} - T_2)/{1}"
    memory = Memory((own,), derivative, initial)
    return p.add("second_thermal_mass", says, formula, term, size, tau, memory=memory)


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
    memory = Memory((clock,), derivative)
    return p.add("periodic", says, "{0} sin(2 pi t/{1} + {2})", term, size, period, phase, memory=memory)


def dead_zone(index: int, v: Variable) -> Term:
    """An input that does nothing until it exceeds a width."""

    def term(x: Array, u: Array, theta: Array) -> float:
        return -min(max(u[index], -theta[-1]), theta[-1])

    size = Variable(f"dead_zone_{v.name}", v.unit, 0.0, 5.0 * v.scale, 0.2 * v.scale, 0.2 * v.scale, "half its width")
    says = f"small values of {v.name} have no effect (dead zone), larger ones that much less"
    formula = f"{v.name} less {{{size.name}}} either side of 0"
    return Term(f"dead_zone@{v.name}", says, Port("input", v.name), (size,), term=term, formula=formula)


def backlash(v: Variable) -> Series:
    """An input that follows its command only when the play is used up."""

    def series(time_s: Array, values: Array, theta: Array) -> Array:
        return play(held(np.asarray(values, dtype=np.float64)), theta[0])

    size = Variable(f"backlash_{v.name}", v.unit, 0.0, 5.0 * v.scale, 0.2 * v.scale, 0.2 * v.scale, "width of the play")
    says = f"what {v.name} drives follows it only after some play (backlash, stiction) whenever it turns round"
    formula = f"{v.name} with a play of {{{size.name}}}"
    return Series(f"backlash@{v.name}", says, Port("input", v.name), (size,), series=series, formula=formula)


def _above(p: Place, effect: str, of: Place) -> tuple[Variable, Variable]:
    """Size and threshold of what happens to a balance when a state exceeds a limit."""
    v = of.variable
    low, high = max(v.low, v.nominal - v.scale), min(v.high, v.nominal + 1.5 * v.scale)
    limit = p.shape(
        effect, "above", v.unit, Range(low, high, v.nominal + 0.5 * v.scale), f"{v.name} at which it begins"
    )
    # Over a rim all runs off that comes.
    return p.size(effect, "1/s", v.scale, generous=RIM), limit
