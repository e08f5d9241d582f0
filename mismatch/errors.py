"""How far readings and simulator are apart, output by output, before and after what was found is added."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from twinbench.mismatch.diagnosis import Diagnosis, Fit
from twinbench.mismatch.noise import noise_floor
from twinbench.mismatch.proof import piece_squares, resamples
from twinbench.mismatch.tracks import Track
from twinbench.physics.simulator import Array


class OutputError(NamedTuple):
    """One output's error (rms) sample by sample, of the calibrated and of the mended simulator, in its unit.

    Attributes:
        change_low, change_high: 90 % interval of after minus before, paired over pieces of the recordings.
        noise_sd: of the sensor, by what neighbours differ by: a floor, since noise may remember.
    """

    channel: str
    unit: str
    held_out: bool
    rmse_before: float
    rmse_after: float
    change_low: float
    change_high: float
    noise_sd: float


class _Side(NamedTuple):
    """Errors of one simulator on some recordings: sample by sample (ny,), and the residuals of block means."""

    rmse: Array
    residuals: list[Array]


def output_errors(d: Diagnosis) -> tuple[OutputError, ...]:
    """Errors where it learnt, then on what was held out; before is after where nothing is named."""
    whole = [(False, d.tracks, _learnt(d.before), _learnt(d.mended or d.before))]
    if d.held_before is not None:
        before, after = (_Side(h.rmse, h.residuals) for h in (d.held_before, d.held_after or d.held_before))
        whole.append((True, d.held, before, after))
    found = []
    for held_out, tracks, before, after in whole:
        for c, v in enumerate(d.simulator.outputs):
            b, a = (piece_squares(side.residuals, c) for side in (before, after))
            if not len(b) or len(a) != len(b):
                continue
            old, new = float(before.rmse[c]), float(after.rmse[c])
            picks = resamples(len(b))
            # The change sample by sample, spread as the blocks' is.
            spread = np.sqrt(a[picks].mean(axis=1)) - np.sqrt(b[picks].mean(axis=1))
            spread += (new - old) - (np.sqrt(a.mean()) - np.sqrt(b.mean()))
            low, high = np.quantile(spread, (0.05, 0.95)).tolist()
            noise = _sensor_noise(tracks, [r[:, c : c + 1] for r in after.residuals], c)
            found.append(OutputError(v.name, v.unit, held_out, old, new, low, high, noise))
    return tuple(found)


def _learnt(fit: Fit) -> _Side:
    squares = [fit.problem.squares(r, fit.z) for r in range(len(fit.problem.tracks))]
    return _Side(np.asarray(np.sqrt(np.mean(squares, axis=0))), fit.residuals)


def _sensor_noise(tracks: list[Track], residuals: list[Array], channel: int) -> float:
    """Of single readings, by second differences of themselves or of what is left of block means, whichever is less.

    A sensor that reads in steps has the noise of a step at least.
    """
    readings = [t.y[:, channel : channel + 1] for t in tracks]
    samples = float(np.median(np.concatenate([t.coarse.samples for t in tracks])))
    values = np.unique(np.concatenate(readings))
    steps = np.diff(values[np.isfinite(values)])
    least = float(steps.min()) / np.sqrt(12.0) if len(steps) else 0.0
    noise = min(float(noise_floor(readings)[0]), float(noise_floor(residuals)[0]) * np.sqrt(samples))
    return float(max(noise, least))
