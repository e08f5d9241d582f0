"""Before a fit: are the recordings fit to learn from?"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from twinbench.mismatch.spikes import Spike
from twinbench.mismatch.tracks import LOST, Track, lost
from twinbench.physics.simulator import Simulator

MOST_SPIKES_NAMED = 3
"""Spikes that a remark names; the verdict's file holds all."""


def audit(tracks: Sequence[Track], simulator: Simulator) -> list[str]:
    """What is remarkable about the recordings, in words."""
    remarks = []
    for track in tracks:
        for variable, y in zip(simulator.outputs, track.y.T, strict=True):
            taken = [s for s in track.spikes if s.channel == variable.name]
            # Spikes were recorded: what is missing is what no cell holds.
            missing = float(np.isnan(y).mean()) - len(taken) / len(y)
            if np.isnan(y).all():
                remarks.append(f"{track.name}: {variable.name} was not recorded")
                continue
            if taken:
                remarks.append(f"{track.name}: of {variable.name} {_spikes(taken, len(y))}")
            if lost(y[:, None], len(y) // len(track.starts)) > 2.0 * LOST:
                remarks.append(
                    f"{track.name}: {variable.name} changes faster than {len(track.starts)} means of neighbours show; "
                    "cut the recording into shorter ones"
                )
            if missing > 0.05:
                remarks.append(f"{track.name}: {variable.name} is missing {100 * missing:.0f} % of the time")
            seen = y[~np.isnan(y)]
            ends = np.mean((seen == seen.max()) | (seen == seen.min()))
            if len(np.unique(seen)) < 3:
                remarks.append(f"{track.name}: {variable.name} does not move; it may be stuck")
            elif ends > 0.02:
                share = f"{100 * ends:.0f} %"
                remarks.append(f"{track.name}: {variable.name} is at an end of its range {share} of the time")
        for variable, u in zip(simulator.inputs, track.u.T, strict=True):
            if np.ptp(u) == 0.0:
                remarks.append(f"{track.name}: input {variable.name} is constant; what needs it to move stays hidden")
    return remarks


def _spikes(taken: Sequence[Spike], readings: int) -> str:
    """Which readings were taken out, in words; the first few by name."""
    first = ", ".join(f"{s.value:.4g} at {s.time_s:.6g} s" for s in taken[:MOST_SPIKES_NAMED])
    more = f" and {len(taken) - MOST_SPIKES_NAMED} more" if len(taken) > MOST_SPIKES_NAMED else ""
    what = "one reading was" if len(taken) == 1 else f"{len(taken)} of {readings} readings were"
    return f"{what} taken out as spikes, which the simulator does not follow: {first}{more}"


def holm(p: Sequence[float]) -> list[float]:
    """Each p after Holm's step-down correction over all of them."""
    worst, corrected = 0.0, list(p)
    for rank, i in enumerate(np.argsort(p, kind="stable")):
        worst = max(worst, min(1.0, p[i] * (len(p) - rank)))
        corrected[i] = worst
    return corrected
