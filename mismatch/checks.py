"""Before and after a fit: are the recordings fit to learn from, and is what is left nothing but noise?"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.stats import chi2, norm

from twinbench.mismatch.naming.sensors import SensorNoise
from twinbench.mismatch.spikes import Spike
from twinbench.mismatch.tracks import LOST, Track, lost
from twinbench.physics.simulator import Array, Simulator

LAGS = 20
MOST_SPIKES_NAMED = 3
"""Spikes that a remark names; the verdict's file holds all."""


class Test(NamedTuple):
    """One test of whitened residuals; ``p`` after Holm's correction over its family."""

    what: str  # "level", "whiteness" or "input"
    recording: str
    channel: str
    statistic: float
    p: float
    says: str


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


def residual_tests(
    tracks: Sequence[Track], residuals: Sequence[Array], noise: SensorNoise, floor: Array, simulator: Simulator
) -> list[Test]:
    """Level against the noise floor, whiteness (Ljung-Box) and correlation with inputs, Holm-corrected.

    Args:
        residuals: block means measured minus simulated, (B, ny) per recording, in the outputs' units.
        noise: of the sensors, which whitens them.
        floor: (ny,) noise of block means by second differences, in the outputs' units.
    """
    found: list[Test] = []
    for track, residual in zip(tracks, residuals, strict=True):
        white = np.where(np.isfinite(residual), noise.whitened(residual[:, :, None])[:, :, 0], np.nan)
        for c, variable in enumerate(simulator.outputs):
            e = white[:, c][np.isfinite(white[:, c])]
            if len(e) < 2 * LAGS:
                continue
            ratio = float(np.nanmean(residual[:, c] ** 2) / max(floor[c], 1e-300) ** 2)
            rho = np.array([np.mean(e[k:] * e[:-k]) for k in range(1, LAGS + 1)]) / np.mean(e**2)
            box = float(len(e) * np.sum(rho**2))
            found.append(
                Test(
                    "whiteness",
                    track.name,
                    variable.name,
                    box,
                    float(chi2.sf(box, LAGS)),
                    f"residual of {variable.name} is autocorrelated; its variance is {ratio:.3g} times the noise floor",
                )
            )
            for i, source in enumerate(simulator.inputs):
                u = np.array([track.u[k, i] for k in track.starts])[np.isfinite(white[:, c])]
                if np.ptp(u) == 0.0:
                    continue
                r = float(np.corrcoef(u, e)[0, 1])
                p = float(2.0 * norm.sf(abs(r) * np.sqrt(len(e))))
                found.append(
                    Test("input", track.name, variable.name, r, p, f"residual of {variable.name} follows {source.name}")
                )
    return [test._replace(p=p) for test, p in zip(found, holm([t.p for t in found]), strict=True)]


def holm(p: Sequence[float]) -> list[float]:
    """Each p after Holm's step-down correction over all of them."""
    worst, corrected = 0.0, list(p)
    for rank, i in enumerate(np.argsort(p, kind="stable")):
        worst = max(worst, min(1.0, p[i] * (len(p) - rank)))
        corrected[i] = worst
    return corrected
