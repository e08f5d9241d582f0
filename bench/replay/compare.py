"""Two records of one run: where they differ first, and by how much."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from twinbench.bench.replay.record import SAID, Record
from twinbench.machines.coordinates import Array

BESIDE = "what is carried to the next tick"
"""What differs where nothing does that is kept in full."""


class Difference(NamedTuple):
    """One quantity at one tick.

    Attributes:
        tick: from 0 on.
        what: the quantity in words, as ``SAID`` has them, or ``BESIDE``.
        then: as it was recorded; None where it is not kept.
        now: as it is now; likewise.
    """

    tick: int
    what: str
    then: float | None
    now: float | None


class Compared(NamedTuple):
    """How two records differ.

    Attributes:
        first: tick at which the checksums differ first; None: nowhere.
        seen: the first difference in a tick that is kept in full; None: there is none.
        distance: dimensionless, the farthest that an estimate, an end of an interval or a covariance lies off, over
            the recorded standard deviation, or over the two of a covariance, in the ticks that are kept in full.
        farthest: where that is; None: nothing is off.
    """

    first: int | None
    seen: Difference | None
    distance: float
    farthest: Difference | None


def compare(then: Record, now: Record) -> Compared:
    """Hold two records of the same readings against each other, bit by bit.

    Args:
        then: as it was recorded.
        now: as it is now.
    """
    off = np.flatnonzero(then.checksums != now.checksums)
    distance, farthest = _farthest(then, now)
    return Compared(int(off[0]) if len(off) else None, _seen(then, now, off), distance, farthest)


def _seen(then: Record, now: Record, off: np.ndarray) -> Difference | None:
    every = then.about["every"]
    for tick in off[off % every == 0][:1]:
        for name in SAID:
            a, b = (record.said[name][tick // every] for record in (then, now))
            if (different := _different(a, b)).any():
                return _difference(then, now, name, (int(tick) // every, *np.argwhere(different)[0]))
        return Difference(int(tick), BESIDE, None, None)
    return None


def _different(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Where are the bits others? NaN is like NaN of the same bits, and 0 unlike -0."""
    bits = [np.ascontiguousarray(x).reshape(-1, 1).view(np.uint8) for x in (a, b)]
    return np.asarray((bits[0] != bits[1]).any(axis=1)).reshape(a.shape)


def _difference(then: Record, now: Record, name: str, index: tuple[int, ...]) -> Difference:
    at = tuple(map(int, index))
    a, b = (float(record.said[name][at]) for record in (then, now))
    return Difference(at[0] * then.about["every"], _called(then.about, name, at[1:]), a, b)


def _called(about: Mapping[str, Any], name: str, place: tuple[int, ...]) -> str:
    says, axes = SAID[name]
    return says.format(*(about[axis][i] for axis, i in zip(axes, place, strict=True)))


def _farthest(then: Record, now: Record) -> tuple[float, Difference | None]:
    sd = np.sqrt(np.diagonal(then.said["cov"], axis1=1, axis2=2))
    most, where = 0.0, None
    for name in ("mean", "low", "high", "cov"):
        unit = sd[:, :, None] * sd[:, None, :] if name == "cov" else sd
        off = _off(then.said[name], now.said[name], unit)
        at = np.unravel_index(off.argmax(), off.shape)
        if off[at] > most:
            most, where = float(off[at]), _difference(then, now, name, at)  # type: ignore[arg-type]
    return most, where


def _off(then: Array, now: Array, unit: Array) -> Array:
    """Distances in units; infinite where one is no number or there is no unit, 0 where the two are alike."""
    with np.errstate(invalid="ignore", divide="ignore"):
        off = np.abs(now - then) / unit
    alike = (then == now) | (np.isnan(then) & np.isnan(now))
    return np.where(alike, 0.0, np.where(np.isnan(off), np.inf, off))
