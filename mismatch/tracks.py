"""Recordings made ready for a fit: gaps in the inputs held, spikes out, readings averaged in blocks."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from twinbench.data.recording import Recording
from twinbench.mismatch.noise import noise_floor, summed
from twinbench.mismatch.series import held
from twinbench.mismatch.spikes import Spike, find_spikes, is_followed
from twinbench.physics.simulator import Array, Simulator

BLOCKS = 1000
"""Blocks that a long recording is averaged into, or up to twice as many: what a fit sees, whatever the sample rate. Of
recordings of several lengths the mean one is. Their blocks last equally long, so that their noise is the same."""
FEWEST_SAMPLES = 30
"""Samples that a recording has at least, and blocks of the shortest one; of fewer readings there is no variance."""
LOST = 0.05
"""Share of an output's variance that averaging may take away; what is faster than blocks needs shorter ones."""
MOST_BLOCKS, SHORTER = 20_000, 0.8
"""Blocks of a recording at most, and the factor by which they are made shorter."""
DOUBT = 1.2
"""The noise's variance may be so many times what neighbours say it is."""
STEPPED_BLOCKS = 5
"""Blocks at the start that are stepped through sample by sample."""
SEEN_SHARE = 0.6
"""Share of a block's readings that must be there."""
LINES = 4
"""Parts of a sample in each of which an input that is joined by lines counts as its mean; what that leaves out falls
with their square."""


class Grid(NamedTuple):
    """Stretches of constant input that a run goes through: single samples, blocks of them, or parts of a sample.

    Attributes:
        time_s: (B,) seconds, middle of each stretch's samples.
        seconds: (B,) how many seconds each lasts; nothing where an input that moves on is only read with.
        u: (B, nu) inputs in their units, the mean over the stretch.
        samples: (B,) how many samples each holds; none in the parts of one after its reading.
        begun: (B,) positions of the samples' stretches that each is, or is a part of.
    """

    time_s: Array
    seconds: Array
    u: Array
    samples: np.ndarray
    begun: np.ndarray


