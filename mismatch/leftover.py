"""Is what a model leaves of the readings noise? Three signs that it is not, whatever the catalogue holds.

- Errors last too long.
- Errors are far above what the sensor scatters from reading to reading, on recordings that were fitted or held out.
- Errors are far larger on the recordings held out.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from twinbench.mismatch.explanation import Explanation
from twinbench.mismatch.noise import noise_floor
from twinbench.mismatch.proof import Held, piece_squares, resamples
from twinbench.mismatch.tracks import Track
from twinbench.physics.simulator import Array

LASTING = 60.0
"""Blocks to an independent error from which on errors last too long for noise, beyond doubt."""
LOUD = 6.0
"""Times the scatter between neighbours; noise that remembers as much as noise may exceeds it five times."""
WORSE = 2.0
"""Times as large on the held-out recordings as where it was fitted."""


def leftovers(
    e: Explanation, held: Held | None, tracks: Sequence[Track], held_tracks: Sequence[Track], floor: Array
) -> list[str]:
    """Why errors under ``e`` are no noise, in words, for each output where they are none.

    Args:
        held: how ``e`` does on held-out recordings, if there are any.
        tracks: what it was fitted to.
        held_tracks: what was held back.
        floor: (ny,) scatter of block means in ``tracks``, in the outputs' units.
    """
    outputs = e.problem.machine.simulator.outputs
    residuals = e.problem.residuals(e.z)
    memory = np.broadcast_to(e.problem.whitener.memory, len(outputs))
    floor_held = noise_floor([t.means for t in held_tracks]) if held_tracks else floor
    found = []
    for c, v in enumerate(outputs):
        fitted = piece_squares(residuals, c)
        if not len(fitted):
            continue
        rms = float(np.sqrt(np.mean(fitted)))
        scatter = max(float(floor[c]), _step(tracks, c))
        if memory[c] > LASTING:
            found.append(f"the errors of {v.name} last too long for noise")
        elif rms > LOUD * scatter:
            found.append(f"the errors of {v.name} are {rms / scatter:.2g} times what its sensor scatters")
        elif held is not None and len(apart := piece_squares(held.residuals, c)):
            least = np.sqrt(np.quantile(apart[resamples(len(apart))].mean(axis=1), 0.05))
            if least > WORSE * max(rms, scatter):
                times = np.sqrt(np.mean(apart)) / rms
                found.append(f"the errors of {v.name} are {times:.2g} times as large on recordings held back")
            # Readings in disorder scatter as much as they err: those held back tell what the sensor scatters.
            elif least > LOUD * (scatter_held := max(float(floor_held[c]), _step(held_tracks, c))):
                times = np.sqrt(np.mean(apart)) / scatter_held
                found.append(
                    f"the errors of {v.name} are {times:.2g} times what its sensor scatters in recordings held back"
                )
    return found


def _step(tracks: Sequence[Track], channel: int) -> float:
    """What a sensor that reads in steps hides between two of them: the least difference of readings."""
    readings = np.unique(np.concatenate([t.y[:, channel] for t in tracks]))
    steps = np.diff(readings[np.isfinite(readings)])
    return float(steps.min()) if len(steps) else 0.0
