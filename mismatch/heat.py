"""Heat that a temperature's balance lacks: to the surroundings, to a mass beside it, to another temperature.

Sizes are rates of the temperature itself. Where its heat capacity is known, ``mismatch.force`` says them in watts.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from twinbench.mismatch.force import inertia
from twinbench.mismatch.natures import AMBIENT, TEMPERATURES, Thermometer
from twinbench.mismatch.place import Memory, Place, Range, Rate
from twinbench.mismatch.structure import depends
from twinbench.physics.simulator import Array, Port, Simulator, Term, Variable


class Ambient(NamedTuple):
    """The machine's own ambient temperature: an input or a parameter, and where it stands among those."""

    kind: str
    at: int
    name: str


def thermal(p: Place, simulator: Simulator) -> list[Term]:
    """What any temperature may lack by itself."""
    ambient, scale = _ambient(p, simulator), TEMPERATURES[p.variable.unit]
    return [loss_to_ambient(p, ambient, scale), radiation(p, ambient, scale), second_thermal_mass(p)]


def _ambient(p: Place, simulator: Simulator) -> Ambient | None:
    """Known by its name and the temperature's own unit."""
    for kind, variables in (("input", simulator.inputs), ("parameter", simulator.parameters)):
        for at, v in enumerate(variables):
            if AMBIENT.search(v.name.lower()) and v.unit == p.variable.unit:
                return Ambient(kind, at, v.name)
    return None


def loss_to_ambient(p: Place, ambient: Ambient | None, scale: Thermometer) -> Term:
    """Heat lost in proportion to the excess over the ambient; a constant one is fitted where the machine has none."""
    i = p.index
    at = ambient.at if ambient else -1

    def to_input(x: Array, u: Array, theta: Array) -> float:
        return -theta[-1] * (x[i] - u[at])

    def to_parameter(x: Array, u: Array, theta: Array) -> float:
        return -theta[-1] * (x[i] - theta[at])

    def to_unknown(x: Array, u: Array, theta: Array) -> float:
        return -theta[-2] * (x[i] - theta[-1])

    effect = "loss_to_ambient"
    term, formula, says, shape = _towards(p, effect, ambient, scale, (to_input, to_parameter, to_unknown))
    size = p.size(effect, "1/s", p.variable.scale)
    return p.add(effect, f"{p.name} loses heat to {says}", f"-{{0}} ({{x}} - {formula})", term, size, *shape)


def radiation(p: Place, ambient: Ambient | None, scale: Thermometer) -> Term:
    """Heat radiated to the ambient: the difference of the fourth powers in kelvin (Stefan-Boltzmann)."""
    i, per_unit, zero_K = p.index, scale.per_unit, scale.zero_K
    at = ambient.at if ambient else -1

    def to_input(x: Array, u: Array, theta: Array) -> float:
        return -theta[-1] * ((per_unit * x[i] + zero_K) ** 4 - (per_unit * u[at] + zero_K) ** 4)

    def to_parameter(x: Array, u: Array, theta: Array) -> float:
        return -theta[-1] * ((per_unit * x[i] + zero_K) ** 4 - (per_unit * theta[at] + zero_K) ** 4)

    def to_unknown(x: Array, u: Array, theta: Array) -> float:
        return -theta[-2] * ((per_unit * x[i] + zero_K) ** 4 - (per_unit * theta[-1] + zero_K) ** 4)

    effect = "radiation"
    term, formula, says, shape = _towards(p, effect, ambient, scale, (to_input, to_parameter, to_unknown))
    # What one scale of the temperature does to its fourth power.
    step = 4.0 * (per_unit * p.variable.nominal + zero_K) ** 3 * per_unit * p.variable.scale
    size = p.size(effect, f"{p.unit}/s/K^4", step)
    return p.add(
        effect, f"{p.name} radiates heat to {says}", f"-{{0}} ({{x}}^4 - {formula}^4, in K)", term, size, *shape
    )


def _towards(
    p: Place, effect: str, ambient: Ambient | None, scale: Thermometer, terms: tuple[Rate, Rate, Rate]
) -> tuple[Rate, str, str, tuple[Variable, ...]]:
    """The term of ``terms`` for this ambient, its name in formula and in words, and its temperature if it is fitted."""
    if ambient is not None:
        return terms[0 if ambient.kind == "input" else 1], ambient.name, "the surroundings", ()
    within = Range(scale.cold, scale.hot, scale.common)
    shape = p.shape(effect, "temperature", p.variable.unit, within, "ambient temperature")
    return terms[2], "{1}", "surroundings of constant temperature", (shape,)


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


def exchanges(simulator: Simulator, places: list[Place]) -> list[Term]:
    """Heat between two temperatures that the equations do not couple.

    Where both heat capacities are known, what leaves one enters the other. Where they are not, one temperature may
    follow the other by itself, and so may the other.
    """
    warm = [p for p in places if p.variable.unit in TEMPERATURES]
    found = []
    for k, p in enumerate(warm):
        for q in warm[k + 1 :]:
            coupled = depends(simulator, p.index, q.index) or depends(simulator, q.index, p.index)
            if coupled or p.variable.unit != q.variable.unit:
                continue
            capacities = inertia(simulator, p.index), inertia(simulator, q.index)
            if capacities[0] is not None and capacities[1] is not None:
                found.append(_over(heat_from(p, q), q, capacities[0].at, capacities[1].at))
            else:
                found += [heat_from(p, q), heat_from(q, p)]
    return found


def heat_from(p: Place, q: Place) -> Term:
    """Heat that a temperature takes from another, in proportion to their difference."""
    i, j = p.index, q.index

    def term(x: Array, u: Array, theta: Array) -> float:
        return theta[-1] * (x[j] - x[i])

    effect = f"heat_from_{q.name}"
    says = f"{p.name} exchanges heat with {q.name}"
    return p.add(effect, says, f"{{0}} ({q.name} - {{x}})", term, p.size(effect, "1/s", p.variable.scale))


def _over(exchange: Term, q: Place, capacity: int, other: int) -> Term:
    """The same heat out of the other temperature; where their heat capacities stand in theta."""

    def ratio(x: Array, u: Array, theta: Array) -> float:
        return theta[capacity] / theta[other]

    return replace(
        exchange,
        says=f"{exchange.says}, which loses what it gets",
        into=Port("balance", q.name),
        ratio=ratio,
    )
