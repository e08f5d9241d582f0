"""Profiles: how much data, how many seeds, how much training. One TOML file each."""

from __future__ import annotations

import dataclasses
import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, cast

from twinbench.common.errors import BadInput
from twinbench.common.filespec import split_spec
from twinbench.common.toml_file import read_toml
from twinbench.data.benchmark import DesignConfig
from twinbench.data.corrupt import Corruption

FOLDER = Path(__file__).parent / "profiles"


@dataclass(frozen=True)
class Evaluation:
    """What a cell stores: every ``stride``-th tick, and forecasts from origins so far apart."""

    stride: int = 4
    origin_every_s: float = 60.0
    leads_s: tuple[float, ...] = (1.0, 10.0, 60.0)


@dataclass(frozen=True)
class Latency:
    """Timed updates of each estimator; 0 leaves the stage out."""

    updates: int = 1000


@dataclass(frozen=True)
class Profile:
    """One benchmark configuration.

    Attributes:
        machine: its name, or the path of the file it comes from.
        scenes: run everyone in the scenes of the paper's figures, too.
        settings: overrides the settings of estimators, by name.
    """

    name: str
    machine: str = "compressor"
    seeds: tuple[int, ...] = (0,)
    data: DesignConfig = field(default_factory=DesignConfig)
    corruption: Corruption = field(default_factory=Corruption)
    evaluation: Evaluation = field(default_factory=Evaluation)
    latency: Latency = field(default_factory=Latency)
    scenes: bool = True
    settings: dict[str, dict[str, Any]] = field(default_factory=dict)


KINDS: dict[type, str] = {bool: "true or false", int: "a whole number", float: "a number", str: "text"}
LIMITS: dict[str, tuple[float, float]] = {
    "seeds": (0, 2**31 - 1),
    "evaluation.stride": (1, 200),
    "evaluation.origin_every_s": (5.0, 3600.0),
    "evaluation.leads_s": (0.05, 3600.0),
    "latency.updates": (0, 10_000_000),
}
"""What ``data`` and ``corruption`` may hold, their own records check."""


def load_profile(name: str) -> Profile:
    """A profile by name or by the path of a TOML file.

    Raises:
        BadInput: no such profile, not TOML, an unknown key, a wrong type, a value out of range.
    """
    path = Path(name) if name.endswith(".toml") else FOLDER / f"{name}.toml"
    if not path.is_file():
        known = ", ".join(sorted(p.stem for p in FOLDER.glob("*.toml")))
        raise BadInput(f"no profile {name!r}; choose one of {known}, or give the path of a .toml file")
    try:
        raw = read_toml(path)
    except BadInput as error:
        raise BadInput(f"profile {error}") from error
    try:
        return cast(Profile, _record(Profile(path.stem), raw, ""))
    except BadInput as error:
        raise BadInput(f"profile {path}: {error}") from error


def profile_on(name: str, machine: str) -> Profile:
    """A profile, on a machine if one is named.

    Args:
        name: of the profile, or the path of a TOML file.
        machine: its name, or the path of the file it comes from; empty: the profile's own.

    Raises:
        BadInput: as ``load_profile``.
    """
    profile = load_profile(name)
    return dataclasses.replace(profile, machine=machine) if machine else profile


def folder_of(profile: Profile, machine: str) -> Path:
    """Where a run goes unless it is told: ``results/<profile>``, and the machine if one was named.

    Args:
        profile: of the run.
        machine: its name, or the path of the file it comes from; empty: none was named.
    """
    file, name = split_spec(machine)
    called = name.lower() or Path(file).stem if file else machine.rpartition(":")[2].lower()
    return Path("results") / (f"{profile.name}_{called}" if machine else profile.name)


def flattened(table: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """Nested tables as one, with keys joined by dots."""
    flat: dict[str, Any] = {}
    for key, value in table.items():
        flat |= flattened(value, f"{prefix}{key}.") if isinstance(value, dict) else {f"{prefix}{key}": value}
    return flat


def fits(value: Any, kind: type) -> bool:
    """Is a TOML value of that type? A whole number will do for a float, a bool for a bool only."""
    if isinstance(value, bool):
        return kind is bool
    return isinstance(value, (int, float)) if kind is float else isinstance(value, kind)


def _record(defaults: Any, raw: dict[str, Any], where: str) -> Any:
    """``defaults``, a record, with the values of a TOML table in their places."""
    known = [f.name for f in dataclasses.fields(defaults)]
    values: dict[str, Any] = {}
    for key, value in raw.items():
        full = f"{where}{key}"
        if key not in known:
            raise BadInput(f"unknown key {full!r}; {f'[{where[:-1]}]' if where else 'it'} may hold {', '.join(known)}")
        default = getattr(defaults, key)
        if dataclasses.is_dataclass(default):
            if not isinstance(value, dict):
                raise BadInput(f"{full} must be a table, [{full}]")
            values[key] = _record(default, value, f"{full}.")
        elif isinstance(default, dict):
            if not isinstance(value, dict) or not all(isinstance(v, dict) for v in value.values()):
                raise BadInput(f"{full} must be tables, one for each estimator: [{full}.gru_kf]")
            values[key] = value
        elif isinstance(default, tuple):
            values[key] = _several(value, type(default[0]), full)
        else:
            values[key] = _one(value, type(default), full)
    return dataclasses.replace(defaults, **values)


def _several(value: Any, kind: type, full: str) -> tuple[Any, ...]:
    if not isinstance(value, list) or not value:
        raise BadInput(f"{full} is {value!r}, must be a list, each {KINDS[kind]}, at least one")
    values = tuple(_one(v, kind, full) for v in value)
    if len(set(values)) < len(values):
        raise BadInput(f"{full} is {value!r}, must not name the same one twice")
    return values


def _one(value: Any, kind: type, full: str) -> Any:
    if not fits(value, kind):
        raise BadInput(f"{full} is {value!r}, must be {KINDS[kind]}")
    if kind is str and full != "machine" and not re.fullmatch(r"[\w.-]*\w", value):
        raise BadInput(f"{full} is {value!r}, must be a word: results go into a folder of that name")
    low, high = LIMITS.get(full, (-math.inf, math.inf))
    if kind is not str and not low <= value <= high:
        raise BadInput(f"{full} is {value}, must lie in [{low:,.10g}, {high:,.10g}]")
    return kind(value)
