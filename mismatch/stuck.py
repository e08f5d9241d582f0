"""Sensors that stand still while the machine moves: found by themselves, and their readings set aside.

No parameter goes continuously from a sensor that follows to one that is stuck, and where it sticks in one
recording only, no other can confirm it. But it shows plainly enough in that one.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from twinbench.mismatch.tracks import FEWEST_SAMPLES, Track
from twinbench.physics.simulator import Array

STANDS_STILL = "sensor_stuck@"
"""How the fault's name begins."""
STILL = 0.05
"""A sensor stands still where its variance is below this share of what the simulator says."""
FOLLOWS = 0.3
"""And it followed elsewhere: more than this share of what the simulator says there."""
PLAINLY_MOVED_SD = 5.0
"""Errors (rms) that the simulator makes elsewhere, noise among them, that it must say the channel moved by meanwhile.
Seven stuck sensors in 200 cases had 7 and more, a level that stood at its rim had 1.4."""
BELOW = 0.3
"""Share of the time that the simulator may be below a sensor that only does not go higher."""
STUCK_SHARE, _EDGES = 0.1, 61
"""Share of a recording that it must stand still; where that may begin and end, in one recording."""


class Stuck(NamedTuple):
    """A sensor that stands still; ``moved`` is what the simulator says the channel moved by (sd)."""

    recording: str
    channel: int
    since_s: float
    until_s: float
    value: float
    moved: float


def find_stuck(tracks: Sequence[Track], residuals: Sequence[Array], floor: Array) -> list[Stuck]:
    """The stretch of each recording and channel that a sensor plainly stands still in, if any.

    Args:
        residuals: block means measured minus simulated, (B, ny) per recording, in the outputs' units.
        floor: (ny,) noise of block means, in the outputs' units.
    """
    found = []
    for c in range(len(floor)):
        top = max(float(np.nanmax(t.means[:, c], initial=-np.inf)) for t in tracks)
        for track, residual in zip(tracks, residuals, strict=True):
            y, simulated = track.means[:, c], track.means[:, c] - residual[:, c]
            i, j = _stillest(y, simulated)
            inside = np.zeros(len(y), dtype=bool)
            inside[i:j] = True
            others = [
                (t.means[:, c], t.means[:, c] - r[:, c])
                for t, r in zip(tracks, residuals, strict=True)
                if t is not track
            ]
            elsewhere = [(y[~inside], simulated[~inside]), *others]
            moved = _variance(simulated[inside])
            if _saturated(y[inside], simulated[inside], top, PLAINLY_MOVED_SD * floor[c]):
                continue
            plainly = PLAINLY_MOVED_SD * max(floor[c], _rms(np.concatenate([a - b for a, b in elsewhere])))
            if moved < plainly**2 or _variance(y[inside]) > STILL * moved:
                continue
            followed = max((_variance(a) / max(_variance(b), 1e-300) for a, b in elsewhere), default=0.0)
            if followed > FOLLOWS:
                ends = track.block_time_s[i], track.time_s[-1] if j == len(y) else track.block_time_s[j]
                value = float(np.nanmedian(y[inside]))
                since_s, until_s = map(float, ends)
                found.append(Stuck(track.name, c, since_s, until_s, value, float(np.sqrt(moved))))
    return found


def set_aside(tracks: Sequence[Track], readings: Sequence[Array], floor: Array) -> tuple[list[Track], list[Stuck]]:
    """The recordings without the readings of sensors that stand still by what a simulator says, and which these are.

    Args:
        readings: simulated, sample by sample, (N, ny) per recording, in the outputs' units.
        floor: (ny,) noise of block means, in the outputs' units.
    """
    residuals = [t.means - t.block_means(simulated) for t, simulated in zip(tracks, readings, strict=True)]
    found = find_stuck(tracks, residuals, floor)
    return without(tracks, found), found


def without(tracks: Sequence[Track], found: Sequence[Stuck]) -> list[Track]:
    """The recordings without the readings of sensors that stand still."""
    out = []
    for track in tracks:
        for s in found:
            if s.recording == track.name:
                track = track.without(s.channel, s.since_s, s.until_s)
        out.append(track)
    return out


def _saturated(y: Array, simulated: Array, top: float, margin: float) -> bool:
    """Does it stand at the channel's highest reading, where the simulator is above? That is another fault."""
    still = float(np.nanmedian(y)) if np.isfinite(y).any() else np.nan
    return top - still < margin and float(np.nanmean(simulated < still - margin)) < BELOW


def _stillest(y: Array, simulated: Array) -> tuple[int, int]:
    """The stretch (first block, last and one) over which a constant beats the simulator by most."""
    seen = np.isfinite(y) & np.isfinite(simulated)
    sums = [
        np.concatenate(([0.0], np.cumsum(np.where(seen, v, 0.0))))
        for v in (np.ones(len(y)), y, np.square(y), np.square(y - simulated))
    ]
    edges = np.unique(np.linspace(0, len(y), _EDGES).astype(int))
    i, j = np.triu_indices(len(edges), 1)
    i, j = edges[i], edges[j]
    n, total, squares, missed = (s[j] - s[i] for s in sums)
    around_mean = squares - total**2 / np.maximum(n, 1.0)
    better = np.where(n >= max(STUCK_SHARE * len(y), FEWEST_SAMPLES), missed - around_mean, -np.inf)
    best = int(np.argmax(better))
    return int(i[best]), int(j[best])


def _variance(values: Array) -> float:
    values = values[np.isfinite(values)]
    return float(np.var(values)) if len(values) >= FEWEST_SAMPLES else 0.0


def _rms(values: Array) -> float:
    values = values[np.isfinite(values)]
    return float(np.sqrt(np.mean(values**2))) if len(values) else 0.0
