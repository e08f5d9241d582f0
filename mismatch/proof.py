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
from twinbench.mismatch.solve import solve
from twinbench.mismatch.tracks import Track
from twinbench.physics.simulator import Array, Variable

HELD_OUT_RESAMPLES = 500
CHORDS = 8
"""Steps with columns from nearby."""
AFRESH, DRIFTING = 4, 2
"""Rounds, but for the first with columns of their own, and those before them where something drifts."""
NO_DIFFERENCE = 0.02
"""Share of the removable error that makes no difference."""
BEYOND_CHANCE = 0.05
"""Probability (Holm over the outputs) below which a held-out output got worse by more than its pieces differ."""
RESAMPLED_PIECES = 8
"""Pieces of each recording that are resampled as wholes."""


class Held(NamedTuple):
    """How a model does on the held-out recordings.

    Attributes:
        residuals: block means measured minus simulated, (B, ny) per recording, in the outputs' units.
        rmse: (ny,) sample by sample, in the outputs' units.
        own: what each recording has for itself, as fitted: (K,) per recording, each in its unknown's unit.
        columns: d(block means)/d(own) there, (B, ny, K) per recording, an output's unit per unit of the unknown.
        level: variance (ny,) of each recording's noise, dimensionless, that of the fitted ones being 1.
        readings: simulated, sample by sample, (N, ny) per recording, in the outputs' units.
    """

    residuals: list[Array]
    rmse: Array
    own: list[Array]
    columns: list[Array]
    level: Sequence[Array | float]
    readings: Sequence[Array] = ()


class Gain(NamedTuple):
    """Share of the removable excess error that was removed, with a 90 % interval over pieces of recordings."""

    share: float
    low: float
    high: float
    excess: float  # excess of the model before, in noise variances

    @property
    def says(self) -> str:
        """In words; what falls below the noise it was thought to have is all of the excess, and no more."""
        share, low, high = (100.0 * min(v, 1.0) for v in (self.share, self.low, self.high))
        return f"{share:.0f} % of the excess error (90 % interval {low:.0f} to {high:.0f})"


class Worse(NamedTuple):
    """A held-out output that a model predicts worse than another: errors (rms) before and after, p after Holm."""

    channel: str
    before: float
    after: float
    p: float


class BorneOut(NamedTuple):
    """Fall of the held-out error over what the fall should be, 1 where all is there that was added; 90 % interval."""

    ratio: float
    low: float
    high: float
    units: float  # the fall, in noise variances


def held_out(
    problem: Problem, z: Array, tracks: Sequence[Track], own: Sequence[Unknown], near: Held | None = None
) -> Held:
    """Open-loop errors on other recordings.

    Args:
        problem: a fit; what is shared between recordings is taken from it.
        z: (n_unknowns,) where its unknowns stand, each in its own unit.
        tracks: the held-out recordings, as the engine prepared them.
        own: unknowns of the held-out recordings themselves.
        near: a similar fit's, to begin from: its columns serve again.
    """
    theta = problem.theta.copy()
    for value, unknown in zip(z, problem.unknowns, strict=True):
        if unknown.recording == -1:
            theta[unknown.at] = value

    def fitted(r: int) -> tuple[Array, Array, Array, Array, Array]:
        # One recording at a time: they share nothing that is free.
        mine = tuple(replace(u, recording=0) for u in own if u.recording == r)
        alone = Problem(problem.machine, [tracks[r]], mine, problem.whitener, theta=theta)
        # What drifts has gone far out of its way for another model: it is found from the beginning.
        drifting = any(u.kind == "drift" for u in mine)
        if near is None or drifting:
            best, _ = solve(alone, alone.z0, DRIFTING if drifting else 10, chords=CHORDS)
            (columns,) = alone.columns(best, alone.residuals(best))
        else:
            best, columns = near.own[r], near.columns[r]
        alone = alone.refined(best)
        best, _ = solve(alone, best, 1 if drifting else AFRESH, chords=CHORDS, known=[alone.whitener(columns)])
        readings = alone.readings(0, best)
        return alone.residual(0, best), alone.squares(0, best, readings), best, columns, readings

    found = parallel([lambda r=r: fitted(r) for r in range(len(tracks))])
    residuals, squares, best, columns, readings = (list(part) for part in zip(*found, strict=True))
    return Held(residuals, np.sqrt(np.mean(squares, axis=0)), best, columns, [t.level for t in tracks], readings)