@dataclass(frozen=True)
class Track:
    """One recording, N samples.

    Attributes:
        time_s: (N,) seconds.
        u: (N, nu) in the inputs' units, without gaps.
        y: (N, ny) in the outputs' units, NaN where missing or a spike.
        starts: (B,) positions of each block's first sample.
        means: (B, ny) block means of y, in the outputs' units; NaN where a block lacks too many readings.
        linear: inputs go in lines from sample to sample; if not, each holds until the next.
        spikes: the readings that were taken out.
    """

    name: str
    time_s: Array
    u: Array
    y: Array
    starts: np.ndarray
    means: Array
    linear: bool = False
    spikes: tuple[Spike, ...] = ()
    _splits: dict[int, Grid] = field(default_factory=dict, init=False, repr=False, compare=False)

    def block_means(self, readings: Array) -> Array:
        """Means (B, ny) of simulated readings (N, ny) over the samples that were measured too.

        Args:
            readings: (N, ny) simulated, in the outputs' units.
        """
        return _means(np.where(np.isnan(self.y), np.nan, readings), self.starts)

    def reading(self, y: Array) -> Track:
        """The same with other readings.

        Args:
            y: (N, ny) in the outputs' units; NaN where missing.
        """
        return replace(self, y=y, means=_means(y, self.starts))

    def driven_by(self, column: int, values: Array) -> Track:
        """The same with another record of an input.

        Args:
            values: (N,) in the input's unit.
        """
        u = self.u.copy()
        u[:, column] = values
        return replace(self, u=u)

    def without(self, channel: int, since_s: float, until_s: float) -> Track:
        """The same without a channel's readings of some time."""
        y = self.y.copy()
        y[(self.time_s >= since_s) & (self.time_s <= until_s), channel] = np.nan
        return self.reading(y)

    def followed(self, readings: Array) -> Track:
        """With those spikes put back that simulated readings (N, ny) show as well.

        Args:
            readings: (N, ny) simulated, in the outputs' units.
        """
        y = self.y.copy()
        for spike in self.spikes:
            y[spike.sample, spike.column] = spike.value
        kept = tuple(s for s in self.spikes if not is_followed(y[:, s.column], readings[:, s.column], s.sample))
        if len(kept) == len(self.spikes):
            return self
        for spike in kept:
            y[spike.sample, spike.column] = np.nan
        return replace(self, y=y, means=_means(y, self.starts), spikes=kept)

    @cached_property
    def fine(self) -> Grid:
        """Sample by sample."""
        return self.fine_grid(self.u)

    def fine_grid(self, u: Array) -> Grid:
        """Sample by sample with inputs u (N, nu).

        Args:
            u: (N, nu) inputs in their units.
        """
        return self.grid(u, np.arange(len(self.time_s)), LINES)

    @cached_property
    def coarse(self) -> Grid:
        """Block by block."""
        return self._stretches(self.u, self.starts)

    def split(self, parts: int) -> Grid:
        """Blocks in so many parts each, or sample by sample where they hold fewer, and at the start."""
        if parts not in self._splits:
            self._splits[parts] = self.split_grid(self.u, parts)
        return self._splits[parts]

    def split_grid(self, u: Array, parts: int) -> Grid:
        """As ``split``, with inputs u (N, nu); where they are joined by lines, a sample is split if it has to be.

        Args:
            u: (N, nu) inputs in their units.
        """
        lines = min(max(parts // int(self.coarse.samples.max()), 1), LINES)
        return self.grid(u, self.split_starts(parts), lines)

    @property
    def finest(self) -> int:
        """Parts of a block that are as fine as ``fine``."""
        return int(self.coarse.samples.max()) * (LINES if self.linear else 1)

    def split_starts(self, parts: int) -> np.ndarray:
        """First samples of the parts of blocks; what a start state lets loose dies away faster than blocks show."""
        counts = self.coarse.samples
        begin = np.arange(counts[:STEPPED_BLOCKS].sum())
        return np.unique(np.concatenate([begin, *(self.starts + k * counts // parts for k in range(parts))]))

    def joined(self, values: Array, grid: Grid) -> Array:
        """Means (B, n) over blocks of what holds over the parts (P, n) that they were split in.

        Args:
            values: (P, n) in any unit, what holds over the parts.
            grid: of those parts.
        """
        if len(values) == len(self.starts):
            return values
        samples, first = self._parts(grid)
        return np.asarray(np.add.reduceat(values * samples[:, None], first) / self.coarse.samples[:, None])

    def spread(self, values: Array, grid: Grid) -> Array:
        """The transpose of ``joined``: weights (P, n) of the parts by those of the blocks (B, n).

        Args:
            values: (B, n) in any unit.
            grid: of those parts.
        """
        samples, first = self._parts(grid)
        if len(samples) == len(self.starts):
            return values
        block = np.repeat(np.arange(len(values)), np.diff(np.append(first, len(samples))))
        return np.asarray(values[block] * (samples / self.coarse.samples[block])[:, None])

    def _parts(self, grid: Grid) -> tuple[np.ndarray, np.ndarray]:
        """Samples of each part, and the position of each block's first part."""
        samples = grid.samples[grid.samples > 0]
        return samples, np.searchsorted(np.cumsum(samples), self.starts, side="right")

    def grid(self, u: Array, starts: np.ndarray, lines: int = 1) -> Grid:
        """Stretches that begin at the samples ``starts``, with inputs u (N, nu).

        Args:
            u: (N, nu) inputs in their units.
            starts: (B,) positions of the stretches' first samples.
            lines: parts of a stretch of one sample, where inputs are joined by lines.
        """
        if not self.linear:
            return self._stretches(u, starts)
        ahead = np.concatenate((u[1:], u[-1:]))
        plain = self._stretches(0.5 * (u + ahead), starts)
        single = plain.samples == 1
        rows = np.where(single, 1 + lines, 1)
        begun = np.repeat(np.arange(len(starts)), rows)
        place = np.arange(len(begun)) - np.repeat(np.cumsum(rows) - rows, rows)
        # A sample is read under its own input, in no time; then the input moves on in parts.
        share = np.where(single[begun] & (place > 0), (place - 0.5) / lines, 0.0)
        at, alone = starts[begun], single[begun, None]
        seconds = plain.seconds[begun] * np.where(single[begun], np.where(place > 0, 1.0 / lines, 0.0), 1.0)
        return Grid(
            plain.time_s[begun] + share * plain.seconds[begun],
            seconds,
            np.where(alone, u[at] + share[:, None] * (ahead[at] - u[at]), plain.u[begun]),
            np.where(place > 0, 0, plain.samples[begun]),
            begun,
        )

    def _stretches(self, u: Array, starts: np.ndarray) -> Grid:
        counts = np.diff(np.append(starts, len(self.time_s)))
        last = self.time_s[-1:] + np.diff(self.time_s)[-1:]
        edges = np.concatenate((self.time_s[starts], last))
        return Grid(
            np.add.reduceat(self.time_s, starts) / counts,
            np.diff(edges),
            np.add.reduceat(u, starts) / counts[:, None],
            counts,
            np.arange(len(starts)),
        )

    @property
    def block_time_s(self) -> Array:
        """Time at the start of each block, (B,)."""
        return self.time_s[self.starts]

    @property
    def block_s(self) -> float:
        """How long a block lasts, s."""
        samples = int(self.starts[1]) if len(self.starts) > 1 else len(self.y)
        return samples * _period_s(self.time_s)


def prepare(
    recordings: Sequence[Recording],
    simulator: Simulator,
    blocks: int = BLOCKS,
    linear: bool = False,
    like: Sequence[Track] = (),
    shortest_s: float = np.inf,
) -> list[Track]:
    """Tracks of recordings whose channels hold the simulator's inputs and outputs.

    Args:
        blocks: of the mean recording.
        linear: inputs go in lines from sample to sample.
        like: tracks whose blocks last as long, in place of so many blocks.
        shortest_s: a recording of this length is to have blocks as long too.
    """
    inputs, outputs = ([v.name for v in group] for group in (simulator.inputs, simulator.outputs))
    found = []
    for recording in recordings:
        place = {channel: i for i, channel in enumerate(recording.channels)}
        u = held(recording.values[:, [place[name] for name in inputs]])
        missing = np.full(len(recording.time_s), np.nan)
        y = np.stack([recording.values[:, place[n]] if n in place else missing for n in outputs], axis=-1)
        spikes = tuple(
            Spike(recording.name, channel, float(recording.time_s[k]), float(y[k, c]), int(k), c)
            for c, channel in enumerate(outputs)
            for k in find_spikes(y[:, c])
        )
        for spike in spikes:
            y[spike.sample, spike.column] = np.nan
        found.append((recording, u, y, spikes))
    periods_s = [_period_s(recording.time_s) for recording in recordings]
    series = [y for _, _, y, _ in found]
    block_s = like[0].block_s if like else block_seconds(series, periods_s, blocks, shortest_s)
    tracks = []
    for (recording, u, y, spikes), period_s in zip(found, periods_s, strict=True):
        starts = np.arange(0, len(y), _samples(block_s, period_s))
        tracks.append(
            Track(recording.name, recording.time_s, u, y, starts, _means(y, starts), linear=linear, spikes=spikes)
        )
    return tracks


def block_seconds(
    series: Sequence[Array], periods_s: Sequence[float], blocks: int = BLOCKS, shortest_s: float = np.inf
) -> float:
    """How long a block lasts, the same in all recordings.

    The mean recording has so many blocks, or more: so many that what the outputs do is still seen in the means, and
    that the shortest recording has ``FEWEST_SAMPLES``. No block is shorter than a sample of the slowest clock.

    Args:
        series: (N, ny) readings of each, in the outputs' units; NaN means missing.
        periods_s: between their samples.
        shortest_s: a recording of this length is one of them.
    """
    slowest, lengths_s = max(periods_s), [len(y) * p for y, p in zip(series, periods_s, strict=True)]
    mean_s = float(np.mean(lengths_s))
    longest = _samples(min(mean_s / blocks, min(shortest_s, *lengths_s) / FEWEST_SAMPLES), slowest, np.floor)
    n, least = longest, min(longest, _samples(mean_s / MOST_BLOCKS, slowest, np.floor))
    while n > least and any(
        (lost(y, _samples(n * slowest, p)) > LOST).any() for y, p in zip(series, periods_s, strict=True)
    ):
        n = max(least, int(SHORTER * n))
    return n * slowest


def _samples(seconds: float, period_s: float, to_whole: Callable[[float], float] = np.round) -> int:
    """Samples in so much time, one at least; of clocks that are not quite even to a millionth."""
    return max(1, int(to_whole(seconds / period_s * (1.0 + 1e-6))))


def _period_s(time_s: Array) -> float:
    return float(np.median(np.diff(time_s)))


def lost(y: Array, n: int) -> Array:
    """Share (ny,) of the outputs' variance, noise apart, that means over n samples do not show.

    Args:
        y: (N, ny) readings in the outputs' units; NaN means missing.
        n: samples in a mean.
    """
    noise = noise_floor([y]) ** 2
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # an output that was not recorded
        whole, left = np.nanvar(y, axis=0), np.nanvar(_means(y, np.arange(0, len(y), n)), axis=0)
        return np.nan_to_num((whole - left - DOUBT * (1.0 - 1.0 / n) * noise) / whole)


def _means(values: Array, starts: np.ndarray) -> Array:
    sums, counts = summed(values, starts)
    # What is missing is missing where a reading jumps, often; half a block is not a block then.
    whole = np.add.reduceat(np.ones_like(values), starts, axis=0)
    return np.where(counts > SEEN_SHARE * whole, sums / np.maximum(counts, 1.0), np.nan)
