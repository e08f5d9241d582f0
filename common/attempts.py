"""Which worker is at which item: each attempt leaves a mark in a folder, and takes it away unless its worker dies."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

AT_WORK = "at-work-"
"""What names of folders for marks begin with."""
MOST_LOST = 3
"""Workers that an item may lose before it is given up. Three are no accident."""


@dataclass(frozen=True)
class Done:
    """How an item ended.

    Attributes:
        lost: the workers that ended while they were at it.
        given_up: they were too many; there is no result.
    """

    lost: tuple[str, ...]
    result: Any = None
    given_up: bool = False

    def says(self, name: str) -> str:
        """``train: gru_kf, seed 0 lost its worker, process 7; another has done it``."""
        whom = f"{len(self.lost)} workers" if len(self.lost) > 1 else "its worker"
        end = "it is given up" if self.given_up else "another has done it"
        return f"{name} lost {whom}, {' and '.join(self.lost)}; {end}"


def attempt(marks: Path, number: int, who: str, work: Callable[[], Any]) -> Done:
    """Do an item's work, unless too many workers have ended over it.

    A mark is made by exclusive creation. That holds on network file systems, which may show an old list of files.

    Args:
        marks: the folder for the marks.
        number: the item's.
        who: this worker, for whoever reads the mark.
    """
    lost: list[str] = []
    for n in range(MOST_LOST):
        mark = marks / f"{number}.{n}"
        try:
            file = open(mark, "x", encoding="utf-8")
        except FileExistsError:
            lost.append(mark.read_text(encoding="utf-8"))
            continue
        with file:
            file.write(who)
        try:
            return Done(tuple(lost), work())
        finally:
            mark.unlink(missing_ok=True)
    return Done(tuple(lost), given_up=True)


def at_work(marks: Path, number: int) -> tuple[str, ...]:
    """The workers that have begun an item and not ended it, dead or alive."""
    return tuple(mark.read_text(encoding="utf-8") for mark in sorted(marks.glob(f"{number}.*")))
