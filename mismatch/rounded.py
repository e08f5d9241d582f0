"""Sensors that move in steps: found by themselves, since no fit goes from a step of no size to one.

The difference between a rounded reading and its value is a saw tooth that depends on the step, and its phase on the
reading. Every step that may be is tried against what the calibrated simulator leaves, sample by sample.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numba import njit
from scipy.fft import next_fast_len, rfft, rfftfreq

from twinbench.mismatch.tracks import Track
from twinbench.physics.simulator import Array

ROUNDS = "sensor_quantisation@"
"""How the fault's name begins."""
FEWEST_STEPS = 2.0
"""Steps that a channel must go through; with fewer, a step is any jump."""
FINEST_SD = 0.5
"""Of the noise, that a step must be: of a finer one the saw tooth is a twentieth of the noise's variance."""
TURNED = 0.15
"""Of a turn, by which the waves of two steps that are tried differ: less finds no more."""
PIECES = 60
"""Pieces of all recordings together. By how much they disagree tells chance: a misfit agrees with a saw tooth here and
not there, a sensor that moves in steps does everywhere."""
SURE = 12.0
"""Nats beyond a choice among all steps tried that speak for one: 1 in 160,000 sound sensors has so many by chance."""
WHOLE = (0.5, 1.5)
"""Size of the saw tooth, as a share of the step's own, beyond which it is something else."""
PLAIN_STEPS = 3.0
"""Of the recorder's resolution, that a step must be: a finer one is the recorder's, and known to all."""
TRENDS = (0.0, 0.02, 0.1)
"""Shares of a recording over which the simulator may be off: a saw tooth averages out over them, a misfit does not."""
FEWEST_ROUNDED = 100
"""Fewer say nothing of a step."""
MOST_STEPS = 1e5
"""Steps over what a channel goes through, at most: a converter of 16 bits has 65,536."""
CELLS = 8
"""Parts of a step in which readings count as equal: so many leave 0.97 of its first wave."""
_SCANNED, _PEAKS, _AROUND = 3000, 8, 15


class Rounded(NamedTuple):
    """A sensor that moves in steps.

    Attributes:
        channel: position of the output.
        step: in its unit.
        nats: for that step, against a sensor without, the choice among steps taken off.
    """

    channel: int
    step: float
    nats: float


def find_rounded(tracks: Sequence[Track], readings: Sequence[Array], channels: Sequence[int]) -> list[Rounded]:
    """The sensors that plainly move in steps.

    Args:
        readings: (N, ny) simulated per recording, in the outputs' units.
        channels: positions of the outputs that may.
    """
    found = []
    for c in channels:
        for share in TRENDS:
            one = _of_channel(c, [t.y[:, c] for t in tracks], [r[:, c] for r in readings], share)
            if one is not None:  # what needs no trend is told without one
                found.append(one)
                break
    return found


