"""Friction of a state that moves: terms that depend on which way it goes, and on where it came from."""

from __future__ import annotations

import math

import numpy as np

from twinbench.mismatch.place import Place, Range
from twinbench.physics.simulator import Array, Term, Variable

DRY = "coulomb_friction"
"""What the others are where they are plainest."""
SMOOTH = 0.05
"""Dry friction turns round within this many scales of standstill, so that it can be integrated."""
TURN_ROUND = 0.1
"""A hysteretic force turns round no faster than in this share of the state's own time, so that it is not stiff."""


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
    return p.add(effect, says, "-{0} ({x} > 0), +{0} {1} ({x} < 0)", term, size, ratio, contains=simpler)


def hysteresis(p: Place) -> Term:
    """Bouc-Wen: a force that builds up over a distance of travel and stays when travel stops."""
    i, limit_s = p.index, TURN_ROUND * p.tau_s

    def term(x: Array, u: Array, theta: Array) -> float:
        return -theta[-2] * x[-1]

    def derivative(x: Array, u: Array, theta: Array) -> Array:
        # The force turns round no faster than 1/limit_s, however short the distance: else it is stiff.
        return np.array([(x[i] - abs(x[i]) * x[-1]) / (theta[-1] + limit_s * abs(x[i]))])

    says = f"a hysteretic force acts against {p.name}: it depends on which way the machine came"
    size = p.size("hysteresis", f"{p.unit}/s")
    reach = p.shape("hysteresis", "travel", _travelled(p), _travel(p), "travel to full force")
    formula = "-{0} z, z' = ({x} - |{x}| z)/{1}"
    # Over a short travel it is dry friction.
    more = {"states": (_force_of(p, "hysteresis"),), "derivative": derivative, "contains": f"{DRY}@{p.name}"}
    return p.add("hysteresis", says, formula, term, size, reach, **more)


def bouc_wen(p: Place) -> Term:
    """Hysteresis whose loop may be round or sharp (exponent), slim or thick (the share of gamma in beta + gamma)."""
    i, limit_s = p.index, TURN_ROUND * p.tau_s

    def term(x: Array, u: Array, theta: Array) -> float:
        return -theta[-4] * x[-1]

    def derivative(x: Array, u: Array, theta: Array) -> Array:
        travel, exponent, gamma = theta[-3], theta[-2], theta[-1]
        speed, built = abs(x[i]), abs(x[-1]) ** exponent
        back = (1.0 - gamma) * speed * math.copysign(built, x[-1]) + gamma * x[i] * built
        return np.array([(x[i] - back) / (travel + limit_s * speed)])

    effect = "bouc_wen_hysteresis"
    says = f"a hysteretic force with a loop of any shape (Bouc-Wen) acts against {p.name}"
    parameters = (
        p.size(effect, f"{p.unit}/s"),
        p.shape(effect, "travel", _travelled(p), _travel(p), "travel to full force"),
        p.shape(effect, "exponent", "1", Range(1.0, 5.0, 2.0), "how sharply the full force is reached"),
        p.shape(effect, "gamma", "1", Range(-0.5, 0.5, 0.25), "gamma over beta + gamma: at 0.5 it unloads straight"),
    )
    formula = "-{0} z, z' = ({x} - (1 - {3}) |{x}| |z|^({2} - 1) z - {3} {x} |z|^{2})/{1}"
    more = {"states": (_force_of(p, effect),), "derivative": derivative, "contains": f"{DRY}@{p.name}"}
    return p.add(effect, says, formula, term, *parameters, **more)


def stribeck(p: Place) -> Term:
    """Dry friction that is larger at low speed, where the oil does not yet carry."""
    i, width = p.index, SMOOTH * p.variable.scale

    def term(x: Array, u: Array, theta: Array) -> float:
        bump = theta[-2] * math.exp(-((x[i] / theta[-1]) ** 2))
        return -theta[-3] * (1.0 + bump) * math.tanh(x[i] / width)

    effect, scale = "stribeck_friction", p.variable.scale
    says = f"dry friction acts against {p.name} and is larger at low speed (Stribeck)"
    parameters = (
        p.size(effect, f"{p.unit}/s"),
        p.shape(effect, "bump", "1", Range(0.0, 3.0, 1.0), "friction at standstill over that at speed, less one"),
        p.shape(effect, "speed", p.variable.unit, Range(0.1 * scale, scale, 0.3 * scale), "how far the bump reaches"),
    )
    formula = "-{0} (1 + {1} exp(-({x}/{2})^2)) sign({x})"
    return p.add(effect, says, formula, term, *parameters, contains=f"{DRY}@{p.name}")


def _travelled(p: Place) -> str:
    """Unit of the way that a speed goes."""
    return p.variable.unit.removesuffix("/s") if p.variable.unit.endswith("/s") else f"{p.unit} s"


def _travel(p: Place) -> Range:
    """The way to full force."""
    common = p.variable.scale * p.tau_s
    return Range(0.05 * common, 5.0 * common, 0.5 * common)


def _force_of(p: Place, effect: str) -> Variable:
    return Variable(f"{effect}_force_{p.name}", "1", -1.0, 1.0, 0.0, 0.5, "hysteretic force over its largest")
