"""The period that stands out in what a fit leaves: what a periodic force is tried with first."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from twinbench.mismatch.tracks import Track
from twinbench.physics.simulator import Array

PADDED = 8
"""Frequencies tried per independent one."""
NEIGHBOURS = 2.0
"""Independent frequencies to either side that a period may turn out to have: beyond, a fit would lose count."""


def loudest_periods_s(tracks: Sequence[Track], white: Sequence[Array], longest_s: float) -> tuple[float, float, float]:
    """Period up to ``longest_s`` at which residuals are loudest, between the least and the greatest it may be, s.

    The recordings share one clock. A linear machine answers a force at the force's own frequency, whichever balance
    it acts on.

    Args:
        white: whitened residuals, (B, ny) per recording.
    """
    known = [np.nan_to_num(w) for w in white]
    gap_s = float(np.median(np.concatenate([np.diff(t.block_time_s) for t in tracks])))
    n = PADDED * max(map(len, known))
    frequencies = np.fft.rfftfreq(n, gap_s)
    power = sum(np.sum(np.abs(np.fft.rfft(w, n, axis=0)) ** 2, axis=1) for w in known)
    near = frequencies[int(np.argmax(np.where(frequencies >= 1.0 / longest_s, power, -1.0)))]
    # Within one recording the period shows roughly, over all of them sharply.
    times_s = np.concatenate([t.coarse.time_s for t in tracks])
    step, width = 1.0 / (PADDED * np.ptp(times_s)), 1.0 / max(np.ptp(t.time_s) for t in tracks)
    fine = near + np.arange(-width, width, step)
    fine = fine[fine >= 1.0 / longest_s]
    values = np.concatenate(known)
    together = [np.sum(np.abs(np.exp(-2j * np.pi * f * times_s) @ values) ** 2) for f in fine]
    loudest = float(fine[int(np.argmax(together))]) if len(fine) else 1.0 / longest_s
    beside = NEIGHBOURS / float(np.ptp(times_s))
    return 1.0 / (loudest + beside), 1.0 / loudest, 1.0 / max(loudest - beside, 0.5 * loudest)
