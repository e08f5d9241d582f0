"""Where each channel comes from: a column's name and unit, from a TOML file beside the recording and from ``--map``."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from twinbench.common.errors import BadInput
from twinbench.common.shown import as_map, shown
from twinbench.common.toml_file import read_toml
from twinbench.data.units import is_unit

TIME = "time_s"
TIME_UNIT = "second"


@dataclass(frozen=True)
class Source:
    """Where a channel comes from: a column of the file, and its unit there."""

    column: str
    unit: str


def sources(
    path: Path, sidecar: Path, columns: Sequence[str], mapping: Sequence[str], units: Mapping[str, str]
) -> dict[str, Source]:
    """channel -> where it comes from; ``--map`` has the last word, and what nobody names is its own column.

    Args:
        columns: the file's. One whose whole name is given is taken, brackets and all; otherwise the last
            bracket holds the unit.

    Raises:
        BadInput: an unknown channel, one that is mapped twice, or one column for two channels.
    """
    units = {**units, TIME: TIME_UNIT}
    found = {channel: Source(channel, unit) for channel, unit in units.items()}
    found |= _from_sidecar(sidecar, units) if sidecar.is_file() else {}
    mapped: dict[str, str] = {}
    for item in mapping:
        column, equals, channel = (part.strip() for part in item.rpartition("="))
        if not equals or not column or not channel:
            raise BadInput(
                f"--map {shown(item)}: must read COLUMN=channel or COLUMN[unit]=channel, like PT101[psi]=p_dis_bar"
            )
        _known(channel, units, f"--map {shown(item)}")
        if channel in mapped:
            raise BadInput(
                f"--map {shown(item)}: channel {channel} is mapped twice, {mapped[channel]} too; leave one out"
            )
        mapped[channel] = shown(item)
        found[channel] = _source(path, column, channel, columns, units[channel])
    takers: dict[str, str] = {}
    for channel, source in found.items():
        if source.column in columns and (other := takers.setdefault(source.column, channel)) != channel:
            raise BadInput(
                f"{path}: column {shown(source.column)} is read for {other} and for {channel}; "
                f"name another for one of them with --map COLUMN={channel}"
            )
    return found


def _source(path: Path, column: str, channel: str, columns: Sequence[str], unit: str) -> Source:
    name, bracket, given = column.rpartition("[")
    name, given = name.rstrip(), given.removesuffix("]").strip()
    if not bracket or not column.endswith("]"):
        return Source(column, unit)
    if column not in columns:
        return Source(name, given)
    if given != unit and is_unit(given):
        raise BadInput(
            f"{path}: column {shown(column)} has a unit in its name; say that it is in {given} with "
            f"{as_map(column, given, channel)}, or in {unit} with {as_map(column, unit, channel)}"
        )
    return Source(column, unit)


def _from_sidecar(sidecar: Path, units: Mapping[str, str]) -> dict[str, Source]:
    found = {}
    content = read_toml(sidecar)
    channels = content.pop("channels", {})
    if content or not isinstance(channels, dict):
        raise BadInput(f"{sidecar}: must hold one table, [channels], and nothing else; move the rest elsewhere")
    for channel, entry in channels.items():
        _known(channel, units, str(sidecar))
        if isinstance(entry, str):
            entry = {"column": entry}
        source = {"column": channel, "unit": units[channel]} | (entry if isinstance(entry, dict) else {"?": entry})
        if len(source) > 2 or not all(isinstance(v, str) for v in source.values()):
            raise BadInput(f"{sidecar}: channel {channel} must be a column's name, or hold column and unit only")
        found[channel] = Source(source["column"].strip(), source["unit"])
    return found


def _known(channel: str, units: Mapping[str, str], where: str) -> None:
    if channel not in units:
        raise BadInput(f"{where}: unknown channel {shown(channel)}; choose from {', '.join(units)}")
