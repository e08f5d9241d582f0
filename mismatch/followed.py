"""Does a simulator follow what an output does? Agreement with an output that it does not follow is none."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from twinbench.mismatch.noise import noise_floor
from twinbench.mismatch.proof import RESAMPLED_PIECES, piece_squares, resamples
from twinbench.mismatch.tracks import Track
from twinbench.physics.simulator import Array, Variable

LOUD = 6.0
"""Times the scatter between neighbours; noise that remembers as much as noise may exceeds it five times."""
STRANGE = 2.0
"""Times as large an error on held-out recordings as where it was fitted is none of the sensor's."""
IMPLAUSIBLE = 0.3
"""Noise of so much of an output's scale is no sensor's, and of an input's no recorder's; a smaller share asks of noisy
sensors to be followed."""


class Followed(NamedTuple):
    """How much of what an output does a simulator explains.

    Attributes:
        held_out: told by recordings held back; by those learnt from if not.
        explained: share of the variance around each recording's mean, with a 90 % interval over pieces; below nothing
            where a constant would do better.
        sd: of the readings around each recording's mean, in ``unit``.
        noise_sd: of the sensor, by what neighbours differ by.
        follows: it explains something beyond chance, or there is nothing to explain.
    """

    channel: str
    unit: str
    held_out: bool
    explained: float
    low: float
    high: float
    sd: float
    noise_sd: float
    follows: bool


def told_followed(
    tracks: Sequence[Track], residuals: Sequence[Array], outputs: Sequence[Variable], held_out: bool
) -> tuple[Followed, ...]:
    """Output by output, for those that were recorded.

    There is something to explain where readings vary by more than noise can, and where what looks like noise is as
    large as what the output commonly does: so looks a column whose rows are in a wrong order.

    Args:
        residuals: block means measured minus simulated, (B, ny) per recording, in the outputs' units.
    """
    found = []
    for c, v in enumerate(outputs):
        pairs = [
            pair
            for track, residual in zip(tracks, residuals, strict=True)
            for pair in _pieces(track.means[:, c], residual[:, c])
        ]
        if len(pairs) < 2:
            continue
        whole, left = np.array(pairs).T
        picks = resamples(len(pairs))
        if not whole.sum() > 0.0:
            continue
        shares = 1.0 - left[picks].sum(axis=1) / np.maximum(whole[picks].sum(axis=1), 1e-300)
        low, high = np.quantile(shares, (0.05, 0.95)).tolist()
        n = sum(int(np.isfinite(t.means[:, c]).sum()) for t in tracks)
        noise, sd = float(noise_floor([t.means[:, c : c + 1] for t in tracks])[0]), float(np.sqrt(whole.sum() / n))
        to_explain = sd > LOUD * noise or noise > IMPLAUSIBLE * v.scale
        explained = 1.0 - float(left.sum() / whole.sum())
        found.append(
            Followed(v.name, v.unit, held_out, explained, low, high, sd, noise, bool(low > 0.0 or not to_explain))
        )
    return tuple(found)


def strangers(
    learnt: Sequence[Array], held: Sequence[Array], outputs: Sequence[Variable], floor: Array
) -> tuple[str, ...]:
    """Outputs whose error on the held-out recordings is not what it was where a simulator was fitted, in words.

    Args:
        learnt: residuals where it was fitted, (B, ny) per recording, in the outputs' units.
        held: likewise, on held-out recordings.
        floor: (ny,) scatter of block means where it was fitted, in the outputs' units.
    """
    found = []
    for c, v in enumerate(outputs):
        here, there = piece_squares(learnt, c), piece_squares(held, c)
        if not len(here) or not len(there):
            continue
        usual = max(float(np.sqrt(here.mean())), float(floor[c]))
        least = np.sqrt(np.quantile(there[resamples(len(there))].mean(axis=1), 0.05))
        scatter_here, scatter_there = (
            float(noise_floor([r[:, c : c + 1] for r in each])[0]) for each in (learnt, held)
        )
        if least > STRANGE * usual:
            times = np.sqrt(there.mean()) / usual
            found.append(f"the errors of {v.name} are {times:.2g} times as large on recordings held back")
        elif least > LOUD * scatter_there and scatter_here > LOUD * scatter_there > 0.0:
            # Noise so loud where it learnt would hide all that it does not follow.
            found.append(
                f"the readings of {v.name} scatter {scatter_here / scatter_there:.2g} times as much where it learnt as "
                "in recordings held back, which it does not follow to within their scatter"
            )
    return tuple(found)


def _pieces(y: Array, residual: Array) -> list[tuple[float, float]]:
    """Squares around the recording's mean, and those that are left, of pieces of it."""
    seen = np.isfinite(y) & np.isfinite(residual)
    if not seen.any():
        return []
    off = np.where(seen, y - y[seen].mean(), 0.0)
    left = np.where(seen, residual, 0.0)
    cut = zip(np.array_split(off, RESAMPLED_PIECES), np.array_split(left, RESAMPLED_PIECES), strict=True)
    return [(float(np.sum(a**2)), float(np.sum(b**2))) for a, b in cut]
