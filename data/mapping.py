"""Where each channel comes from: a column's name and unit, from a TOML file beside the recording and from ``--map``."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from twinbench.common.errors import BadInput
from twinbench.common.shown import as_map, shown
from twinbench.data.formats.holdings import TIME
from twinbench.data.sidecar import Sidecar
from twinbench.data.units import is_unit

TIME_UNIT = "second"


@dataclass(frozen=True)
class Source:
    """Where a channel comes from: a column of the file, and its unit there; or the sidecar's ``constant``.

    A constant is in the channel's own unit, and ``column`` says nothing then.
    """

    column: str
    unit: str
    constant: float | None = None


@dataclass(frozen=True)
class Offer:
    """What a file offers: its columns, and the units of those for which it states one."""

    path: Path
    columns: Sequence[str]
    stated: Mapping[str, str]


def sources(
    offer: Offer, sidecar: Sidecar, mapping: Sequence[str], units: Mapping[str, str] | None
) -> dict[str, Source]:
    """channel -> where it comes from; ``--map`` has the last word, and what nobody names is its own column.

    A column's unit is the one that is told; else the one that the file states; else the channel's.

    Args:
        offer: a column of it whose whole name is given is taken, brackets and all; otherwise the last bracket holds
            the unit.
        units: of the channels; None: each column is a channel, and what is renamed is one under its new name.

    Raises:
        BadInput: an unknown channel, one that is mapped twice, or one column for two channels.
    """
    known = None if units is None else {**units, TIME: TIME_UNIT}

    def unit_of(channel: str, column: str) -> str:
        return offer.stated.get(column, TIME_UNIT if channel == TIME else (units or {}).get(channel, ""))

    found = {c: Source(c, unit_of(c, c)) for c in (known or {TIME: TIME_UNIT})}
    for channel in (*sidecar.channels, *sidecar.constants):
        _known(channel, known, str(sidecar.path))
    for channel, entry in sidecar.channels.items():
        column = entry.get("column", channel)
        found[channel] = Source(column, entry.get("unit", unit_of(channel, column)))
    for channel, value in sidecar.constants.items():
        if channel in sidecar.channels or channel == TIME:
            raise BadInput(f"{sidecar.path}: {channel} must be a column or a constant, not both; leave one out")
        found[channel] = Source("", unit_of(channel, ""), value)
    mapped: dict[str, str] = {}
    for item in mapping:
        column, equals, channel = (part.strip() for part in item.rpartition("="))
        only_a_unit = column.startswith("[") and column not in offer.columns
        if not equals or not column or not channel or only_a_unit:
            raise BadInput(
                f"--map {shown(item)}: must read COLUMN=channel or COLUMN[unit]=channel, like PT101[psi]=p_dis_bar"
            )
        _known(channel, known, f"--map {shown(item)}")
        if channel in mapped:
            raise BadInput(
                f"--map {shown(item)}: channel {channel} is mapped twice, {mapped[channel]} too; leave one out"
            )
        mapped[channel] = shown(item)
        name, given = _split(offer, column, channel, None if known is None else known[channel])
        found[channel] = Source(name, unit_of(channel, name) if given is None else given)
    _check_once(offer, found)
    if units is None:
        taken = {source.column for source in found.values() if source.constant is None}
        found |= {c: Source(c, unit_of(c, c)) for c in offer.columns if c and c not in taken and c not in found}
    return found


def _check_once(offer: Offer, found: Mapping[str, Source]) -> None:
    """Refuse one column for two channels."""
    takers: dict[str, str] = {}
    for channel, source in found.items():
        if source.constant is not None or source.column not in offer.columns:
            continue
        if (other := takers.setdefault(source.column, channel)) != channel:
            raise BadInput(
                f"{offer.path}: column {shown(source.column)} is read for {other} and for {channel}; "
                f"name another for one of them with --map COLUMN={channel}"
            )


def _split(offer: Offer, column: str, channel: str, unit: str | None) -> tuple[str, str | None]:
    """The column's name and the unit behind it, None if there is none; ``unit`` is the channel's, where it has one."""
    name, bracket, given = column.rpartition("[")
    name, given = name.rstrip(), given.removesuffix("]").strip()
    if not bracket or not column.endswith("]"):
        return column, None
    if column not in offer.columns:
        return name, given
    if unit is None:
        return column, given if is_unit(given) else None
    if given != unit and is_unit(given) and not given.isdigit():  # part[1] is one of several parts
        raise BadInput(
            f"{offer.path}: column {shown(column)} has a unit in its name; say that it is in {given} with "
            f"{as_map(column, given, channel)}, or in {unit} with {as_map(column, unit, channel)}"
        )
    return column, None


def _known(channel: str, units: Mapping[str, str] | None, where: str) -> None:
    if units is not None and channel not in units:
        raise BadInput(f"{where}: unknown channel {shown(channel)}; choose from {', '.join(units)}")
