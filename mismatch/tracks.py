"""Recordings made ready for a fit: gaps in the inputs held, spikes out, readings averaged in blocks."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
import pandas as pd

from data.recording import Recording
from mismatch.noise import noise_floor
from physics.simulator import Array, Simulator

BLOCKS = 1000
"""Blocks that a long recording is averaged into, more or less: what a fit sees, whatever the sample rate."""
LOST = 0.05
"""Share of an output's variance that averaging may take away; what is faster than blocks needs shorter ones."""
MOST_BLOCKS, SHORTER = 20_000, 0.8
"""Blocks of a recording at most, and the factor by which they are made shorter."""
DOUBT = 1.2
"""The noise's variance may be so many times what neighbours say it is."""
BEGIN = 5
"""Blocks at the start that are stepped through sample by sample."""
SEEN = 0.6
"""Share of a block's readings that must be there."""
_HAMPEL_WINDOW, _HAMPEL_SIGMAS = 15, 6.0


class Grid(NamedTuple):
    """Stretches of constant input that a run goes through: single samples, or blocks of them.

    Attributes:
        time_s: (B,) middle of each stretch's samples.
        seconds: (B,) how long each lasts.
        u: (B, nu) inputs, the mean over the samples.
        samples: (B,) how many samples each holds.
    """

    time_s: Array
    seconds: Array
    u: Array
    samples: np.ndarray


