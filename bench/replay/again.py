"""A recorded run once more: the same readings through the same estimator, and whether every bit is as it was."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from twinbench.bench.registry import find
from twinbench.bench.replay.compare import Compared, Difference, compare
from twinbench.bench.replay.record import Record
from twinbench.bench.replay.recorder import Recorder
from twinbench.common.errors import BadInput
from twinbench.common.threads import pin_torch
from twinbench.machines.load import load_machine


@dataclass(frozen=True)
class Replayed:
    """What came of it.

    Attributes:
        name: of the record's file.
        ticks: how many there are.
        time_s: of the first that differs; None: none does.
        kept: how many are kept in full.
        found: how the two runs differ.
        elsewhere: in words, what of processor, system and versions is not as it was when the record was made.
        other_code: is the estimator's, or what it imports?
        within: how far off, in recorded standard deviations, still counts as equal; 0: no bit.
        now: the run as it is now.
    """

    name: str
    ticks: int
    time_s: float | None
    kept: int
    found: Compared
    elsewhere: tuple[str, ...]
    other_code: bool
    within: float
    now: Record

    @property
    def equal(self) -> bool:
        """Every bit."""
        return self.found.first is None

    @property
    def passed(self) -> bool:
        """Is it equal, or near enough?"""
        return self.equal or (self.within > 0.0 and self.found.distance <= self.within)

    def told(self) -> list[str]:
        """Lines for a terminal."""
        if self.equal:
            return [f"{self.name}: {self.ticks} ticks, equal to the bit"]
        first, seen, farthest = self.found.first, self.found.seen, self.found.farthest
        lines = [f"{self.name}: differs from tick {first} ({self.time_s:.10g} s) on{_said(first, seen)}"]
        off = f", {farthest.what} at tick {farthest.tick}" if farthest else ""
        lines.append(
            f"  farthest off in the {self.kept} ticks that are kept in full:"
            f" {self.found.distance:.3g} recorded standard deviations{off}"
        )
        if self.elsewhere:
            lines.append(f"  bits may differ, since it was made with {', '.join(self.elsewhere)}")
        if self.other_code:
            lines.append("  the estimator's code, or what it imports, has changed since")
        if self.within > 0.0:
            lines.append(f"  {'within' if self.passed else 'not within'} {self.within:g} standard deviations")
        return lines

    def to_json(self) -> dict[str, Any]:
        """For programs."""
        found = self.found
        return {
            "record": self.name,
            "ticks": self.ticks,
            "equal": self.equal,
            "passed": self.passed,
            "first_tick": found.first,
            "first_time_s": self.time_s,
            "seen": found.seen and found.seen._asdict(),
            "kept": self.kept,
            "distance_sd": found.distance,
            "farthest": found.farthest and found.farthest._asdict(),
            "within_sd": self.within,
            "elsewhere": list(self.elsewhere),
            "other_code": self.other_code,
        }


def replay(path: Path, estimator: str = "", machine: str = "", within: float = 0.0) -> Replayed:
    """Run a record's readings through its estimator again, and compare.

    Args:
        path: of the record.
        estimator: file of an estimator that is not built in; empty: by its name.
        machine: file of a machine that is not built in; empty: by its name.
        within: in recorded standard deviations, how far off still counts as equal; 0: no bit.

    Raises:
        BadInput: one line; it is no record, or of another estimator or machine.
    """
    if not 0.0 <= within < math.inf:
        raise BadInput(f"--within is {within:g}, must be a number of standard deviations, 0 or more")
    then = Record.load(path)
    recorder = Recorder(_estimator_of(then, path, estimator, machine), then.about["every"])
    for time_s, measured, lag_s in zip(then.time_s, then.measured, then.lag_s, strict=True):
        recorder.update(time_s, measured, None if np.isnan(lag_s).all() else lag_s)
    made = then.about["provenance"]
    now = recorder.record(made.get("settings"), made.get("files", ()))
    found = compare(then, now)
    time_s = None if found.first is None else float(then.time_s[found.first])
    ticks, kept = len(then.time_s), len(then.said["mean"])
    other_code = then.about["code"] != now.about["code"]
    return Replayed(str(path), ticks, time_s, kept, found, tuple(_elsewhere(then, now)), other_code, within, now)


def _estimator_of(record: Record, path: Path, estimator: str, machine: str) -> Any:
    """The record's, restored.

    Raises:
        BadInput: it is not here, or what is here is another one.
    """
    about = record.about
    kind = _given_or_named(path, "estimator", estimator, about["estimator"], find)
    of = _given_or_named(path, "machine", machine, about["machine"], load_machine)
    for name in ("channels", "outputs", "quantities"):
        if list(getattr(of, name)) != about[name]:
            raise BadInput(
                f"{path}: a record of another {about['machine']}: it has the {name} {', '.join(about[name])}, the "
                f"machine here {', '.join(getattr(of, name))}; replay it with the machine that it was made with"
            )
    try:
        restored = record.estimator(kind, of)
    except Exception as error:
        why = f"{type(error).__name__}: {error}".splitlines()[0].removeprefix("ValueError: ")
        raise BadInput(f"{path}: {why}; replay it with the estimator and machine that it was made with") from error
    pin_torch()
    return restored


def _given_or_named(path: Path, what: str, given: str, named: str, load: Callable[[str], Any]) -> Any:
    try:
        return load(given or named)
    except BadInput as error:
        if given:
            raise
        raise BadInput(f"{path}: the {what} {named!r} is not built in; name its file with --{what} FILE") from error


def _elsewhere(then: Record, now: Record) -> list[str]:
    """What is not as it was."""
    was, here = then.about["place"], now.about["place"]
    return [f"{n} {was.get(n, '?')} (here {here.get(n, '?')})" for n in {**was, **here} if was.get(n) != here.get(n)]


def _said(first: int | None, seen: Difference | None) -> str:
    """Which quantity it is and by how much, as far as that is kept."""
    if seen is None:
        return ", in no tick that is kept in full"
    when = "" if seen.tick == first else f", in full seen at tick {seen.tick}"
    if seen.then is None or seen.now is None:
        return f"{when}: {seen.what}"
    return f"{when}: {seen.what} was {seen.then!r}, is {seen.now!r}, a difference of {seen.now - seen.then:.3g}"
