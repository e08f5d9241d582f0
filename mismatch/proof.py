"""The fit on recordings that were held back: open loop, in another regime, before and after.

Only what a recording has for itself (its start state, its drifts) is found anew; all that the
recordings share stays as it was learnt. Training residuals cannot show a false name: this can.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy.stats import ttest_1samp

from twinbench.mismatch.checks import holm
from twinbench.mismatch.fit import Problem, Unknown, parallel
from twinbench.mismatch.seed import ENGINE_SEED
from twinbench.mismatch.solve import solve
from twinbench.mismatch.tracks import Track
from twinbench.physics.simulator import Array, Variable

HELD_OUT_RESAMPLES = 500
CHORDS = 8
"""Steps with columns from nearby."""
AFRESH, DRIFTING = 4, 2
"""Rounds after blocks were brought in line with samples, and those before where something drifts."""
NO_DIFFERENCE = 0.02
"""Share of the removable error that makes no difference."""
BEYOND_CHANCE = 0.05
"""Probability (Holm over the outputs) below which a held-out output got worse by more than its pieces differ."""
RESAMPLED_PIECES = 8
"""Pieces of each recording that are resampled, or dealt to two halves, as wholes."""


class Held(NamedTuple):
    """How a model does on the held-out recordings.

    Attributes:
        residuals: block means measured minus simulated, (B, ny) per recording, in the outputs' units.
        rmse: (ny,) sample by sample, in the outputs' units.
        own: what each recording has for itself, as fitted: (K,) per recording, each in its unknown's unit.
        readings: simulated, sample by sample, (N, ny) per recording, in the outputs' units.
    """

    residuals: list[Array]
    rmse: Array
    own: list[Array]
    readings: list[Array]


class Worse(NamedTuple):
    """A held-out output that a model predicts worse than another: errors (rms) before and after, p after Holm."""

    channel: str
    before: float
    after: float
    p: float


def held_out(
    problem: Problem, z: Array, tracks: Sequence[Track], own: Sequence[Unknown], near: Held | None = None
) -> Held:
    """Open-loop errors on other recordings.

    Args:
        problem: a fit; what is shared between recordings is taken from it.
        z: (n_unknowns,) where its unknowns stand, each in its own unit.
        tracks: the held-out recordings, as the engine prepared them.
        own: unknowns of the held-out recordings themselves.
        near: a similar fit's, to begin from.
    """
    theta = problem.theta.copy()
    for value, unknown in zip(z, problem.unknowns, strict=True):
        if unknown.recording == -1:
            theta[unknown.at] = value

    def fitted(r: int) -> tuple[Array, Array, Array, Array]:
        # One recording at a time: they share nothing that is free.
        mine = tuple(replace(u, recording=0) for u in own if u.recording == r)
        alone = Problem(problem.machine, [tracks[r]], mine, problem.sd, theta=theta, since=problem.since[:1])
        # What drifts has gone far out of its way for another model: it is found from the beginning.
        drifting = any(u.kind == "drift" for u in mine)
        if near is None or drifting:
            best, _ = solve(alone, alone.z0, DRIFTING if drifting else 10, chords=CHORDS)
        else:
            best = near.own[r]
        alone = alone.refined(best)
        best, _ = solve(alone, best, 1 if drifting else AFRESH, chords=CHORDS)
        readings = alone.readings(0, best)
        return alone.residual(0, best), alone.squares(0, best, readings), best, readings

    found = parallel([lambda r=r: fitted(r) for r in range(len(tracks))])
    residuals, squares, best, readings = (list(part) for part in zip(*found, strict=True))
    return Held(residuals, np.sqrt(np.mean(squares, axis=0)), best, readings)


def worse_outputs(before: Held, after: Held, outputs: Sequence[Variable]) -> tuple[Worse, ...]:
    """Held-out outputs that get worse beyond chance: one-sided, paired over pieces, Holm over the outputs.

    A model that helps the mean over the outputs may spoil one of them. By how much a piece gets worse has a spread
    that grows with its error, so the pieces' logarithms are compared; and a form that is not exact may cost a
    ``NO_DIFFERENCE`` of an error.
    """
    told, p = [], []
    for c, variable in enumerate(outputs):
        b, a = (piece_squares(held.residuals, c) for held in (before, after))
        if len(b) != len(a) or len(b) < 2 or not (a.min() > 0.0 and b.min() > 0.0):
            continue
        grown = np.log(a / b) - np.log1p(NO_DIFFERENCE)
        if np.ptp(grown) > 0.0:
            told.append(Worse(variable.name, float(np.sqrt(b.mean())), float(np.sqrt(a.mean())), 1.0))
            p.append(float(ttest_1samp(grown, 0.0, alternative="greater").pvalue))
    found = [w._replace(p=q) for w, q in zip(told, holm(p), strict=True)]
    return tuple(w for w in found if w.p < BEYOND_CHANCE and w.after > w.before)


def piece_squares(residuals: Sequence[Array], channel: int) -> Array:
    """Mean squares of one channel in pieces of the recordings.

    Args:
        residuals: block means measured minus simulated, (B, ny) per recording, in the outputs' units.
        channel: position of the output.
    """
    pieces = [piece for residual in residuals for piece in np.array_split(residual[:, channel], RESAMPLED_PIECES)]
    return np.array([np.nanmean(piece**2) for piece in pieces if np.isfinite(piece).any()])


def resamples(n: int) -> np.ndarray:
    """Which of n pieces are drawn, (HELD_OUT_RESAMPLES, n), always the same."""
    return np.random.default_rng(ENGINE_SEED).integers(0, n, (HELD_OUT_RESAMPLES, n))
