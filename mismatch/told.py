"""What a user knows beforehand: what it is not, what is likely, and how noisy a measured input is."""

from __future__ import annotations

import difflib
import math
import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from fnmatch import fnmatchcase
from typing import TypedDict

import numpy as np

from twinbench.common.errors import BadInput
from twinbench.common.shown import shown
from twinbench.data.units import convert
from twinbench.physics.simulator import Mechanism, Simulator

_MEASURED = re.compile(r"([^=]+)=\s*([-+]?[\d.]+(?:[eE][-+]?\d+)?)\s*(.*)")
_PLAIN = ("", "1", "-")
"""Units of numbers without one."""


class Knowledge(TypedDict, total=False):
    """The fields of ``Told`` as keywords."""

    leave_out: Sequence[str]
    prior: Mapping[str, float]
    measured: Mapping[str, float]


@dataclass(frozen=True)
class Told:
    """What was told.

    Attributes:
        leave_out: candidates that are not tried, by name or by a pattern with ``*``.
        prior: odds that a candidate is there against its absence, by its name; 1 is as likely as not.
        measured: standard deviation of the noise of an input that is measured and not set, by its name and in its unit.
    """

    leave_out: Sequence[str] = ()
    prior: Mapping[str, float] = field(default_factory=dict)
    measured: Mapping[str, float] = field(default_factory=dict)

    def check(self, simulator: Simulator, catalogue: Sequence[Mechanism]) -> None:
        """See that everything that is spoken of exists, and that numbers are what they have to be.

        Raises:
            BadInput: one line that says what is wrong and how to mend it.
        """
        if isinstance(self.leave_out, str):
            raise BadInput(f"leave out {shown(self.leave_out)}: give a list of names, as [{shown(self.leave_out)}]")
        names = [m.name for m in catalogue]
        for pattern in self.leave_out:
            if not any(fnmatchcase(name, pattern) for name in names):
                raise BadInput(f"leave out {shown(pattern)}: no candidate has that name{nearest(pattern, names)}")
        for name, odds in self.prior.items():
            if name not in names:
                raise BadInput(f"prior of {shown(name)}: no candidate has that name{nearest(name, names)}")
            if self._is_out(name):
                raise BadInput(f"prior of {shown(name)}: it is left out too; take one of the two back")
            if not (_is_number(odds) and odds > 0.0):
                raise BadInput(
                    f"prior of {shown(name)}: odds are {shown(odds)}, must be a number above 0; 0.1 is one to ten"
                )
        for name, sd in self.measured.items():
            v = next((v for v in simulator.inputs if v.name == name), None)
            if v is None:
                inputs = [v.name for v in simulator.inputs]
                raise BadInput(f"measured {shown(name)}: the simulator has no such input{nearest(name, inputs)}")
            if not (_is_number(sd) and sd > 0.0):
                raise BadInput(
                    f"measured {shown(name)}: its noise is {shown(sd)}, must be a number above 0, in {v.unit or '1'}; "
                    "an input without noise is not declared"
                )

    def left(self, catalogue: Sequence[Mechanism]) -> tuple[Mechanism, ...]:
        """The candidates that may be tried."""
        return tuple(m for m in catalogue if not self._is_out(m.name))

    def _is_out(self, name: str) -> bool:
        return any(fnmatchcase(name, pattern) for pattern in self.leave_out)


def read_told(leave_out: Sequence[str], prior: Sequence[str], measured: Sequence[str], simulator: Simulator) -> Told:
    """What the command line says.

    Args:
        leave_out: names, or patterns with ``*``.
        prior: each NAME=ODDS.
        measured: each INPUT=SD and a unit, as ``p_suc_bar=0.01bar``; without one only where the input has none.

    Raises:
        BadInput: a text of another form, an unknown input, or a unit that the input's cannot be made of.
    """
    return Told(tuple(leave_out), dict(map(_odds, prior)), dict(_noise(text, simulator) for text in measured))


def _odds(text: str) -> tuple[str, float]:
    name, _, odds = text.rpartition("=")
    try:
        return name, float(odds)
    except ValueError:
        raise BadInput(f"--prior {shown(text)}: must read NAME=ODDS, as overflow@h1_cm=0.1") from None


def _noise(text: str, simulator: Simulator) -> tuple[str, float]:
    where, found = f"--measured {shown(text)}", _MEASURED.fullmatch(text)
    units = {v.name: v.unit for v in simulator.inputs}
    if found is None:
        raise BadInput(f"{where}: must read INPUT=SD and a unit, as p_suc_bar=0.01bar")
    name, number, given = found[1].strip(), found[2], found[3].strip()
    if name not in units:
        raise BadInput(f"{where}: the simulator has no input {shown(name)}{nearest(name, units)}")
    unit = units[name]
    if not given and unit not in _PLAIN:
        raise BadInput(f"{where}: has no unit; write {name}={number}{unit} if that is what it is")
    try:
        sd = float(number)
    except ValueError:
        raise BadInput(f"{where}: {shown(number)} is no number; write INPUT=SD and a unit") from None
    if not given or (unit in _PLAIN and given in _PLAIN):
        return name, sd
    # A deviation is a difference: a zero of the unit's own does not count.
    ends = convert(np.array([0.0, sd]), given, unit, where)
    return name, float(ends[1] - ends[0])


def nearest(name: str, known: Collection[str]) -> str:
    """What may be meant, for the end of a message."""
    near = difflib.get_close_matches(name, known, n=1)
    if near:
        return f"; did you mean {near[0]!r}?"
    return f"; it has: {', '.join(known) or 'none'}" if len(known) <= 12 else "; see twinbench list mechanisms"


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)
