"""Stretches of a channel that say something by themselves: nothing was read, or the same over and over."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from twinbench.machines.coordinates import Array

WIDE = 2.5
"""Usual periods between two readings that are a gap: one reading may get lost, two in a row are a gap."""
FEWEST_STILL = 10
"""Equal readings in a row that may count as standing still."""
AS_LONG = 10.0
"""Times the longer one of its neighbours that such a stretch has to be: at the crest of a rounded wave it is five."""
BY_CHANCE = 1e-3
"""Stretches as long that a channel may show by chance, from how often it repeats itself elsewhere."""


class Stretch(NamedTuple):
    """From one reading to another, in seconds of the recording's clock; ``value`` is what was read throughout."""

    begin_s: float
    end_s: float
    value: float | None = None


def gaps(time_s: Array, usual_s: float) -> list[Stretch]:
    """Where nothing was read for more than ``WIDE`` usual periods.

    Args:
        time_s: (n,) seconds at which something was read.
        usual_s: between two readings.
    """
    wide = np.flatnonzero(np.diff(time_s) > WIDE * usual_s)
    return [Stretch(float(time_s[k]), float(time_s[k + 1])) for k in wide]


def in_all(channels: Sequence[Sequence[Stretch]], first_s: Sequence[float], last_s: Sequence[float]) -> list[Stretch]:
    """Where no channel is read at all: each has a gap there, was not read yet, or is not read any more.

    Args:
        channels: gaps of each, in the order of time.
        first_s: of each, when it was read first, in seconds.
        last_s: when it was read last.
    """
    common = [Stretch(-np.inf, np.inf)]
    for own, first, last in zip(channels, first_s, last_s, strict=True):
        common = _overlaps(common, [Stretch(-np.inf, first), *own, Stretch(last, np.inf)])
    return [stretch for stretch in common if np.isfinite(stretch[:2]).all()]


def _overlaps(some: Sequence[Stretch], others: Sequence[Stretch]) -> list[Stretch]:
    found, i, j = [], 0, 0
    while i < len(some) and j < len(others):
        one, other = some[i], others[j]
        begin_s, end_s = max(one.begin_s, other.begin_s), min(one.end_s, other.end_s)
        if begin_s < end_s:
            found.append(Stretch(begin_s, end_s))
        i, j = (i + 1, j) if one.end_s <= other.end_s else (i, j + 1)
    return found


def still(time_s: Array, values: Array) -> list[Stretch]:
    """Where a channel that moves elsewhere shows one value; none of a constant or of what has two values only.

    Args:
        time_s: (n,) seconds at which it was read.
        values: (n,) in its unit, none missing.
    """
    starts = np.flatnonzero(np.diff(values, prepend=np.nan) != 0.0)
    lengths = np.diff(np.append(starts, len(values)))  # readings of each run of equal ones
    if len(np.unique(values[starts])) < 3:
        return []
    beside = np.maximum(np.append(lengths[1:], 0), np.append(0, lengths[:-1]))
    pairs, equal = len(values) - 1, len(values) - len(lengths)
    found = []
    for k in np.flatnonzero((lengths >= FEWEST_STILL) & (lengths > AS_LONG * beside)):
        inside = lengths[k] - 1
        repeats = (equal - inside + 1) / (pairs - inside + 1)  # how often the next reading is the same elsewhere
        if pairs * repeats**inside < BY_CHANCE:
            first, last = starts[k], starts[k] + inside
            found.append(Stretch(float(time_s[first]), float(time_s[last]), float(values[first])))
    return found
