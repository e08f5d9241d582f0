"""Profiles: how much data, how many seeds, how much training. One TOML file each."""

from __future__ import annotations

import dataclasses
import tomllib
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from data.benchmark import DesignConfig
from data.corrupt import Corruption
from data.errors import BadInput

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
    """One benchmark configuration. ``settings`` overrides the settings of estimators by name."""

    name: str
    seeds: tuple[int, ...] = (0,)
    data: DesignConfig = DesignConfig()
    corruption: Corruption = Corruption()
    evaluation: Evaluation = Evaluation()
    latency: Latency = Latency()
    settings: dict[str, dict[str, Any]] = field(default_factory=dict)


_LIMITS: dict[str, tuple[float, float]] = {
    "evaluation.stride": (1, 200),
    "evaluation.origin_every_s": (5.0, 3600.0),
    "latency.updates": (0, 10_000_000),
}


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
        raw = tomllib.loads(path.read_text())
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise BadInput(f"profile {path}: not TOML: {error}; mend it there") from error
    except OSError as error:
        raise BadInput(f"profile {path}: {error.strerror}; check the file and its permissions") from error
    raw.setdefault("name", path.stem)
    try:
        return _record(Profile, raw, path, "")
    except BadInput as error:
        raise BadInput(str(error) if str(path) in str(error) else f"profile {path}: {error}") from error


def _record(kind: type[Any], raw: dict[str, Any], path: Path, where: str) -> Any:
    known = {f.name: f for f in dataclasses.fields(kind)}
    values: dict[str, Any] = {}
    for key, value in raw.items():
        full = f"{where}{key}"
        if key not in known:
            raise BadInput(f"profile {path}: unknown key {full!r}; it may hold {', '.join(known)}")
        default = known[key].default
        if dataclasses.is_dataclass(default):
            if not isinstance(value, dict):
                raise BadInput(f"profile {path}: {full} must be a table, [{full}]")
            values[key] = _record(type(default), value, path, f"{full}.")
        elif full == "settings":
            values[key] = _settings(value, path)
        else:
            values[key] = _value(value, default, path, full)
    return kind(**values)


def _settings(value: Any, path: Path) -> dict[str, dict[str, Any]]:
    if not isinstance(value, dict) or not all(isinstance(v, dict) for v in value.values()):
        raise BadInput(f"profile {path}: settings must be tables, one for each estimator: [settings.gru_kf]")
    return value


def _value(value: Any, default: Any, path: Path, full: str) -> Any:
    if full == "name":
        expected: type = str
    elif isinstance(default, tuple):
        element = float if isinstance(default[0], float) else int
        if not isinstance(value, list) or not value or not all(_is(v, element) for v in value):
            raise BadInput(f"profile {path}: {full} is {value!r}, must be a list of {element.__name__}s, at least one")
        if any(v < 0 for v in value):
            raise BadInput(f"profile {path}: {full} is {value!r}, none of it may be negative")
        return tuple(element(v) for v in value)
    else:
        expected = type(default)
    if not _is(value, expected):
        raise BadInput(f"profile {path}: {full} is {value!r}, must be a {expected.__name__}")
    low, high = _LIMITS.get(full, (float("-inf"), float("inf")))
    if expected is not str and not low <= value <= high:
        raise BadInput(f"profile {path}: {full} is {value}, must lie in [{low}, {high}]")
    return expected(value)


def _is(value: Any, kind: type) -> bool:
    if isinstance(value, bool):
        return kind is bool
    return isinstance(value, (int, float)) if kind is float else isinstance(value, kind)
