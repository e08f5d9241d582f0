"""Heat that a temperature's balance lacks: to the surroundings, to a mass beside it, to another temperature.

Sizes are rates of the temperature itself. Where its heat capacity is known, ``mismatch.force`` says them in watts.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from twinbench.mismatch.force import inertia
from twinbench.mismatch.natures import AMBIENT, TEMPERATURES, Thermometer
from twinbench.mismatch.place import Place, Range
from twinbench.mismatch.structure import depends
from twinbench.physics.simulator import Array, Port, Simulator, Term, Variable


class Ambient(NamedTuple):
    """An ambient temperature: the machine's own, an input or a parameter, or one that is fitted.

    Attributes:
        at: where it stands among the inputs, or in theta.
        size_at: where the size of what goes to it stands in theta.
        name: in a formula; ``says`` in words.
    """

    at: int
    from_input: bool
    size_at: int
    name: str
    says: str


def thermal(p: Place, simulator: Simulator) -> list[Term]:
    """What any temperature may lack by itself."""
    ambient, scale = _ambient(p, simulator), TEMPERATURES[p.variable.unit]
    return [loss_to_ambient(p, ambient, scale), radiation(p, ambient, scale), second_thermal_mass(p)]


def _ambient(p: Place, simulator: Simulator) -> Ambient:
    """The machine's own is known by its name and the temperature's own unit."""
    for from_input, variables in ((True, simulator.inputs), (False, simulator.parameters)):
        for at, v in enumerate(variables):
            if AMBIENT.search(v.name.lower()) and v.unit == p.variable.unit:
                return Ambient(at, from_input, -1, v.name, "the surroundings")
    return Ambient(-1, False, -2, "{1}", "surroundings of constant temperature")


def loss_to_ambient(p: Place, ambient: Ambient, scale: Thermometer) -> Term:
    """Heat lost in proportion to the excess over the ambient; a constant one is fitted where the machine has none."""
    i, (at, from_input, size_at, name, where) = p.index, ambient

    def term(x: Array, u: Array, theta: Array) -> float:
        outside = u[at] if from_input else theta[at]
        return -theta[size_at] * (x[i] - outside)

    effect = "loss_to_ambient"
    parameters = p.size(effect, "1/s", p.variable.scale), *_fitted(p, effect, ambient, scale)
    return p.add(effect, f"{p.name} loses heat to {where}", f"-{{0}} ({{x}} - {name})", term, *parameters)


def radiation(p: Place, ambient: Ambient, scale: Thermometer) -> Term:
    """Heat radiated to the ambient: the difference of the fourth powers in kelvin (Stefan-Boltzmann)."""
    i, per_unit, zero_K = p.index, scale.per_unit, scale.zero_K
    at, from_input, size_at, name, where = ambient

    def term(x: Array, u: Array, theta: Array) -> float:
        outside = u[at] if from_input else theta[at]
        return -theta[size_at] * ((per_unit * x[i] + zero_K) ** 4 - (per_unit * outside + zero_K) ** 4)

    effect = "radiation"
    # What one scale of the temperature does to its fourth power.
    step = 4.0 * (per_unit * p.variable.nominal + zero_K) ** 3 * per_unit * p.variable.scale
    parameters = p.size(effect, f"{p.unit}/s/K^4", step), *_fitted(p, effect, ambient, scale)
    return p.add(effect, f"{p.name} radiates heat to {where}", f"-{{0}} ({{x}}^4 - {name}^4, in K)", term, *parameters)


def _fitted(p: Place, effect: str, ambient: Ambient, scale: Thermometer) -> tuple[Variable, ...]:
    """The ambient temperature, where the machine has none of its own."""
    if ambient.size_at == -1:
        return ()
    within = Range(scale.cold, scale.hot, scale.common)
    return (p.shape(effect, "temperature", p.variable.unit, within, "ambient temperature"),)


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
    memory = {"states": (own,), "derivative": derivative, "initial": initial}
    return p.add("second_thermal_mass", says, formula, term, size, tau, **memory)


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
