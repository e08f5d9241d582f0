"""How inputs go between samples: each holds until the next, or lines join them. A fit of a short stretch tells."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from twinbench.mismatch.calibrate import block_noise, calibrated
from twinbench.mismatch.machine import Machine
from twinbench.mismatch.proof import RESAMPLED_PIECES, resamples
from twinbench.mismatch.steps import settle_step
from twinbench.mismatch.tracks import Track
from twinbench.physics.simulator import Array

HELD, LINEAR, AUTO = "held", "linear", "auto"
STRETCH = 1000
"""Samples that both are tried on: those in which the inputs move most."""
CLEARLY = 0.9
"""Lines are taken where they leave no more than this share of the error (rms) that holding leaves. Nearer to one,
what the simulator lacks may decide; far below it, lines are never taken beside physics that is missing."""


class Joined(NamedTuple):
    """How inputs go between samples, and what says so.

    Attributes:
        inputs: "held" or "linear".
        by: "user"; "fit" if a stretch of a recording spoke clearly for lines; else "default".
        channel: the output that it shows in most, in ``unit``; both errors are root mean squares on that stretch.
    """

    inputs: str
    by: str
    channel: str = ""
    unit: str = ""
    rmse_held: float | None = None
    rmse_linear: float | None = None


def how_joined(
    machine: Machine, tracks: Sequence[Track], advance: Callable[[float], None] = lambda share: None
) -> Joined:
    """Calibrate on a stretch with inputs held and with inputs joined by lines; lines if they are clearly better.

    Raises:
        ValueError: the simulator diverges however small the step.
    """
    simulator = machine.simulator
    stretch = _liveliest(tracks)
    if stretch is None:
        return Joined(HELD, "default")
    floor = block_noise([stretch], simulator)
    settle_step(machine, [stretch], floor)
    errors = []
    for place, track in enumerate((stretch, replace(stretch, linear=True))):

        def half(share: float, place: int = place) -> None:
            advance(0.5 * (place + share))

        problem, z = calibrated(machine, [track], floor, half)
        errors.append(track.y - problem.readings(0, z))
    seen = np.flatnonzero(np.isfinite(errors[0] + errors[1]).sum(axis=0) >= RESAMPLED_PIECES)
    if not len(seen):
        return Joined(HELD, "default")
    held, linear = (np.sqrt(np.nanmean(e[:, seen] ** 2, axis=0)).tolist() for e in errors)
    c = int(np.argmin(np.divide(linear, held)))
    v = simulator.outputs[seen[c]]
    better = _is_clearly_better(*(e[:, seen] for e in errors))
    return Joined(LINEAR if better else HELD, "fit" if better else "default", v.name, v.unit, held[c], linear[c])


def _liveliest(tracks: Sequence[Track]) -> Track | None:
    """The stretch in which the inputs move most, sample by sample; None where none does."""
    best, most = None, 0.0
    for track in tracks:
        span = np.ptp(track.u, axis=0)
        moving = np.abs(np.diff(track.u[:, span > 0.0], axis=0)) / span[span > 0.0]
        moved = np.concatenate(([0.0], np.cumsum(moving.sum(axis=1))))
        n = min(STRETCH, len(moved))
        told = moved[n - 1 :] - moved[: len(moved) - n + 1]
        begin = int(np.argmax(told))
        if told[begin] > most:
            most, best = told[begin], _piece(track, slice(begin, begin + n))
    return best


def _piece(track: Track, rows: slice) -> Track:
    y = track.y[rows]
    return Track(track.name, track.time_s[rows], track.u[rows], y, np.arange(len(y)), y)


def _is_clearly_better(held: Array, linear: Array) -> bool:
    """Over all outputs, by a clear share, and in pieces of the stretch beyond chance?"""
    variance = np.nanmean(held**2, axis=0)
    pairs = zip(*(np.array_split(e**2 / variance, RESAMPLED_PIECES) for e in (held, linear)), strict=True)
    squares = np.array([[np.nanmean(piece) for piece in pair] for pair in pairs if np.isfinite(sum(pair)).any()])
    better = squares[:, 0] - squares[:, 1]
    beyond_chance = np.quantile(better[resamples(len(better))].mean(axis=1), 0.05) > 0.0
    return bool(beyond_chance and np.sqrt(squares[:, 1].mean() / squares[:, 0].mean()) < CLEARLY)
