"""Units of the channels, and conversion from whatever a recording uses."""

from __future__ import annotations

import functools
from typing import Any

import numpy as np

from data.batch import CHANNELS, Array
from data.errors import BadInput

UNITS = {
    "p_suc_bar": "bar",
    "T_suc_K": "kelvin",
    "N_rpm": "rpm",
    "valve": "dimensionless",
    "p_dis_bar": "bar",
    "T_dis_K": "kelvin",
    "m_flow_kg_s": "kg/s",
}
"""The compressor's channels and their units, in pint's words."""
assert tuple(UNITS) == CHANNELS

PLAUSIBLE = {
    "bar": (0.05, 60.0, "is it kPa, psi or MPa?"),
    "kelvin": (200.0, 1200.0, "is it degC or degF?"),
    "rpm": (30.0, 60_000.0, "is it Hz or rad/s?"),
    "dimensionless": (-0.05, 1.5, "is it per cent?"),
    "kg/s": (0.0, 50.0, "is it kg/h, or g/s?"),
}
"""Where the median of a channel in a unit has to lie, and what it may be otherwise."""


@functools.cache
def _registry() -> Any:
    import pint

    return pint.UnitRegistry(autoconvert_offset_to_baseunit=True)


def convert(values: Array, given: str, wanted: str, where: str) -> Array:
    """Values in unit ``given`` to unit ``wanted``.

    Raises:
        BadInput: an unknown unit, or one of another dimension.
    """
    if given == wanted:
        return values
    import pint

    try:
        quantity = _registry().Quantity(values, given)
        if quantity.check("1/[time]"):  # 25 Hz of a shaft are 25 turns a second; to pint they are 25 radians
            quantity = quantity * _registry().revolution ** (_counts_turns(given) - _counts_turns(wanted))
        return np.asarray(quantity.to(wanted).magnitude)
    except pint.DimensionalityError as error:
        raise BadInput(f"{where}: unit {given!r} cannot be turned into {wanted!r}; give a unit of that kind") from error
    except Exception as error:  # pint's parser lets its tokenizer's errors and bare assertions through
        raise BadInput(f"{where}: unknown unit {given!r}; try bar, kPa, psi, degC, K, rpm, Hz, kg/s, kg/h") from error


def _counts_turns(unit: str) -> bool:
    """Hz and 1/min count turns; rpm and rad/s are angles over time."""
    return "radian" not in str(_registry().Quantity(1.0, unit).to_root_units().units)


def check_plausible(values: Array, unit: str, where: str, column: str, channel: str) -> None:
    """Refuse a channel whose magnitude says that it is in another unit.

    Raises:
        BadInput: its median lies outside what the unit allows.
    """
    if unit not in PLAUSIBLE or np.isnan(values).all():
        return
    low, high, hint = PLAUSIBLE[unit]
    median = float(np.nanmedian(values))
    if not low <= median <= high:
        raise BadInput(
            f"{where}: its median is {median:.4g} {unit}, which no such machine shows; {hint} "
            f"Say so with --map '{column}[UNIT]={channel}'"
        )
