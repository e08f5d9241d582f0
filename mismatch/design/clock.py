"""How an experiment is sampled and read, next to recordings."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from twinbench.mismatch.sensors import SensorNoise
from twinbench.mismatch.tracks import Track


@dataclass(frozen=True)
class Clock:
    """How an experiment is sampled and read.

    Attributes:
        begin_s: when it begins, on the recordings' clock.
        block: samples in a block, whose mean counts.
        linear: do inputs go in lines from sample to sample?
        noise: of those means.
    """

    begin_s: float
    block: int
    linear: bool
    noise: SensorNoise


def clock_of(tracks: Sequence[Track], noise: SensorNoise, sampling_s: float, linear: bool) -> Clock:
    """How an experiment is read: in blocks as long as the recordings', with the noise that theirs have.

    Args:
        sampling_s: between the experiment's samples; of fewer samples in a block the white noise is larger.
    """
    track = tracks[0]
    samples = int(track.starts[1]) if len(track.starts) > 1 else 1
    block = max(1, round(track.block_s / sampling_s))
    longer = block * sampling_s / track.block_s
    scaled = SensorNoise(noise.white * samples / block, noise.coloured, noise.memory / longer)
    return Clock(max(float(t.time_s[-1]) for t in tracks) + track.block_s, block, linear, scaled)