def _of_channel(c: int, y: Sequence[Array], simulated: Sequence[Array], share: float) -> Rounded | None:
    """The likeliest step, if it is plain.

    Args:
        y: (N,) per recording, in the channel's unit.
        simulated: (N,) per recording, likewise.
        share: of a recording, over which what is left is averaged and counts as the simulator's.
    """
    trends = [_trend(a - b, share) for a, b in zip(y, simulated, strict=True)]
    at = np.concatenate([b + t for b, t in zip(simulated, trends, strict=True)])
    begins = np.concatenate([np.arange(len(a)) == 0 for a in y])
    left = np.concatenate(y) - at
    seen = np.isfinite(left)
    at, left, begins = at[seen], left[seen], begins[seen]
    if len(left) < FEWEST_ROUNDED:
        return None
    sd = float(np.median(np.abs(np.diff(left)))) / 0.954  # of a normal difference's sd, sqrt(2) of the noise's
    span, most = float(np.ptp(at)), float(np.abs(at).max())
    finest = max(FINEST_SD * sd, PLAIN_STEPS * _resolution(np.concatenate(y)[seen]), span / MOST_STEPS)
    if not 0.0 < finest < span / FEWEST_STEPS:
        return None
    some = slice(None, None, max(1, len(left) // _SCANNED))
    middle, coarse, fine = np.median(left), TURNED / span, TURNED / most
    # A wave of free phase first; then the phase that a step has at the channel's zero, which tells it most finely.
    rates, power = _waves(at, left - middle, finest, coarse)
    told = (rates > FEWEST_STEPS / span) & (rates < 1.0 / finest)
    peaks = _highest(rates[told], power[told])
    rates = np.maximum(peaks[:, None] + np.arange(-coarse, coarse, fine), FEWEST_STEPS / span).ravel()
    peaks = _highest(rates, _agreement(at[some], left[some] - middle, 1.0 / rates))
    tried = (peaks[:, None] + fine * np.linspace(-1.0, 1.0, _AROUND)).ravel()
    many = len(TRENDS) * _AROUND / (finest * fine)
    pieces = np.unique(np.concatenate((np.flatnonzero(begins), np.linspace(0, len(left) - 1, PIECES).astype(int)[:-1])))
    best = Rounded(c, 0.0, -np.inf)
    for step in 1.0 / tried:
        tooth = np.round(at / step) * step - at
        products, squares = (np.add.reduceat(tooth * v, pieces) for v in (left - middle, tooth))
        square, product = float(squares.sum()), float(products.sum())
        scatter = float(np.sum((products - product / max(square, 1e-300) * squares) ** 2))
        log = 0.5 * product**2 / max(scatter, 1e-300) - np.log(many)
        if log > best.nats and WHOLE[0] * square < product < WHOLE[1] * square:
            best = Rounded(c, float(step), float(log))
    return best if best.nats > SURE else None


def _trend(left: Array, share: float) -> Array:
    """Means over a share of a recording around each sample; nothing for a share of none."""
    half = int(0.5 * share * len(left))
    if half == 0:
        return np.zeros(len(left))
    seen = np.isfinite(left)
    sums, counts = (np.concatenate(([0.0], np.cumsum(v))) for v in (np.where(seen, left, 0.0), seen.astype(float)))
    first = np.maximum(np.arange(len(left)) - half, 0)
    last = np.minimum(np.arange(len(left)) + half + 1, len(left))
    return (sums[last] - sums[first]) / np.maximum(counts[last] - counts[first], 1.0)


def _resolution(y: Array) -> float:
    """The step of the recorder, if all readings lie on one; else some hair."""
    steps = np.diff(np.unique(y))
    steps = steps[steps > 1e-9 * max(float(np.abs(y).max()), 1e-300)]
    return float(steps.min()) if len(steps) else 0.0


def _highest(rates: Array, heights: Array) -> Array:
    return rates[np.argsort(-heights)[:_PEAKS]]


def _waves(at: Array, left: Array, finest: float, coarse: float) -> tuple[Array, Array]:
    """How strongly waves of the value are in what is left: rates, so many to its unit, and powers, (F,) each.

    Args:
        at: (N,) values in the channel's unit.
        left: (N,) in the channel's unit.
        finest: the shortest wave that matters, in the channel's unit.
        coarse: by how much neighbouring rates differ at most.
    """
    width = finest / CELLS
    sums = np.bincount(((at - at.min()) / width).astype(int), left)
    n = next_fast_len(max(len(sums), int(np.ceil(1.0 / (coarse * width)))), real=True)
    return rfftfreq(n, width), np.abs(rfft(sums, n)) ** 2


@njit(cache=True, error_model="numpy")
def _agreement(at: Array, left: Array, steps: Array) -> Array:
    """How far each step's saw tooth, of its own size, agrees with what is left; (F,)."""
    out = np.empty(len(steps))
    for k in range(len(steps)):
        total = 0.0
        for i in range(len(left)):
            tooth = np.floor(at[i] / steps[k] + 0.5) * steps[k] - at[i]
            total += tooth * (left[i] - 0.5 * tooth)
        out[k] = total
    return out