@dataclass(frozen=True)
class Track:
    """One recording, N samples.

    Attributes:
        time_s: (N,).
        u: (N, nu), without gaps.
        y: (N, ny), NaN where missing or a spike.
        starts: (B,) first sample of each block.
        means: (B, ny) block means of y; NaN where a block lacks too many readings.
        level: (ny,) variance of its noise, that of the fitted recordings being 1.
    """

    name: str
    time_s: Array
    u: Array
    y: Array
    starts: np.ndarray
    means: Array
    level: Array | float = 1.0
    _splits: dict[int, Grid] = field(default_factory=dict, init=False, repr=False, compare=False)

    def block_means(self, readings: Array) -> Array:
        """Means (B, ny) of simulated readings (N, ny) over the samples that were measured too."""
        return _means(np.where(np.isnan(self.y), np.nan, readings), self.starts)

    def without(self, channel: int, since_s: float, until_s: float) -> Track:
        """The same without a channel's readings of some time."""
        y = self.y.copy()
        y[(self.time_s >= since_s) & (self.time_s <= until_s), channel] = np.nan
        return replace(self, y=y, means=_means(y, self.starts))

    @cached_property
    def fine(self) -> Grid:
        """Sample by sample."""
        return self.grid(self.u, np.arange(len(self.time_s)))

    @cached_property
    def coarse(self) -> Grid:
        """Block by block."""
        return self.grid(self.u, self.starts)

    def split(self, parts: int) -> Grid:
        """Blocks in so many parts each, or sample by sample where they hold fewer, and at the start."""
        if parts not in self._splits:
            self._splits[parts] = self.grid(self.u, self.split_starts(parts))
        return self._splits[parts]

    def split_starts(self, parts: int) -> np.ndarray:
        """First samples of the parts of blocks; what a start state lets loose dies away faster than blocks show."""
        counts = self.coarse.samples
        begin = np.arange(counts[:BEGIN].sum())
        return np.unique(np.concatenate([begin, *(self.starts + k * counts // parts for k in range(parts))]))

    def joined(self, values: Array, grid: Grid) -> Array:
        """Means (B, n) over blocks of what holds over the parts (P, n) that they were split in."""
        if len(values) == len(self.starts):
            return values
        ends = np.cumsum(grid.samples)
        first = np.searchsorted(ends, self.starts, side="right")
        return np.asarray(np.add.reduceat(values * grid.samples[:, None], first) / self.coarse.samples[:, None])

    def grid(self, u: Array, starts: np.ndarray) -> Grid:
        """Stretches that begin at the samples ``starts``, with inputs u (N, nu)."""
        counts = np.diff(np.append(starts, len(self.time_s)))
        last = self.time_s[-1:] + np.diff(self.time_s)[-1:]
        edges = np.concatenate((self.time_s[starts], last))
        shape = counts[:, None]
        return Grid(
            np.add.reduceat(self.time_s, starts) / counts, np.diff(edges), np.add.reduceat(u, starts) / shape, counts
        )

    @property
    def block_time_s(self) -> Array:
        """Time at the start of each block, (B,)."""
        return self.time_s[self.starts]


def prepare(recordings: Sequence[Recording], simulator: Simulator, blocks: int = BLOCKS) -> list[Track]:
    """Tracks of recordings whose channels hold the simulator's inputs and outputs."""
    inputs, outputs = ([v.name for v in group] for group in (simulator.inputs, simulator.outputs))
    tracks = []
    for recording in recordings:
        place = {channel: i for i, channel in enumerate(recording.channels)}
        u = held(recording.values[:, [place[name] for name in inputs]])
        missing = np.full(len(recording.time_s), np.nan)
        y = np.stack([recording.values[:, place[n]] if n in place else missing for n in outputs], axis=-1)
        y = np.stack([despiked(column) for column in y.T], axis=-1)
        starts = np.arange(0, len(y), samples_per_block(y, blocks))
        tracks.append(Track(recording.name, recording.time_s, u, y, starts, _means(y, starts)))
    return tracks


def samples_per_block(y: Array, blocks: int = BLOCKS) -> int:
    """As many as leave so many blocks, but so few that what the outputs (N, ny) do is still seen in the means."""
    n, least = max(1, round(len(y) / blocks)), max(1, len(y) // MOST_BLOCKS)
    while n > least and (lost(y, n) > LOST).any():
        n = max(least, int(SHORTER * n))
    return n


def lost(y: Array, n: int) -> Array:
    """Share (ny,) of the outputs' variance, noise apart, that means over n samples do not show."""
    noise = noise_floor([y]) ** 2
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # an output that was not recorded
        whole, left = np.nanvar(y, axis=0), np.nanvar(_means(y, np.arange(0, len(y), n)), axis=0)
        return np.nan_to_num((whole - left - DOUBT * (1.0 - 1.0 / n) * noise) / whole)


def held(values: Array) -> Array:
    """Columns with the last value held over NaN; leading gaps take the first value there is."""
    return np.array(pd.DataFrame(values).ffill().bfill(), dtype=float, order="C")


def despiked(values: Array) -> Array:
    """Readings (N,) with isolated outliers as NaN: Hampel's test over 15 samples at six robust sigmas.

    The spread is at least that of the whole record's differences, so that steps and steady pieces stay.
    """
    series = pd.Series(values)
    median = series.rolling(_HAMPEL_WINDOW, center=True, min_periods=3).median()
    away = (series - median).abs()
    spread = 1.4826 * away.rolling(_HAMPEL_WINDOW, center=True, min_periods=3).median()
    steps = np.abs(np.diff(values[~np.isnan(values)]))
    floor = 1.4826 * np.median(steps) / np.sqrt(2.0) if len(steps) else 0.0
    wide = np.maximum(spread.to_numpy(), floor)
    with np.errstate(invalid="ignore"):
        return np.where((wide > 0) & (away.to_numpy() > _HAMPEL_SIGMAS * wide), np.nan, values)


def _means(values: Array, starts: np.ndarray) -> Array:
    seen = ~np.isnan(values)
    counts = np.add.reduceat(seen, starts, axis=0, dtype=float)
    sums = np.add.reduceat(np.where(seen, values, 0.0), starts, axis=0)
    # What is missing is missing where a reading jumps, often; half a block is not a block then.
    whole = np.add.reduceat(np.ones_like(values), starts, axis=0)
    return np.where(counts > SEEN * whole, sums / np.maximum(counts, 1.0), np.nan)
