"""Candidates picked by Schwarz's criterion alone, forward, with the engine's own fits and none of its gates.

The best candidate is named whatever it gains; another joins while the criterion falls.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from twinbench.data.recording import Recording
from twinbench.mismatch.explanation import Explanation, present, refit
from twinbench.mismatch.findings import Z90, uncertainty
from twinbench.mismatch.noise import AUTOREGRESSION_ORDER, fit_whitener
from twinbench.mismatch.picture import Picture, picture, variants
from twinbench.mismatch.proof import held_out
from twinbench.physics.simulator import Mechanism, Simulator
from twinbench.proof.opponents.base import Progress, calibrated, finding, quiet, told

REFITS_EACH_STEP = 8
"""Candidates that are fitted in full at each step: those that gain most in the linear picture."""
MOST_TERMS = 4


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
    best = Explanation((), (), c.problem, c.z, c.problem.cost(c.z))
    while len(best.names) < MOST_TERMS:
        whitener = fit_whitener(best.problem.residuals(best.z), c.found.floor)
        problem, z = replace(c.problem, whitener=whitener), best.z[: len(c.z)]
        shown = picture(problem, z, listed, present(best))
        tried = [refit(problem, z, shown, chosen) for chosen in _next(shown, len(best.names))]
        if not tried:
            break
        top = min(tried, key=bic)
        top = refit(problem, z, shown, [shown.variants.index(v) for v in top.chosen], rounds=4)
        if best.names and bic(top) >= bic(best):
            break
        best = top
    if not best.names:
        return told(c.found, "No candidate moves the readings.")
    return told(
        c.found,
        f"By BIC: {', '.join(best.names)}.",
        _findings(best),
        held_out(best.problem, best.z, c.found.held, c.own()).rmse,
    )


def bic(explanation: Explanation) -> float:
    """``sum_c n_c log(variance of channel c's innovations) + k log n``, noise an autoregression per channel."""
    residuals = explanation.problem.residuals(explanation.z)
    total, n = 0.0, 0
    for series in zip(*(r.T for r in residuals), strict=True):
        lagged = np.concatenate([np.lib.stride_tricks.sliding_window_view(x, AUTOREGRESSION_ORDER + 1) for x in series])
        lagged = lagged[np.isfinite(lagged).all(axis=1)]
        now, past = lagged[:, -1], lagged[:, :-1]
        innovations = now - past @ np.linalg.lstsq(past, now, rcond=None)[0]
        total += len(now) * np.log(max(np.mean(innovations**2), 1e-300)) if len(now) else 0.0
        n += len(now)
    fitted = sum(u.kind == "mechanism" for u in explanation.problem.unknowns)
    return float(total + fitted * np.log(n))


def _next(shown: Picture, n_present: int) -> list[tuple[int, ...]]:
    """What is there with one candidate more, the most promising first; each with its best shape."""
    here = tuple(range(n_present))
    taken = {shown.variants[i].candidate for i in here}
    found: dict[int, tuple[int, ...]] = {}
    more = [i for i in range(len(shown.variants)) if shown.variants[i].candidate not in taken]
    for i in sorted(more, key=lambda i: -shown.gain((*here, i))):
        if np.isfinite(shown.gain((*here, i))):
            found.setdefault(shown.variants[i].candidate, (*here, i))
    return list(found.values())[:REFITS_EACH_STEP]


def _findings(best: Explanation) -> list[dict[str, Any]]:
    machine, sd = best.problem.machine, np.sqrt(np.diag(uncertainty(best)))
    at = len(best.z) - sum(len(machine.candidates[v.candidate].at) for v in best.chosen)
    found = []
    for variant in best.chosen:
        candidate = machine.candidates[variant.candidate]
        size, margin = float(best.z[at]), Z90 * float(sd[at])
        found.append(finding(candidate.mechanism, size, size - margin, size + margin))
        at += len(candidate.at)
    return found
