"""Units of the channels, and conversion from whatever a recording uses."""

from __future__ import annotations

import functools
import re
import unicodedata
from typing import Any

import numpy as np

from twinbench.common.errors import BadInput
from twinbench.common.shown import as_map, shown
from twinbench.machines.coordinates import Array
from twinbench.machines.machine import Machine
from twinbench.physics.simulator import Variable

Limits = tuple[float, float, str]
_IN_UNIT: dict[str, Limits] = {
    "bar": (0.05, 60.0, "is it barg, kPa, psi or MPa?"),
    "K": (200.0, 1200.0, "is it degC or degF?"),
    "rpm": (30.0, 60_000.0, "is it Hz or rad/s?"),
    "1": (-0.05, 1.5, "is it per cent?"),
    "kg/s": (0.0, 50.0, "is it kg/h, or g/s?"),
}
"""Where readings in a unit usually lie, and what they may be in otherwise."""
BEYOND_BOUNDS = 0.1
"""Of a channel's range: how far beyond its bounds the median of readings may lie, of sensors that read a little off."""

OTHERWISE = {
    "bar": ("barg", "psi", "psig", "kPa", "kPag", "MPa", "mbar", "Pa"),
    "K": ("degC", "degF"),
    "rpm": ("Hz", "rad/s"),
    "1": ("percent",),
    "kg/s": ("kg/h", "g/s", "kg/min", "lb/h", "t/h"),
    "cm": ("mm", "m"),
    "m": ("cm", "mm"),
    "V": ("mV", "kV"),
    "A": ("mA", "kA"),
    "rad/s": ("rpm", "Hz"),
    "W": ("kW",),
}
"""What else a channel of each unit is often recorded in, the usual ones first."""
ATMOSPHERE_BAR = 1.01325
"""What a gauge leaves out: the standard atmosphere. Where the air is thinner, absolute readings come out too high."""
_GAUGE = re.compile(r"(mbar|bar|kPa|MPa|Pa|psi)[ _]?\(?(g|a)\)?")
LONGEST_UNIT = 60
"""Characters of a unit; W/(m**2*K) has ten."""
# pint works out what it is given, 10**10**10 for as long as that takes. So it is given names of units with powers of
# one or two figures, 1 for nothing above the stroke, products, quotients and brackets; never a power of a power.
_NAME = r"[^\W\d_](?:[^\W\d]|\d{1,2}(?!\d))*"
_EXPONENT = r"(?:\*\*|\^)?-?\d{1,2}(?:\.\d{1,2})?(?!\d)"
_FACTOR = rf"\(*(?:1|%|‰|{_NAME}(?:{_EXPONENT})?)\)*"
_SPELLING = re.compile(rf"{_FACTOR}(?:[/*.· ]{_FACTOR})*")
_POWER = re.compile(r"(?<=[A-Za-z])(?=-?\d)")
_TORQUE = re.compile(r"\b([kmM]?)Nm\b")


@functools.cache
def _registry() -> Any:
    import pint

    registry: Any = pint.UnitRegistry(autoconvert_offset_to_baseunit=True)
    for unit in ("mbar", "bar", "kPa", "MPa", "Pa", "psi"):
        bars = float(registry.Quantity(1.0, unit).to("bar").magnitude)
        registry.define(f"{unit}a = {unit}")
        registry.define(f"{unit}g = {bars!r} * bar; offset: {ATMOSPHERE_BAR}")
    return registry


def units_of(machine: Machine) -> dict[str, str]:
    """The unit of each channel of a machine, by name."""
    return {v.name: v.unit for v in (*machine.plant.inputs, *machine.plant.outputs)}


def limits_of(machine: Machine) -> dict[str, Limits]:
    """Where the median of each channel of a machine has to lie, and what it may be in otherwise, by name."""
    return {v.name: _limits(v) for v in (*machine.plant.inputs, *machine.plant.outputs)}


def _limits(variable: Variable) -> Limits:
    if usual := _IN_UNIT.get(variable.unit):
        return min(usual[0], variable.low), max(usual[1], variable.high), usual[2]
    slack = BEYOND_BOUNDS * (variable.high - variable.low)
    return variable.low - slack, variable.high + slack, "is it in another unit?"


