"""How large what is named is, and how sure that is; sizes at a balance of forces or heat as those."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Any

import numpy as np

from twinbench.mismatch.diagnosis import Diagnosis
from twinbench.mismatch.force import as_force, inertia
from twinbench.mismatch.mixture import Z90, having, interval_of, near, numbers_of
from twinbench.mismatch.naming.settle import Settled
from twinbench.mismatch.words import digits_worth, interval, number, spoken, with_unit
from twinbench.physics.simulator import Mechanism, Term


@dataclass(frozen=True)
class Value:
    """A number with its 90 % interval; ``before`` for what a parameter was, ``says`` for what it is."""

    name: str
    value: float
    low: float
    high: float
    unit: str
    before: float | None = None
    says: str = ""

    def words(self, of: str = "") -> str:
        """How large it is and, after what the interval is ``of``, how sure that is."""
        digits = digits_worth(self.value, self.low, self.high)
        return f"{with_unit(self.value, self.unit, digits)} ({of}{interval(self.low, self.high, digits)})"

    @property
    def plain(self) -> dict[str, Any]:
        """As JSON has it."""
        return {"value": self.value, "low": self.low, "high": self.high, "unit": self.unit}


def sizes(d: Diagnosis, place: int) -> tuple[Value, ...]:
    """An effect's parameters as the chosen hypothesis has them; intervals from all hypotheses that have the effect.

    Args:
        place: of the effect in the chosen hypothesis.
    """
    chosen = d.answer.chosen
    which = chosen.effects[place].variant.candidate
    mechanism = d.machine.candidates[which].mechanism
    those = having(d.answer.naming.hypotheses, which)
    numbers = [numbers_of(h, h.candidates.index(which)) for h in those]
    found = []
    for k, (v, (value, _)) in enumerate(zip(mechanism.parameters, numbers_of(chosen, place), strict=True)):
        low, high = interval_of(those, [n[k] for n in numbers], v.low, v.high)
        found.append(Value(v.name, value, min(low, value), max(high, value), v.unit, says=v.says))
    return tuple(found)


def parameters(d: Diagnosis) -> tuple[Value, ...]:
    """The simulator's parameters as the accepted hypothesis has them; intervals from all hypotheses."""
    accepted = d.accepted
    every = near([*d.answer.naming.hypotheses])
    spreads = [np.sqrt(np.diag(h.cov)) for h in every]
    found = []
    for k, u in enumerate(accepted.problem.unknowns):
        if u.kind == "parameter":
            v, value, sd = d.simulator.parameters[u.at], float(accepted.at[k]), u.spread
            numbers = [(float(h.at[k]), float(s[k] * sd)) for h, s in zip(every, spreads, strict=True)]
            low, high = interval_of(every, numbers, v.low, v.high)
            found.append(Value(v.name, value, min(low, value), max(high, value), v.unit, v.nominal, v.says))
    return tuple(found)


def all_values(hypothesis: Settled, place: int) -> dict[str, float]:
    """An effect's parameters by name, as a hypothesis has them."""
    mechanism = hypothesis.problem.machine.candidates[hypothesis.candidates[place]].mechanism
    pairs = zip(mechanism.parameters, numbers_of(hypothesis, place), strict=True)
    return {v.name: value for v, (value, _) in pairs}


def force(d: Diagnosis, place: int) -> Value | None:
    """A size at a balance of forces or heat, times the inertia or capacity as fitted; they are uncertain together."""
    chosen = d.answer.chosen
    mechanism = d.machine.candidates[chosen.effects[place].variant.candidate].mechanism
    if not isinstance(mechanism, Term) or mechanism.port.place != "balance":
        return None
    of, size = inertia(d.simulator, mechanism.port.index(d.simulator)), mechanism.parameters[0]
    unit = as_force(size.unit, d.simulator, mechanism.port.index(d.simulator), of) if of else None
    if of is None or unit is None:
        return None
    at, spreads = chosen.entries(place)[0], chosen.problem.spreads
    cov = chosen.cov * np.outer(spreads, spreads)  # each unknown in its own unit
    x, mass = float(chosen.at[at]), of.parameter.nominal
    variance = mass**2 * cov[at, at]
    for k, u in enumerate(chosen.problem.unknowns):
        if u.kind == "parameter" and u.at == of.at:
            mass = float(chosen.at[k])
            variance = mass**2 * cov[at, at] + x**2 * cov[k, k] + 2.0 * mass * x * cov[k, at]
    value, spread = unit[0] * mass * x, Z90 * abs(unit[0]) * float(np.sqrt(max(variance, 0.0)))
    says = f"as a {of.word}, with {of.parameter.name} at {number(mass)} {spoken(of.parameter.unit)}"
    return Value(f"{size.name} as a {of.word}", value, value - spread, value + spread, unit[1], says=says)


def formula(mechanism: Mechanism, values: tuple[Value, ...]) -> str:
    """The term with its fitted values."""
    filled = {v.name: with_unit(v.value, v.unit) for v in values}
    return re.sub(r"\{(\w+)\}", lambda m: filled.get(m[1], m[0]), mechanism.formula)
