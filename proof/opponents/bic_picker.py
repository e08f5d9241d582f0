"""Candidates picked by Schwarz's criterion alone, forward, with the engine's own fits and none of its gates.

The best candidate is named whatever it gains; another joins while the criterion falls.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from twinbench.data.recording import Recording
from twinbench.mismatch.fit import Problem, Unknown
from twinbench.mismatch.machine import Candidate
from twinbench.mismatch.mixture import Z90
from twinbench.mismatch.naming.view import View
from twinbench.mismatch.proof import held_out
from twinbench.mismatch.solve import solve
from twinbench.mismatch.variants import Variant, is_amplitude, typical, variants
from twinbench.physics.simulator import Array, Mechanism, Simulator
from twinbench.proof.opponents.base import Progress, calibrated, finding, quiet, told
from twinbench.proof.opponents.library import PROBE_SIZE

REFITS_EACH_STEP = 8
"""Candidates that are fitted in full at each step: those that gain most in the linear picture."""
MOST_TERMS = 4
LAGS_OF_NOISE = 3
"""Past residuals that the noise's autoregression looks at."""
PRIOR_WIDTH = 5.0
"""Prior standard deviation of a size, in typical ones."""


class Picked(NamedTuple):
    """Candidates, fitted: their parameters are the problem's last unknowns.

    Attributes:
        z: (K,) where the problem's unknowns stand, each in its own unit.
    """

    chosen: tuple[Variant, ...]
    problem: Problem
    z: Array

    @property
    def listed(self) -> list[Candidate]:
        return [self.problem.machine.candidates[v.candidate] for v in self.chosen]


def diagnose(
    simulator: Simulator,
    recordings: Sequence[Recording],
    hold_out: Sequence[Recording] = (),
    catalogue: Sequence[Mechanism] | None = None,
    progress: Progress = quiet,
) -> dict[str, Any]:
    """Arguments as for ``mismatch.diagnose``; names one to ``MOST_TERMS`` mechanisms."""
    c = calibrated(simulator, recordings, hold_out, catalogue, progress)
    listed = variants(c.candidates)
    best = Picked((), *c.fit)
    while len(best.chosen) < MOST_TERMS:
        best = best._replace(problem=replace(best.problem, sd=_rms(best, c.found.floor)))
        tried = [_with(best, variant, size) for variant, size in _next(best, listed)]
        if not tried:
            break
        top = min(tried, key=bic)
        if best.chosen and bic(top) >= bic(best):
            break
        best = top
    if not best.chosen:
        return told(c.found, "No candidate moves the readings.")
    return told(
        c.found,
        f"By BIC: {', '.join(candidate.name for candidate in best.listed)}.",
        _findings(best),
        held_out(best.problem, best.z, c.found.held, c.own()).rmse,
    )


def bic(picked: Picked) -> float:
    """``sum_c n_c log(variance of channel c's innovations) + k log n``, noise an autoregression per channel."""
    total, n = 0.0, 0
    for series in zip(*(r.T for r in picked.problem.residuals(picked.z)), strict=True):
        lagged = np.concatenate([np.lib.stride_tricks.sliding_window_view(x, LAGS_OF_NOISE + 1) for x in series])
        lagged = lagged[np.isfinite(lagged).all(axis=1)]
        now, past = lagged[:, -1], lagged[:, :-1]
        innovations = now - past @ np.linalg.lstsq(past, now, rcond=None)[0]
        total += len(now) * np.log(max(np.mean(innovations**2), 1e-300)) if len(now) else 0.0
        n += len(now)
    fitted = sum(u.kind == "mechanism" for u in picked.problem.unknowns)
    return float(total + fitted * np.log(n))


def _rms(picked: Picked, floor: Array) -> Array:
    """(ny,) of what is left, in the outputs' units."""
    left = np.concatenate(picked.problem.residuals(picked.z))
    seen = np.isfinite(left)
    return np.maximum(np.sqrt(np.sum(np.where(seen, left, 0.0) ** 2, axis=0) / np.maximum(seen.sum(axis=0), 1)), floor)


def _next(best: Picked, listed: Sequence[Variant]) -> list[tuple[Variant, float]]:
    """One candidate more and its size, the most promising first; each with its best shape."""
    problem, z = best.problem, best.z
    taken = {v.candidate for v in best.chosen}
    some = [v for v in listed if v.candidate not in taken]
    if not some:
        return []
    view = View.around(problem, z)
    both = zip(view.unknowns(), view.of_variants(some, np.full(len(some), PROBE_SIZE)), strict=True)
    white = [problem.white(np.concatenate(pair, axis=2)) for pair in both]
    columns = np.concatenate([w.reshape(-1, len(z) + len(some)) for w in white])
    left = np.concatenate([problem.white(r).ravel() for r in view.residuals])
    seen = np.isfinite(left)
    J, C, e = np.nan_to_num(columns[seen, : len(z)]), np.nan_to_num(columns[seen, len(z) :]), left[seen]
    fitted = np.linalg.lstsq(J, np.column_stack((C, e)), rcond=None)[0]
    C, e = C - J @ fitted[:, :-1], e - J @ fitted[:, -1]
    squares = np.maximum(np.sum(C**2, axis=0), 1e-9)
    sizes = C.T @ e / squares
    found: dict[int, tuple[Variant, float]] = {}
    for i in np.argsort(-squares * sizes**2):
        candidate = problem.machine.candidates[some[i].candidate]
        size = float(sizes[i]) * typical(candidate)
        first = candidate.mechanism.parameters[0]
        if min(first.low, candidate.null[0]) < candidate.null[0] + size < max(first.high, candidate.null[0]):
            found.setdefault(some[i].candidate, (some[i], size))
    return list(found.values())[:REFITS_EACH_STEP]


def _with(best: Picked, variant: Variant, size: float) -> Picked:
    """One candidate more, fitted in full."""
    candidate = best.problem.machine.candidates[variant.candidate]
    values = [float(candidate.null[0]), *(candidate.null[1:] if is_amplitude(candidate) else variant.shape)]
    added = []
    for place, (at, v, value) in enumerate(zip(candidate.at, candidate.mechanism.parameters, values, strict=True)):
        scale = abs(typical(candidate)) if place == 0 else (v.high - v.low) / 6.0
        sd = PRIOR_WIDTH * scale if place == 0 or is_amplitude(candidate) else (v.high - v.low) / 2.0
        low, high = min(v.low, value), max(v.high, value)
        added.append(Unknown(f"{candidate.name}.{v.name}", "mechanism", at, low, high, value, sd, scale))
    problem = replace(best.problem, unknowns=(*best.problem.unknowns, *added))
    begin = np.concatenate((best.z, [values[0] + size, *values[1:]]))
    return Picked((*best.chosen, variant), problem, solve(problem, begin, 4)[0])


def _findings(best: Picked) -> list[dict[str, Any]]:
    G, _ = best.problem.normal(best.z)
    scale = 1.0 / np.sqrt(np.maximum(np.diag(G), 1e-300))
    sd = scale * np.sqrt(np.diag(np.linalg.pinv(G * np.outer(scale, scale), hermitian=True, rcond=1e-12)))
    at, found = len(best.z) - sum(len(c.at) for c in best.listed), []
    for candidate in best.listed:
        size, margin = float(best.z[at]), Z90 * float(sd[at])
        found.append(finding(candidate.mechanism, size, size - margin, size + margin))
        at += len(candidate.at)
    return found
