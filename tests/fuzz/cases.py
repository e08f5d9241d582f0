"""A case: a command line in a folder of its own, and what may come of it."""

from __future__ import annotations

import zlib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Generic, TypeVar

import numpy as np

SEED = 1
"""Of the committed table. Another seed draws other cases; the limits on their outcomes are the same."""

SAME, SAME_OR_REFUSED, REFUSED, TOLD, CLOSE_OR_TOLD, ORDERLY = (
    "same", "same or refused", "refused", "told", "close or told", "orderly",
)  # fmt: skip
"""What may come of a case.

same: answered, and the numbers are those of the input that was not mutated.
refused: exit status 2.
told: refused, not usable, or answered with a remark or a verdict that something is wrong. A clean answer is nonsense.
close or told: as told, or an answer whose intervals overlap those of the input that was not mutated.
orderly: any answer whose numbers are finite and in their range, or a refusal.
"""

What = TypeVar("What")


@dataclass(frozen=True)
class Mutator(Generic[What]):
    """One way to spoil an input of one kind. ``expects`` by command; the rest is ``otherwise``."""

    name: str
    spoil: Callable[[What, np.random.Generator], Any]
    otherwise: str
    expects: dict[str, str]

    def expected(self, command: str) -> str:
        return self.expects.get(command, self.otherwise)


class Shelf(Generic[What]):
    """The mutators of one kind of input, in the order in which they are written."""

    def __init__(self) -> None:
        self.mutators: list[Mutator[What]] = []

    def __call__(
        self, otherwise: str = ORDERLY, **expects: str
    ) -> Callable[[Callable[[What, np.random.Generator], Any]], Callable[[What, np.random.Generator], Any]]:
        """Decorator: a mutator named as its function."""

        def add(spoil: Callable[[What, np.random.Generator], Any]) -> Callable[[What, np.random.Generator], Any]:
            self.mutators.append(Mutator(spoil.__name__, spoil, otherwise, expects))
            return spoil

        return add

    def add(self, name: str, spoil: Callable[[What, np.random.Generator], Any], otherwise: str, **expects: str) -> None:
        self.mutators.append(Mutator(name, spoil, otherwise, expects))


@dataclass(frozen=True)
class Case:
    """One command line, to be run in the folder that holds its files.

    Attributes:
        mutator: what was done to the input.
        arguments: after ``twinbench``.
        expects: what may come of it.
        names: a refusal has to hold one of these words: the file, the option or the name that is at fault.
    """

    command: str
    index: int
    mutator: str
    arguments: tuple[str, ...]
    expects: str
    names: tuple[str, ...]
    folder: Path


def generator(command: str, index: int, seed: int) -> np.random.Generator:
    """All that is random in a case comes from this."""
    return np.random.default_rng([seed, zlib.crc32(command.encode()), index])


def pick(rng: np.random.Generator, what: Any) -> Any:
    """One of several, of any type."""
    several = list(what)
    return several[int(rng.integers(len(several)))]
