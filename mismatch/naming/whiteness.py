"""Are the innovations white, the noise learnt anew beside what was found?

The noise is learnt while nothing is named. A force that changes with time alone is then taken for noise, since no
function of the state is like it. What stands in for such a force leaves it in the readings, and the noise of sensors
has no such spectrum.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from twinbench.mismatch.naming.ground import Ground
from twinbench.mismatch.naming.settle import Settled, columns_of
from twinbench.mismatch.naming.view import WANDERS, View
from twinbench.mismatch.noise import BEYOND_DOUBT
from twinbench.mismatch.seed import ENGINE_SEED
from twinbench.physics.simulator import Array


class Band(NamedTuple):
    """The band of frequencies that tells a series most from white noise of variance one.

    Attributes:
        nats: by which it does, the choice among all bands paid for; 0 or less if it does not.
        power: its mean power, in that of white noise.
        lowest, highest: its frequencies, in periods over the whole series.
    """

    nats: float
    power: float
    lowest: int
    highest: int


class Coloured(NamedTuple):
    """What tells innovations most from white noise.

    Attributes:
        nats: by which it does, the choice among outputs and bands paid for; 0 or less if it does not.
        channel: position of the output.
        power: mean power of the band, in that of white noise.
        shortest_s, longest_s: its periods, as sharp as recordings of their length tell them.
    """

    nats: float
    channel: int
    power: float
    shortest_s: float
    longest_s: float

    @property
    def sure(self) -> bool:
        """Is something louder there than noise, beyond doubt?"""
        # Of the cases learnt from, 12 of 26 periodic forces that were wrongly found leave so much at their period, and
        # none of the 31 that were right. With 3 to 20 nats in its place no more than 3 of 100 names were others.
        return self.nats > BEYOND_DOUBT and self.power > 1.0

    def swings_with(self, period_s: float) -> bool:
        """Does what is left of the readings beyond doubt still swing with a period?"""
        return self.sure and self.shortest_s <= period_s <= self.longest_s


def taken_for_noise(chosen: Settled, ground: Ground) -> tuple[View, list[Array]]:
    """The view around where a hypothesis stands; and what it leaves, beside the discrepancy, for the sensors' noise.

    That is (B, ny) per recording, in the outputs' units, NaN where nothing was read.
    """
    view = View.around(chosen.problem, chosen.z)
    columns = columns_of(view, ground, chosen.wanders)
    for one in columns:
        one[:, :, len(chosen.z) :] *= chosen.share / WANDERS
    (G, b, _), rng = chosen.products.over(), np.random.default_rng(ENGINE_SEED)
    return view, ground.noise_drawn(G, b, chosen.prior(ground), view.residuals, columns, rng)


def coloured(chosen: Settled, ground: Ground) -> Coloured:
    """What tells the innovations of a hypothesis most from white noise."""
    noise = taken_for_noise(chosen, ground)[1]
    learnt = ground.noise.learnt(noise, np.sqrt(ground.variance))
    white = [np.where(np.isfinite(n), learnt.whitened(n[:, :, None])[:, :, 0], np.nan) for n in noise]
    channels = [channel[np.isfinite(channel)] for channel in np.concatenate(white).T]
    bands = [told_band(channel) for channel in channels]
    c = int(np.argmax([band.nats for band in bands]))
    track, band = chosen.problem.tracks[0], bands[c]
    seconds = len(channels[c]) * track.block_s
    nats = band.nats - float(np.log(len(bands)))
    half = 0.5 * len(white)  # recordings one behind the other: a line is as wide as one of them is short
    return Coloured(nats, c, band.power, seconds / (band.highest + half), seconds / max(band.lowest - half, 1.0))


def told_band(white: Array) -> Band:
    """The band of a series' frequencies that tells it most from white noise of variance one.

    For a mean power r over m frequencies that is m (r - 1 - log r) nats, by Whittle's likelihood, less the logarithm of
    the number of bands, one of which is chosen. Bands hold 1, 2, 4, ... frequencies, and their halves overlap.

    Args:
        white: (n,) dimensionless.
    """
    n = max(len(white), 1)
    power = np.abs(np.fft.rfft(white, n)[1 : (n + 1) // 2]) ** 2 / n
    total, best, bands, m = np.concatenate(([0.0], np.cumsum(power))), Band(0.0, 1.0, 1, 1), 1, 1
    while m <= len(power):
        first = np.arange(0, len(power) - m + 1, max(1, m // 2))
        mean = np.maximum((total[first + m] - total[first]) / m, np.finfo(float).tiny)
        nats = m * (mean - 1.0 - np.log(mean))
        k = int(np.argmax(nats))
        if nats[k] > best.nats:
            best = Band(float(nats[k]), float(mean[k]), int(first[k]) + 1, int(first[k]) + m)
        bands, m = bands + len(first), 2 * m
    return best._replace(nats=best.nats - float(np.log(bands)))
