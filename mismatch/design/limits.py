"""What a next experiment may do: the file of limits, read and checked."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from twinbench.common.errors import BadInput
from twinbench.common.shown import shown
from twinbench.common.toml_file import read_toml
from twinbench.mismatch.told import nearest
from twinbench.mismatch.tracks import FEWEST_SAMPLES
from twinbench.physics.simulator import Array, Simulator

MOST_SAMPLES = 1_000_000
"""Of one experiment; a longer one is a mistake in the unit of time."""
CANDIDATES = 200
_TABLES = ("experiment", "inputs", "noise")
_RANGE = ("low", "high", "rate_per_s")


@dataclass(frozen=True)
class Limits:
    """Limits of an experiment.

    Attributes:
        low: (nu,) the least of each input, in its unit.
        high: (nu,) the most of each, likewise.
        rate_per_s: (nu,) how fast each may go, in its unit per second; infinite if it may jump.
        duration_s: of the experiment.
        sampling_s: between samples.
        noise: standard deviation of a reading, by output, in its unit; where recordings do not tell it.
        runs: files of inputs to choose among, in place of inputs that are made.
        candidates: how many are made.
    """

    low: Array
    high: Array
    rate_per_s: Array
    duration_s: float
    sampling_s: float
    noise: Mapping[str, float] = field(default_factory=dict)
    runs: tuple[Path, ...] = ()
    candidates: int = CANDIDATES

    @property
    def time_s(self) -> Array:
        """(N,) from nothing on."""
        return np.asarray(np.arange(round(self.duration_s / self.sampling_s)) * self.sampling_s, dtype=float)


def read_limits(path: Path, simulator: Simulator) -> Limits:
    """Read a file of limits for a simulator.

    Raises:
        BadInput: one line; a key is missing or unknown, or the limits allow nothing.
    """
    content = read_toml(path)
    _known(content, _TABLES, f"{path}")
    experiment = _table(content, "experiment", path)
    _known(experiment, ("duration_s", "sampling_s", "runs", "candidates"), f"{path}: [experiment]")
    runs = _runs(experiment.get("runs", []), path)
    inputs = _table(content, "inputs", path) if simulator.inputs or "inputs" in content else {}
    names = [v.name for v in simulator.inputs]
    for name in inputs:
        if name not in names:
            raise BadInput(f"{path}: [inputs.{shown(name)}]: the simulator has no such input{nearest(name, names)}")
    ranges = [_range(inputs, name, path) for name in names]
    duration_s, sampling_s = (_number(experiment, key, f"{path}: [experiment]") for key in ("duration_s", "sampling_s"))
    if not 0.0 < sampling_s < duration_s < math.inf:
        raise BadInput(f"{path}: [experiment]: sampling_s must be above 0 and less than duration_s; mend one of them")
    samples = round(duration_s / sampling_s)
    if not FEWEST_SAMPLES <= samples <= MOST_SAMPLES:
        raise BadInput(
            f"{path}: [experiment]: has {samples:,} samples, must have {FEWEST_SAMPLES} to {MOST_SAMPLES:,}; "
            "mend duration_s or sampling_s"
        )
    low, high, rate = np.array(ranges, dtype=float).reshape(-1, len(_RANGE)).T
    if not runs and (not len(names) or not np.any((high > low) & (rate > 0.0))):
        raise BadInput(f"{path}: allows no input to move; raise high above low for one of them, or name runs")
    candidates = int(_number(experiment, "candidates", f"{path}: [experiment]", CANDIDATES))
    if not candidates > 0:
        raise BadInput(f"{path}: [experiment]: candidates is {candidates}, must be at least 1")
    return Limits(low, high, rate, duration_s, sampling_s, _noise(content, simulator, path), runs, candidates)


def check_run(limits: Limits, name: str, u: Array, simulator: Simulator) -> None:
    """Refuse a run of the user's that leaves the limits.

    Args:
        u: (N, nu) inputs in their units.

    Raises:
        BadInput: an input goes beyond its limits.
    """
    for v, values, low, high in zip(simulator.inputs, u.T, limits.low, limits.high, strict=True):
        slack = 1e-6 * max(high - low, abs(high), abs(low))
        if values.min() < low - slack or values.max() > high + slack:
            raise BadInput(
                f"run {name}: {v.name} goes from {values.min():g} to {values.max():g}, the limits are {low:g} to "
                f"{high:g}; mend the run or the limits"
            )


def _table(content: Mapping[str, Any], name: str, path: Path) -> Mapping[str, Any]:
    table = content.get(name)
    if not isinstance(table, dict):
        raise BadInput(f"{path}: has no table [{name}]; add it")
    return table


def _known(table: Mapping[str, Any], known: Sequence[str], where: str) -> None:
    for key in table:
        if key not in known:
            raise BadInput(f"{where}: {shown(key)} is not known; it may hold {', '.join(known)}")


def _range(inputs: Mapping[str, Any], name: str, path: Path) -> tuple[float, float, float]:
    table, where = inputs.get(name), f"{path}: [inputs.{name}]"
    if not isinstance(table, dict):
        raise BadInput(f"{where}: is missing; give low, high and rate_per_s of every input, low = high of one at rest")
    _known(table, _RANGE, where)
    low, high, rate = (_number(table, key, where) for key in _RANGE)
    if not -math.inf < low <= high < math.inf:
        raise BadInput(f"{where}: low is {low:g} and high is {high:g}; low must not be above high")
    if not rate >= 0.0:
        raise BadInput(f"{where}: rate_per_s is {rate:g}, must not be below 0; inf lets it jump")
    return low, high, rate


def _number(table: Mapping[str, Any], key: str, where: str, default: float | None = None) -> float:
    value = table.get(key, default)
    if value is None:
        raise BadInput(f"{where}: {key} is missing; add it")
    if isinstance(value, bool) or not isinstance(value, int | float) or math.isnan(value):
        raise BadInput(f"{where}: {key} is {shown(value)}, must be a number")
    return float(value)


def _runs(listed: object, path: Path) -> tuple[Path, ...]:
    if not isinstance(listed, list) or not all(isinstance(one, str) for one in listed):
        raise BadInput(f'{path}: [experiment]: runs must be a list of files, as ["a.csv", "b.csv"]')
    return tuple(path.parent / one for one in listed)


def _noise(content: Mapping[str, Any], simulator: Simulator, path: Path) -> dict[str, float]:
    table = content.get("noise", {})
    names = [v.name for v in simulator.outputs]
    if not isinstance(table, dict):
        raise BadInput(f"{path}: [noise] must be a table of outputs, each with the standard deviation of a reading")
    for name in table:
        if name not in names:
            raise BadInput(f"{path}: [noise]: the simulator has no output {shown(name)}{nearest(name, names)}")
        if not 0.0 < _number(table, name, f"{path}: [noise]") < math.inf:
            raise BadInput(f"{path}: [noise]: {name} must be above 0")
    return {name: float(sd) for name, sd in table.items()}
