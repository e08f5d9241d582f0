"""When errors are so large that no linear picture holds: grow sets of effects, each fitted in full."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from twinbench.mismatch.explanation import Explanation, with_candidates
from twinbench.mismatch.fit import Problem
from twinbench.mismatch.machine import Candidate
from twinbench.mismatch.noise import MEMORY_BLOCKS_MOST
from twinbench.mismatch.picture import PROBE_SIZE, Variant, is_fault, price, shape_count, typical
from twinbench.mismatch.place import CLOCK
from twinbench.mismatch.solve import solve
from twinbench.physics.simulator import Array, Term

GROSS, CHEAP_BLOCKS = 5.0, 1200
"""Errors of so many noises are far beyond any linear picture; with so few blocks in all, sets are fitted instead."""
KEPT_SETS, CLIMBED_EFFECTS, WITH_FAULTS = 4, 4, 2
"""Sets of each size that are grown on, and effects that they grow to: of physics alone, and with faults among them."""
FINISHED = 24
"""Sets of each size that are fitted to the end: those that promise most after a first step."""
AGAIN, RESTARTS = 6, 8
"""Sets of each size that are fitted again from other sizes and shapes, so many times for each effect after the first:
thresholds have many optima."""


def gross(problem: Problem, z: Array, floor: Array) -> bool:
    """Are the errors so large, and runs so cheap, that sets had better be fitted than pictured?

    Args:
        z: (K,) where the problem's unknowns stand, each in its own unit.
        floor: (ny,) least noise of block means, in the outputs' units.
    """
    rms = np.sqrt(np.nanmean(np.concatenate(problem.residuals(z)) ** 2, axis=0))
    return bool((rms > GROSS * floor).any()) and sum(len(t.starts) for t in problem.tracks) <= CHEAP_BLOCKS


def climb(
    before: Explanation,
    choices: Sequence[Variant],
    pairs: bool = True,
    advance: Callable[[float], None] = lambda share: None,
) -> list[Explanation]:
    """Sets of effects that explain the recordings, best first: of physics alone, and of physics and faults.

    Errors so large are missing physics more often than not, and a flexible fault may stand in for it on the way.

    Args:
        pairs: keep more than one set of each size.
        advance: told the share that is done.
    """
    kept = KEPT_SETS if pairs else 1
    candidates = before.problem.machine.candidates
    every = [j for j, candidate in enumerate(candidates) if not _goes_by_clock(candidate)]
    physics = [j for j in every if not is_fault(candidates[j])]
    found = _grown(before, choices, physics, CLIMBED_EFFECTS, kept, RESTARTS, lambda share: advance(0.5 * share))
    found += _grown(before, choices, every, WITH_FAULTS, kept, 0, lambda share: advance(0.5 + 0.5 * share))
    first = {frozenset(e.names): e for e in sorted(found, key=misfit, reverse=True)}
    return sorted(first.values(), key=lambda e: misfit(e) + owed(e))


def _goes_by_clock(candidate: Candidate) -> bool:
    """Is it periodic? In errors so large, any slow one looks like part of a period."""
    mechanism = candidate.mechanism
    return isinstance(mechanism, Term) and any(v.name.startswith(CLOCK) for v in mechanism.states)


def _grown(
    before: Explanation,
    choices: Sequence[Variant],
    candidates: Sequence[int],
    effects: int,
    most: int,
    restarts: int,
    advance: Callable[[float], None],
) -> list[Explanation]:
    """Add one effect after the other to the best few sets of each size; the sets that were kept, of all sizes."""
    listed = before.problem.machine.candidates
    names = [c.name for c in listed]
    rng = np.random.default_rng(0)
    kept, all_kept = [before], [before]
    for size in range(effects):
        sets = {
            frozenset((*parent.names, names[j])): (parent, j)
            for parent in kept[::-1]
            for j in candidates
            if listed[j].family not in {listed[v.candidate].family for v in parent.chosen}
        }
        begun = []
        for done, (parent, j) in enumerate(sets.values()):
            advance((size + done / len(sets)) / effects)
            begun.append(grafted(parent, [v for v in choices if v.candidate == j]))
        begun.sort(key=misfit)
        grown = sorted((_solved(e, e.z) for e in begun[:FINISHED] if np.isfinite(e.cost)), key=misfit)
        for place, e in enumerate(grown[:AGAIN]):
            tries = [_solved(e, _elsewhere(e, rng)) for _ in range(restarts * size)]
            grown[place] = min([e, *(f for f in tries if np.isfinite(f.cost))], key=misfit)
        kept = most_and_others(sorted(grown, key=misfit), most)
        all_kept += kept
    return all_kept


def most_and_others(ordered: Sequence[Explanation], most: int) -> list[Explanation]:
    """The first few, the next that has no family of the first one's, and the next of faults alone.

    All forms of one friction say nothing of what else it may be, and what faulty sensors explain is always told.
    """
    kept = list(ordered[:most])
    for other in (lambda e: not _families(e) & _families(ordered[0]), _faults_alone):
        if not any(map(other, kept)):
            kept += [e for e in ordered[most:] if other(e)][:1]
    return kept


def _faults_alone(explanation: Explanation) -> bool:
    return explanation.faults == len(explanation.names)


def _families(explanation: Explanation) -> frozenset[str]:
    candidates = explanation.problem.machine.candidates
    return frozenset(candidates[v.candidate].family for v in explanation.chosen)


def _elsewhere(explanation: Explanation, rng: np.random.Generator) -> Array:
    """Unknowns (K,) with the effects' sizes and shapes drawn anew from their ranges."""
    machine = explanation.problem.machine
    z = explanation.z.copy()
    at = explanation.first
    drawn: dict[str, float] = {}
    for variant in explanation.chosen:
        candidate = machine.candidates[variant.candidate]
        for place, v in enumerate(candidate.mechanism.parameters):
            if place:
                # What means the same (two effects that begin at one rim) is drawn the same.
                z[at] = drawn.setdefault(v.says, rng.uniform(v.low, v.high))
            else:
                small, large = PROBE_SIZE * abs(typical(candidate)), 0.25 * max(abs(v.low), abs(v.high))
                sign = np.sign(z[at] - candidate.null[0]) or 1.0
                z[at] = candidate.null[0] + sign * np.exp(rng.uniform(np.log(small), np.log(max(large, small))))
            at += 1
    return z


