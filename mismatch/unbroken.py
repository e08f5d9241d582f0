"""Recordings cut where an input was not recorded and has moved on: each part begins where it begins.

A gap in an input is held over. Where the input is another one after it, the machine did meanwhile what no simulator can
know, and remembers it for a while.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from twinbench.data.recording import Recording
from twinbench.mismatch.followed import IMPLAUSIBLE
from twinbench.mismatch.noise import noise_floor
from twinbench.mismatch.series import held
from twinbench.mismatch.words import listed
from twinbench.physics.simulator import Array, Simulator

SILENT = 5.0
"""Times the usual time between two values of an input (its 95 % quantile) from which it was not recorded."""
MOVED_ON = 0.1
"""Share of the input's standard deviation by which it has moved on over a gap, beyond its noise: less is held over."""
BEYOND_NOISE = 6.0
"""Times its noise by which it has moved on, too: over one gap in 50,000 noise alone differs by so much."""
FEWEST_IN_PART = 60
"""Samples that a part needs: twice the blocks that a recording must have."""
PART = " (part "
"""What stands between the name of a recording and the number of its part."""


def whole(name: str) -> str:
    """The recording that one of this name is, or is a part of."""
    return name.partition(PART)[0]


def unbroken(recording: Recording, simulator: Simulator) -> tuple[list[Recording], str]:
    """Its parts, in order, and a remark where it was cut; itself where none of its parts would be long enough."""
    gaps: list[tuple[float, float]] = []
    broken, values = [], recording.values.copy()
    for v in simulator.inputs:
        column = recording.channels.index(v.name)
        own = _gaps(recording.time_s, values[:, column], v.scale)
        broken += [v.name] if own else []
        gaps += own
        values[:, column] = held(values[:, column])  # a part still knows what was last recorded before it
    if not gaps:
        return [recording], ""
    parts = _between(replace(recording, values=values), gaps)
    if not parts:
        return [recording], f"{recording.name}: {listed(broken)} moved on while not recorded, too often to cut it there"
    if len(parts) > 1:
        parts = [replace(part, name=f"{recording.name}{PART}{k})") for k, part in enumerate(parts, 1)]
    kept = sum(len(part.time_s) for part in parts) / len(recording.time_s)
    return parts, (
        f"{recording.name}: {listed(broken)} moved on while not recorded, first at {min(gaps)[0]:.6g} s; it is cut "
        f"there, and {100.0 * kept:.0f} % of its samples are in parts long enough"
    )


def _gaps(time_s: Array, values: Array, scale: float) -> list[tuple[float, float]]:
    """Last time before and first time after each gap in an input's record (N,) over which it moved on."""
    seen = np.flatnonzero(np.isfinite(values))
    if len(seen) < FEWEST_IN_PART:
        return []
    apart_s, moved = np.diff(time_s[seen]), np.abs(np.diff(values[seen]))
    long = apart_s > SILENT * np.quantile(apart_s, 0.95)
    noise = float(noise_floor([values[seen, None]])[0])
    if noise > IMPLAUSIBLE * scale:
        noise = 0.0  # it jumps from sample to sample by itself
    which = np.flatnonzero(long & (moved > max(MOVED_ON * float(np.std(values[seen])), BEYOND_NOISE * noise)))
    return [(float(time_s[seen[k]]), float(time_s[seen[k + 1]])) for k in which]


def _between(recording: Recording, gaps: Sequence[tuple[float, float]]) -> list[Recording]:
    """Parts with no gap in them that are long enough."""
    t = recording.time_s
    lost = np.zeros(len(t), dtype=bool)
    cuts = np.zeros(len(t), dtype=bool)
    for begin, end in gaps:
        lost |= (t > begin) & (t < end)
        cuts |= t == end
    number = np.cumsum(cuts)
    parts = (np.flatnonzero((number == k) & ~lost) for k in range(int(number[-1]) + 1))
    long = [rows for rows in parts if len(rows) >= FEWEST_IN_PART]
    return [replace(recording, time_s=t[rows], values=recording.values[rows]) for rows in long]
