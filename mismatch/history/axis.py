"""One axis of time for what goes on over several recordings, and the knots on it between which a size goes in lines."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from twinbench.mismatch.tracks import Track
from twinbench.physics.simulator import Array

KNOTS = 72
"""Pieces of all recordings together at the ends of which a size may change its course. A change is told to one such
piece, and three recordings have two dozen each. What other numbers would change was not measured."""
FEWEST_PIECES, MOST_PIECES = 3, 36
"""Pieces of one recording."""


@dataclass(frozen=True)
class Axis:
    """Recordings on one axis.

    Attributes:
        names: of the recordings, in the order in which they were given.
        clock: do they follow one another on their clock? If not, they stand end to end, as they were given.
        knots: (M,) per recording, on its own clock, s.
        along_s: (Q,) all knots on the axis, s, recording by recording.
        of: (Q,) positions of the recordings that they are of.
    """

    names: tuple[str, ...]
    clock: bool
    knots: tuple[Array, ...]
    along_s: Array
    of: np.ndarray

    @classmethod
    def over(cls, tracks: Sequence[Track]) -> Axis:
        """The axis of some recordings."""
        pieces = min(max(KNOTS // len(tracks), FEWEST_PIECES), MOST_PIECES)
        ends = [(float(t.time_s[0]), float(t.time_s[-1])) for t in tracks]
        in_time = sorted(ends)
        clock = all(b[0] >= a[1] for a, b in itertools.pairwise(in_time))
        knots = tuple(np.linspace(*end, pieces + 1) for end in ends)
        lasts = np.array([end - begin for begin, end in ends])
        begins = np.array([end[0] for end in ends]) if clock else np.cumsum(lasts) - lasts
        along = [begin + k - k[0] for begin, k in zip(begins, knots, strict=True)]
        of = np.repeat(np.arange(len(ends)), pieces + 1)
        return cls(tuple(t.name for t in tracks), clock, knots, np.concatenate(along), of)

    @property
    def order(self) -> np.ndarray:
        """(Q,) positions of the knots, the earliest first."""
        return np.argsort(self.along_s, kind="stable")

    @property
    def span_s(self) -> float:
        """From the first knot to the last."""
        return float(np.ptp(self.along_s))

    def hats(self, r: int, time_s: Array) -> Array:
        """(S, Q) share of each knot in what a size is at some times of recording r.

        Args:
            time_s: (S,) on the recording's clock, s.
        """
        found = np.zeros((len(time_s), len(self.along_s)))
        each = [np.interp(time_s, self.knots[r], one) for one in np.eye(len(self.knots[r]))]
        found[:, self.of == r] = np.stack(each, axis=-1)
        return found

    def place(self, along_s: float) -> tuple[str, float]:
        """The recording that a time on the axis falls into, and when on its clock, s; in a pause the one before it."""
        begins = np.array([self.along_s[self.of == r][0] for r in range(len(self.knots))])
        before = np.flatnonzero(begins <= along_s)
        r = int(before[np.argmax(begins[before])]) if len(before) else int(np.argmin(begins))
        return self.names[r], float(self.knots[r][0]) + max(along_s - float(begins[r]), 0.0)