def short_unit(unit: str) -> str:
    """As people write it."""
    return "(no unit)" if unit in ("", "1") else unit


def convert(values: Array, given: str, wanted: str, where: str) -> Array:
    """Values in unit ``given`` to unit ``wanted``.

    Args:
        values: (N,) or of any shape, in the unit ``given``.
        where: the file and column, for the message.

    Raises:
        BadInput: an unknown unit, or one of another dimension.
    """
    if given == wanted:
        return values
    import pint

    ours, theirs = _unit(wanted, where), _unit(given, where)
    try:
        quantity = _registry().Quantity(values, theirs)
        if quantity.check("1/[time]"):  # 25 Hz of a shaft are 25 turns a second; to pint they are 25 radians
            quantity = quantity * _registry().revolution ** (_counts_turns(theirs) - _counts_turns(ours))
        with np.errstate(over="ignore"):
            return np.asarray(quantity.to(ours).magnitude)
    except pint.DimensionalityError as error:
        raise BadInput(
            f"{where}: unit {shown(given)} cannot be turned into {wanted!r}; give a unit of that kind"
        ) from error
    except (pint.PintError, ArithmeticError, ValueError) as error:  # a factor such as that of Ym**99
        raise BadInput(f"{where}: unit {shown(given)} cannot be reckoned with; give a usual one") from error


def _unit(text: str, where: str) -> Any:
    """pint's unit; ``m3`` and ``s-2`` are powers, ``Nm`` is a torque, nothing or a dash has no dimension."""
    if text in ("", "-"):
        return _registry().dimensionless
    if gauge := _GAUGE.fullmatch(text):  # bar(g) is no bar gram
        return _registry().parse_units("".join(gauge.groups()))
    torque = _TORQUE.sub(r"\1N*m", _spelt_plainly(text))
    for spelt in (torque, _POWER.sub("**", torque)):  # as it is first: cmH2O holds no power
        if not _SPELLING.fullmatch(spelt):
            continue
        try:
            return _registry().parse_units(spelt)
        except Exception:  # pint lets its tokenizer's errors and bare assertions through
            continue
    raise BadInput(f"{where}: unknown unit {shown(text)}; try bar, barg, kPa, psi, degC, K, rpm, Hz, kg/s, kg/h")


def is_unit(text: str) -> bool:
    """Is it a unit that we know?"""
    try:
        _unit(text, "")
    except BadInput:
        return False
    return True


def _spelt_plainly(text: str) -> str:
    """m³ as m3, µ as the Greek letter, ° as deg, blanks only where they multiply; nothing if it is too long."""
    if len(text) > LONGEST_UNIT:
        return ""
    plain = unicodedata.normalize("NFKC", text).replace("\u2212", "-").replace("°", "deg")
    return re.sub(r" ?(\*\*|[\^/*.·()-]) ?", r"\1", " ".join(plain.split()))


def _counts_turns(unit: Any) -> bool:
    """Hz and 1/min count turns; rpm and rad/s are angles over time."""
    return "radian" not in str(_registry().Quantity(1.0, unit).to_root_units().units)


def likely_units(median: float, unit: str, low: float, high: float) -> list[str]:
    """The units under which a median that was taken to be in ``unit`` would lie in [low, high], usual ones first."""
    return [
        other for other in OTHERWISE.get(unit, ()) if low <= float(convert(np.array(median), other, unit, "")) <= high
    ]


def check_plausible(values: Array, limits: Limits, unit: str, where: str, column: str, channel: str) -> None:
    """Refuse a channel whose magnitude says that it is in another unit.

    Args:
        values: (N,) readings in ``unit``; NaN means missing.
        limits: between which the median has to lie, in ``unit``, and a hint.
        unit: of the channel.
        where: the file and column, for the message.
        column: what the file calls it.
        channel: what we call it.

    Raises:
        BadInput: its median lies outside the limits.
    """
    low, high, hint = limits
    if np.isnan(values).all():
        return
    median = float(np.nanmedian(values))
    if not low <= median <= high:
        if units := likely_units(median, unit, low, high):
            hint = f"is it {' or '.join(units[:3])}?"
        raise BadInput(
            f"{where}: its median is {median:.4g} {short_unit(unit)}, which no such machine shows; {hint} "
            f"Say so with {as_map(column, 'UNIT', channel)}"
        )
