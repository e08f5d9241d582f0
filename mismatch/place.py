"""A state whose balance may lack something: what is common there, and how an effect is put there."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

from twinbench.physics.simulator import Port, Term, Variable

Rate = Callable[..., float]
"""What a term adds to a balance: ``rate(x, u, theta)``, or ``rate(x, u, theta, own)`` if it sees the balance itself."""
TYPICAL_SHARE = 0.1
"""A typical effect changes a balance by this share of what commonly moves it."""
IN_FORCE = 0.8
"""A law that holds or does not, as saturation: typically so much of it is there."""
CLOCK = "clock"
"""A mechanism's own state whose name begins so goes by the recordings' clock."""
GENEROUS = 100.0
"""A size may grow to this many times its typical value."""


class Range(NamedTuple):
    """What a parameter may be, and what it typically is."""

    low: float
    high: float
    typical: float


@dataclass(frozen=True)
class Place:
    """A state whose balance may lack something; it commonly changes by ``rate``, in its unit per second."""

    index: int
    variable: Variable
    rate: float

    @property
    def name(self) -> str:
        return self.variable.name

    @property
    def unit(self) -> str:
        """The state's unit, ready to stand in a product."""
        return bracketed(self.variable.unit)

    @property
    def tau_s(self) -> float:
        """Time in which the state commonly moves by its scale."""
        return self.variable.scale / self.rate

    @property
    def reach(self) -> float:
        """A common magnitude of the state."""
        return max(abs(self.variable.nominal), self.variable.scale)

    def size(self, effect: str, unit: str, at: float = 1.0, low: float = 0.0, generous: float = GENEROUS) -> Variable:
        """An effect's size, such that it is common where ``at`` is what the size multiplies.

        ``low`` is in shares of the upper bound: 0 or -1.
        """
        typical = TYPICAL_SHARE * self.rate / at
        what, _, source = effect.partition("_from_")
        high, says = generous * typical, f"size of the {what.replace('_', ' ')}{f' from {source}' if source else ''}"
        return Variable(f"{effect}_{self.name}", _without_ones(unit), low * high, high, typical, typical, says)

    def shape(self, effect: str, what: str, unit: str, within: Range, says: str) -> Variable:
        """A parameter that shapes an effect: a threshold, a time constant."""
        name, (low, high, typical) = f"{effect}_{what}_{self.name}", within
        return Variable(name, _without_ones(unit), low, high, min(max(typical, low), high), (high - low) / 6.0, says)

    def add(self, effect: str, says: str, formula: str, term: Rate, *parameters: Variable, **more: Any) -> Term:
        """The mechanism; ``{0}``, ``{1}`` in the formula become its parameters' names, ``{x}`` the state's.

        Args:
            more: fields of the ``Term`` by name.
        """
        names = ["{" + v.name + "}" for v in parameters]
        name, port = f"{effect}@{self.name}", Port("balance", self.name)
        return Term(name, says, port, parameters, term=term, formula=formula.format(*names, x=self.name), **more)


def bracketed(unit: str) -> str:
    """A unit that can stand in a product or quotient; 1 of what has none."""
    return f"({unit})" if set(unit) & set(" /*") else unit or "1"


def _without_ones(unit: str) -> str:
    """A quotient of units in which nothing is divided by 1: ``1/s/1^3`` is ``1/s``."""
    first, *rest = unit.removeprefix("1 ").split("/")
    one = re.compile(r"1(\^[\d.]+)?")
    return "/".join(["1" if one.fullmatch(first) else first, *(part for part in rest if not one.fullmatch(part))])