def gain(before: Held, after: Held, variance: Array) -> Gain:
    """Share of the removable excess error removed, mean over channels in noise variances.

    Args:
        variance: (ny,) of the noise of block means, in the outputs' units squared.
    """
    b, a = _pieces(before, after, variance)
    picks = resamples(len(b))
    shares = _share(b[picks].mean(axis=1), a[picks].mean(axis=1))
    low, high = np.quantile(shares, (0.05, 0.95))
    return Gain(float(_share(b.mean(), a.mean())), float(low), float(high), float(b.mean() - 1.0))


def borne_out(before: Held, after: Held, variance: Array) -> BorneOut:
    """Is what a model adds to another's outputs in the readings, whatever else is? The error falls by its square then.

    What nobody models may be far larger than an effect; it hides the share that the effect has, but not this.

    Args:
        variance: (ny,) of the noise of block means, in the outputs' units squared.
    """
    pieces = _paired(before, after)
    fallen_by = np.array([np.nansum((old**2 - new**2) / variance) for old, new in pieces])
    added_by = np.array([max(np.nansum((old - new) ** 2 / variance), 1e-9) for old, new in pieces])
    picks = resamples(len(pieces))
    low, high = np.quantile(fallen_by[picks].sum(axis=1) / added_by[picks].sum(axis=1), (0.05, 0.95))
    total = float(fallen_by.sum())
    return BorneOut(total / float(added_by.sum()), float(low), float(high), total)


def clearly_worse(simple: Held, whole: Held, variance: Array) -> bool:
    """Does a model predict the held-out recordings worse than another, beyond what their pieces differ by chance?

    Args:
        variance: (ny,) of the noise of block means, in the outputs' units squared.
    """
    with_simple, with_whole = _pieces(simple, whole, variance)
    worse = with_simple - with_whole
    return bool(np.quantile(worse[resamples(len(worse))].mean(axis=1), 0.05) > 0.0)


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


def lost(simple: Held, whole: Held, before: Held, variance: Array) -> float:
    """Share of the removable held-out error that one model removes less than another.

    Args:
        variance: (ny,) of the noise of block means, in the outputs' units squared.
    """
    return gain(before, whole, variance).share - gain(before, simple, variance).share


def _pieces(one: Held, other: Held, variance: Array) -> tuple[Array, Array]:
    """Mean squares, in noise variances, of pieces of the recordings under each of two models."""
    pairs = _paired(one, other)
    squares = np.array([[np.nanmean(np.nanmean(piece**2, axis=0) / variance) for piece in pair] for pair in pairs])
    return squares[:, 0], squares[:, 1]


def _paired(one: Held, other: Held) -> list[tuple[Array, Array]]:
    """Residuals of two models in pieces, where there are readings and neither diverges."""
    pairs = zip(_cut(_levelled(one)), _cut(_levelled(other)), strict=True)
    return [(a, b) for a, b in pairs if np.isfinite(a).any() and np.isfinite(b).any()]


def _levelled(held: Held) -> list[Array]:
    """Residuals as if every recording had the noise of the fitted ones."""
    return [r / np.sqrt(level) for r, level in zip(held.residuals, held.level, strict=True)]


def piece_squares(residuals: Sequence[Array], channel: int) -> Array:
    """Mean squares of one channel in pieces of the recordings.

    Args:
        residuals: block means measured minus simulated, (B, ny) per recording, in the outputs' units.
        channel: position of the output.
    """
    pieces = _cut([residual[:, channel] for residual in residuals])
    return np.array([np.nanmean(piece**2) for piece in pieces if np.isfinite(piece).any()])


def _cut(residuals: Sequence[Array]) -> list[Array]:
    return [piece for residual in residuals for piece in np.array_split(residual, RESAMPLED_PIECES)]


def resamples(n: int) -> np.ndarray:
    """Which of n pieces are drawn, (HELD_OUT_RESAMPLES, n), always the same."""
    return np.random.default_rng(0).integers(0, n, (HELD_OUT_RESAMPLES, n))


def _share(before: Array, after: Array) -> Array:
    return np.clip((before - after) / np.maximum(before - 1.0, 0.02), -9.0, 9.0)
