"""When an effect began: its size as hats in time, and the step in them that explains the recordings best."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from twinbench.mismatch.fit import Problem, Unknown
from twinbench.mismatch.picture import Picture, Variant, switched, typical
from twinbench.mismatch.tracks import Track
from twinbench.physics.simulator import Array, Series

START_GRID = 20
TRIED = 3
"""Candidates that look best from the beginning on, and are tried for a later start."""
ONSET_GAIN = 25.0
"""Units that a later start must gain over an effect that was there from the beginning; and in each recording that it
lies in, over one that is there all the time or never."""
ONSET_SHARE = 0.05
"""And the share of the gain that it must add."""
LEAST_TIME = 0.1
"""Share of all the time that it must be absent from: what a few seconds lack is a start that is off."""
_GRID = np.linspace(0.0, 1.0, 201).tolist()


def find_onsets(problem: Problem, z: Array, shown: Picture) -> tuple[float, ...] | None:
    """For each recording the time from which an effect is there, s, or None if always.

    Minus infinity is from the beginning, infinity is not in this recording. One start for all effects.

    Args:
        z: (K,) where the problem's unknowns stand, each in its own unit.
    """
    order = sorted(range(len(shown.variants)), key=lambda i: -shown.gain((i,)))
    owner = [problem.machine.candidates[variant.candidate].mechanism for variant in shown.variants]
    terms = [i for i in order if not isinstance(owner[i], Series)]
    if not terms or not shown.gain((terms[0],)) > ONSET_GAIN:
        return None
    always = shown.gain((order[0],))
    found = [_best_starts(problem, z, shown, shown.variants[i]) for i in terms[:TRIED]]
    gain, starts = max(found, key=lambda f: f[0])
    if not gain - always > max(ONSET_GAIN, ONSET_SHARE * always) or np.mean(starts) < LEAST_TIME:
        return None
    return tuple(_time(track.time_s, share) for track, share in zip(problem.tracks, starts, strict=True))


class Onset(NamedTuple):
    """Since when an explanation's effects are there in one recording.

    Attributes:
        there: "throughout", "from" or "not".
        since_s: on the recording's clock, if they begin in it; ``into_s`` after its first sample.
    """

    recording: str
    there: str
    since_s: float | None = None
    into_s: float | None = None


def told_onsets(since: Sequence[float], tracks: Sequence[Track]) -> tuple[Onset, ...]:
    """Recording by recording, where something begins in one of them or is not in one of them; else nothing."""
    if all(s == -np.inf for s in since):
        return ()
    found = []
    for s, track in zip(since, tracks, strict=True):
        if np.isfinite(s):
            found.append(Onset(track.name, "from", float(s), float(s - track.time_s[0])))
        else:
            found.append(Onset(track.name, "throughout" if s < 0.0 else "not"))
    return tuple(found)


def _time(time_s: Array, share: float) -> float:
    if share <= 0.0:
        return -np.inf
    return np.inf if share >= 1.0 else float(time_s[0] + share * (time_s[-1] - time_s[0]))


def _best_starts(problem: Problem, z: Array, shown: Picture, variant: Variant) -> tuple[float, list[float]]:
    """Gain, and the share of each recording after which the effect is there."""
    machine = problem.machine
    candidate = machine.candidates[variant.candidate]
    at = candidate.at[0]
    base = replace(problem, theta=switched(machine, problem.theta, variant, 0.0))
    knots = tuple(
        Unknown("size", "drift", at, -np.inf, np.inf, 0.0, np.inf, abs(typical(candidate)), r, j)
        for r in range(len(problem.tracks))
        for j in range(START_GRID)
    )
    free = replace(base, unknowns=(*problem.unknowns, *knots))
    residuals = base.residuals(z)
    wide = np.concatenate((z, np.zeros(len(knots))))
    columns = [problem.whitener(c) for c in free.columns(wide, residuals, range(len(z), len(wide)))]
    G, b = base.projected(z, residuals, shown.nuisance, columns)

    def gained(starts: Sequence[float]) -> float:
        s = np.concatenate([_on_from(share) for share in starts])
        power = float(s @ G @ s)
        return float(s @ b) ** 2 / power if power > 1e-9 else 0.0

    def moved(r: int, shares: Sequence[float]) -> list[float]:
        return max(([*best[:r], float(share), *best[r + 1 :]] for share in shares), key=gained)

    best = [0.0] * len(problem.tracks)
    for _ in range(3):
        for r in range(len(best)):
            best = moved(r, _GRID)
    for r in range(len(best)):
        whole = moved(r, (0.0, 1.0))
        if gained(best) - gained(whole) < ONSET_GAIN:
            best = whole
    return gained(best), best


def _on_from(share: float) -> Array:
    """Knot values of an effect that is there from a share of the recording on."""
    if share <= 0.0:
        return np.ones(START_GRID)
    return np.clip(np.arange(START_GRID) - share * (START_GRID - 1) + 0.5, 0.0, 1.0) * (share < 1.0)


def settled_onsets(problem: Problem, z: Array) -> Problem:
    """The problem with each start moved by a few seconds to where the fit is best.

    Args:
        z: (K,) where the problem's unknowns stand, each in its own unit.
    """
    since = list(problem.since)
    for r, track in enumerate(problem.tracks):
        if not np.isfinite(since[r]):
            continue
        spacing = float(track.time_s[-1] - track.time_s[0]) / START_GRID
        for step in (0.4 * spacing, 0.15 * spacing, 0.05 * spacing):
            options = [since[r] + k * step for k in (-2, -1, 0, 1, 2)]

            def cost(at: float, r: int = r) -> float:
                return replace(problem, since=(*since[:r], at, *since[r + 1 :])).recording_cost(r, z)

            since[r] = min(options, key=cost)
    return replace(problem, since=tuple(since))
