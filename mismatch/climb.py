"""When errors are so large that no linear picture holds: grow sets of effects, each fitted in full."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from mismatch.explanation import Explanation, with_candidates
from mismatch.fit import Problem, solve
from mismatch.noise import LONGEST
from mismatch.picture import PROBE, Variant, price, typical
from mismatch.search import PENALTY
from physics.simulator import Array

GROSS, CHEAP_BLOCKS = 5.0, 3000
"""Errors of so many noises are far beyond any linear picture; with so few blocks in all, sets are fitted instead."""
KEPT, EFFECTS = 4, 4
"""Sets of each size that are grown on, and effects that they grow to."""


def gross(problem: Problem, z: Array, floor: Array) -> bool:
    """Are the errors so large, and runs so cheap, that sets had better be fitted than pictured?"""
    rms = np.sqrt(np.nanmean(np.concatenate(problem.residuals(z)) ** 2, axis=0))
    return bool((rms > GROSS * floor).any()) and sum(len(t.starts) for t in problem.tracks) <= CHEAP_BLOCKS


def climb(
    before: Explanation, choices: Sequence[Variant], pairs: bool = True,
    advance: Callable[[float], None] = lambda share: None,
) -> Explanation:  # fmt: skip
    """Add one effect after the other to the best few sets of each size; the best set of any size.

    Args:
        pairs: keep more than one set of each size.
        advance: told the share that is done.
    """
    candidates = before.problem.machine.candidates
    kept, sizes = [before], [before]
    for effects in range(EFFECTS):
        sets = {
            frozenset((*parent.names, candidate.name)): (parent, j)
            for parent in kept[::-1] for j, candidate in enumerate(candidates) if candidate.name not in parent.names
        }  # fmt: skip
        grown = []
        for done, (parent, j) in enumerate(sets.values()):
            advance((effects + done / len(sets)) / EFFECTS)
            grown.append(grafted(parent, [v for v in choices if v.candidate == j]))
        kept = sorted((e for e in grown if np.isfinite(e.cost)), key=misfit)[: KEPT if pairs else 1]
        sizes += kept[:1]
    return min(sizes, key=lambda e: misfit(e) + price(len(e.names), e.faults, PENALTY))


def grafted(parent: Explanation, variants: Sequence[Variant]) -> Explanation:
    """An explanation with one candidate more, fitted from whichever of its variants promises most at once."""
    problem, machine = parent.problem, parent.problem.machine
    candidate = machine.candidates[variants[0].candidate]
    starts = []
    for variant in variants:
        whole = with_candidates(problem, [variant])
        z = np.concatenate((parent.z, whole.z0[len(parent.z) :]))
        z[len(parent.z)] += PROBE * typical(candidate)
        starts.append((*solve(whole, z, 1, chords=3), variant, whole))
    z, _, variant, whole = min(starts, key=lambda s: s[1])
    fitted = solve(whole, z, 8)
    return Explanation((*parent.names, candidate.name), (*parent.chosen, variant), whole, *fitted)


def misfit(explanation: Explanation) -> float:
    """Minus twice the log-likelihood with the noise's size free, in independent readings."""
    errors = np.concatenate(explanation.problem.residuals(explanation.z))
    n = np.isfinite(errors).sum(axis=0) / LONGEST
    with np.errstate(divide="ignore", invalid="ignore"):
        return float(np.nansum(n * np.log(np.nanmean(errors**2, axis=0))))
