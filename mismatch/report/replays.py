"""Each recording beside what the simulator makes of it, before and after what was found is added."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from twinbench.mismatch.diagnosis import Diagnosis
from twinbench.mismatch.tracks import Track
from twinbench.physics.simulator import Array


class Replay(NamedTuple):
    """One recording of B blocks.

    Attributes:
        before: (B, ny) measured minus simulated, in the outputs' units.
        after: (B, ny) likewise, with what was found; None if nothing was added.
    """

    track: Track
    held_out: bool
    before: Array
    after: Array | None


def replays(d: Diagnosis) -> list[Replay]:
    """All recordings of a diagnosis, the held-out ones first."""
    shown = []
    if d.held_before is not None:
        after = d.held_after.residuals if d.held_after is not None else [None] * len(d.held)
        shown += [Replay(t, True, b, a) for t, b, a in zip(d.held, d.held_before.residuals, after, strict=True)]
    after = d.mended.residuals if d.mended is not None else [None] * len(d.tracks)
    return shown + [Replay(t, False, b, a) for t, b, a in zip(d.tracks, d.before.residuals, after, strict=True)]


def most_telling(some: Sequence[Replay], sd: Array, most: int = 2) -> tuple[Replay, list[int]]:
    """The recording in which most is removed, or is wrong if nothing was added, and its most telling outputs.

    Args:
        sd: (ny,) standard deviation of the noise of block means, in the outputs' units.
    """
    scores = [_score(r, sd) for r in some]
    best = max(range(len(some)), key=lambda r: np.nansum(scores[r]))
    order = [int(c) for c in np.argsort(-np.nan_to_num(scores[best], nan=-np.inf)) if np.isfinite(scores[best][c])]
    return some[best], order[:most]


def _score(replay: Replay, sd: Array) -> Array:
    """What is removed (or wrong), in noise variances summed over the blocks, (ny,); NaN where nothing was measured."""
    left = 0.0 if replay.after is None else (replay.after / sd) ** 2
    power = (replay.before / sd) ** 2 - left
    return np.where(np.isfinite(power).any(axis=0), np.nansum(power, axis=0), np.nan)


def level(residual: Array, sd: Array) -> float:
    """Root mean square (any number of blocks, ny) in standard deviations of the noise; NaN without a reading.

    Args:
        residual: (n, ny), any number of blocks, in the outputs' units.
        sd: (ny,) standard deviation of the noise of block means, in the outputs' units.
    """
    z = residual / sd
    z = z[np.isfinite(z)]
    return float(np.sqrt(np.mean(z**2))) if len(z) else np.nan


def window(replay: Replay, channel: int, blocks: int) -> slice:
    """The blocks in a row in which before and after differ most, or the error is largest if nothing was added."""
    after = 0.0 if replay.after is None else replay.after[:, channel]
    power = np.nan_to_num((replay.before[:, channel] - after) ** 2)
    blocks = min(blocks, len(power))
    sums = np.convolve(power, np.ones(blocks), mode="valid")
    start = int(np.argmax(sums))
    return slice(start, start + blocks)
