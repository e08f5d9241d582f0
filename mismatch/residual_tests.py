"""After a fit: is what is left nothing but noise?"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.stats import chi2, norm

from twinbench.mismatch.checks import holm
from twinbench.mismatch.naming.ground import Ground
from twinbench.mismatch.tracks import Track
from twinbench.physics.simulator import Array, Simulator

LAGS = 20
"""Blocks up to which whitened residuals are held against each other."""


class Test(NamedTuple):
    """One test of whitened residuals; ``p`` after Holm's correction over its family."""

    recording: str
    channel: str
    statistic: float
    p: float
    says: str


def residual_tests(
    tracks: Sequence[Track], residuals: Sequence[Array], ground: Ground, floor: Array, simulator: Simulator
) -> list[Test]:
    """Level against the noise floor, whiteness (Ljung-Box) and correlation with inputs, Holm-corrected.

    Args:
        residuals: block means measured minus simulated, (B, ny) per recording, in the outputs' units.
        ground: whose noise whitens them.
        floor: (ny,) noise of block means by second differences, in the outputs' units.
    """
    found: list[Test] = []
    for k, (track, residual) in enumerate(zip(tracks, residuals, strict=True)):
        white = ground.whitened(k, np.empty((*residual.shape, 0)), residual)[:, 0].reshape(residual.shape)
        white = np.where(np.isfinite(residual), white, np.nan)
        for c, variable in enumerate(simulator.outputs):
            e = white[:, c][np.isfinite(white[:, c])]
            if len(e) < 2 * LAGS:
                continue
            ratio = float(np.nanmean(residual[:, c] ** 2) / max(floor[c], 1e-300) ** 2)
            rho = np.array([np.mean(e[k:] * e[:-k]) for k in range(1, LAGS + 1)]) / np.mean(e**2)
            box = float(len(e) * np.sum(rho**2))
            found.append(
                Test(
                    track.name,
                    variable.name,
                    box,
                    float(chi2.sf(box, LAGS)),
                    f"residual of {variable.name} is autocorrelated; its variance is {ratio:.3g} times the noise floor",
                )
            )
            for i, source in enumerate(simulator.inputs):
                u = track.u[track.starts, i][np.isfinite(white[:, c])]
                if np.ptp(u) == 0.0:
                    continue
                r = float(np.corrcoef(u, e)[0, 1])
                p = float(2.0 * norm.sf(abs(r) * np.sqrt(len(e))))
                found.append(
                    Test(track.name, variable.name, r, p, f"residual of {variable.name} follows {source.name}")
                )
    return [test._replace(p=p) for test, p in zip(found, holm([t.p for t in found]), strict=True)]