def grafted(parent: Explanation, variants: Sequence[Variant]) -> Explanation:
    """An explanation with one candidate more, in whichever of its variants promises most after a first step."""
    problem, machine = parent.problem, parent.problem.machine
    candidate = machine.candidates[variants[0].candidate]
    starts = []
    for variant in variants:
        whole = with_candidates(problem, [variant])
        z = np.concatenate((parent.z, whole.z0[len(parent.z) :]))
        z[len(parent.z)] += PROBE_SIZE * typical(candidate)
        starts.append((*solve(whole, z, 1, chords=3), variant, whole))
    z, cost, variant, whole = min(starts, key=lambda s: s[1])
    return Explanation((*parent.names, candidate.name), (*parent.chosen, variant), whole, z, cost)


def _solved(explanation: Explanation, z: Array) -> Explanation:
    """Fitted to the end from z."""
    z, cost = solve(explanation.problem, z, 8)
    return replace(explanation, z=z, cost=cost)


def owed(explanation: Explanation) -> float:
    """What an explanation must earn in independent readings: by BIC, and for the choice among so many candidates."""
    problem = explanation.problem
    log_n = np.log(sum(len(t.starts) for t in problem.tracks) / MEMORY_BLOCKS_MOST)
    shapes = sum(shape_count(problem.machine.candidates[v.candidate]) for v in explanation.chosen)
    each = log_n + 2.0 * np.log(len(problem.machine.candidates))
    return float(price(len(explanation.names), explanation.faults, 0, each) + shapes * log_n)


def misfit(explanation: Explanation) -> float:
    """Minus twice the log-likelihood with the noise's size free, in independent readings."""
    errors = np.concatenate(explanation.problem.residuals(explanation.z))
    n = np.isfinite(errors).sum(axis=0) / MEMORY_BLOCKS_MOST
    with np.errstate(divide="ignore", invalid="ignore"):
        return float(np.nansum(n * np.log(np.nanmean(errors**2, axis=0))))
