"""What the TOML file beside a recording says of it: columns, units, constants, stamps, and further files of the run."""

from __future__ import annotations

import math
import zoneinfo
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from twinbench.common.errors import BadInput
from twinbench.common.shown import shown
from twinbench.common.toml_file import read_toml
from twinbench.data.table import stem

ENTRIES = ("[channels]", "[constants]", "join", "stamp", "average_s", "rate_Hz", "time_zone")
STAMPS = {"start": 0.5, "middle": 0.0, "end": -0.5}
"""Where the stamp of a mean stands, and how many averaging times later the middle is."""


@dataclass(frozen=True)
class Sidecar:
    """What is said of a recording.

    Attributes:
        path: the file, for messages; it need not be there.
        channels: column and unit of each, either may be missing.
        constants: a value in the channel's unit, for channels that do not change.
        join: further files of the run, in the order in which they follow.
        stamp: where each stamp stands in what it is the mean of; empty where samples are no means.
        average_s: over how long each is the mean.
        rate_Hz: means over so many parts of a second are to take the place of samples; None: samples stay.
        time_zone: of dates that name none.
    """

    path: Path
    channels: Mapping[str, Mapping[str, str]] = field(default_factory=dict)
    constants: Mapping[str, float] = field(default_factory=dict)
    join: tuple[Path, ...] = ()
    stamp: str = ""
    average_s: float = 0.0
    rate_Hz: float | None = None
    time_zone: str | None = None

    @property
    def later_s(self) -> float:
        """What has to be added to every stamp, so that it stands in the middle of what it is the mean of."""
        return STAMPS[self.stamp] * self.average_s if self.stamp else 0.0


def sidecar_of(recording: Path) -> Sidecar:
    """What the TOML file of a recording's name says of it; an empty one where there is none.

    Raises:
        BadInput: no TOML, or an entry that says nothing.
    """
    path = recording.with_name(stem(recording) + ".toml")
    if not path.is_file():
        return Sidecar(path)
    content = read_toml(path)
    for key in content:
        if key not in (entry.strip("[]") for entry in ENTRIES):
            raise BadInput(f"{path}: unknown entry {shown(key)}; choose from {', '.join(ENTRIES)}")
    return Sidecar(
        path,
        {channel: _channel(path, channel, entry) for channel, entry in _table(path, content, "channels").items()},
        {c: _number(path, f"constant {c}", value) for c, value in _table(path, content, "constants").items()},
        _join(path, content.get("join", [])),
        *_stamp(path, content),
        _positive(path, content, "rate_Hz"),
        _time_zone(path, content.get("time_zone")),
    )


def _table(path: Path, content: Mapping[str, Any], name: str) -> dict[str, Any]:
    table = content.get(name, {})
    if not isinstance(table, dict):
        raise BadInput(f"{path}: {name} must be a table; write [{name}] on a line of its own")
    return table


def _channel(path: Path, channel: str, entry: object) -> dict[str, str]:
    """Its column and its unit, as far as they are given."""
    if isinstance(entry, str):
        entry = {"column": entry}
    if not isinstance(entry, dict) or not set(entry) <= {"column", "unit"}:
        raise BadInput(f"{path}: channel {channel} must be a column's name, or hold column and unit only")
    if not all(isinstance(value, str) for value in entry.values()):
        raise BadInput(f"{path}: channel {channel} must be a column's name, or hold column and unit only, as text")
    return {key: value.strip() if key == "column" else value for key, value in entry.items()}


def _number(path: Path, what: str, value: object) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise BadInput(f"{path}: {what} is {shown(value)}, must be a number")
    return float(value)


def _positive(path: Path, content: Mapping[str, Any], key: str) -> float | None:
    if key not in content:
        return None
    value = _number(path, key, content[key])
    if value <= 0.0:
        raise BadInput(f"{path}: {key} is {value:g}, must be above 0")
    return value


def _join(path: Path, names: object) -> tuple[Path, ...]:
    if not isinstance(names, list) or not all(isinstance(name, str) and name for name in names):
        raise BadInput(f"{path}: join must be a list of file names, such as ['part2.csv']")
    return tuple(path.parent / name for name in names)


def _stamp(path: Path, content: Mapping[str, Any]) -> tuple[str, float]:
    """Where the stamp stands, and over how many seconds each sample is a mean."""
    stamp, average_s = content.get("stamp", ""), _positive(path, content, "average_s") or 0.0
    if stamp != "" and (not isinstance(stamp, str) or stamp not in STAMPS):
        raise BadInput(f"{path}: stamp is {shown(stamp)}; choose from {', '.join(STAMPS)}")
    if bool(stamp) != bool(average_s):
        raise BadInput(f"{path}: stamp and average_s must stand together; say where, and over how many seconds")
    return stamp, average_s


def _time_zone(path: Path, name: object) -> str | None:
    if name is None:
        return None
    try:
        return zoneinfo.ZoneInfo(str(name)).key
    except (KeyError, OSError, ValueError) as error:
        raise BadInput(
            f"{path}: unknown time_zone {shown(name)}; name one of the tz database, such as Europe/Berlin"
        ) from error
