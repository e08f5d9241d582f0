"""When many effects act at once, none can be told from the calibrated model: fit all physics, then thin out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from mismatch.explanation import Explanation, present, refit, with_candidates
from mismatch.fit import Problem, solve
from mismatch.picture import Picture, Variant, is_fault, picture
from mismatch.search import LARGEST, PENALTY, local_search, wander
from physics.simulator import Array

MANY = 3
"""From so many effects on."""
RIDGE = 1.5
"""Prior standard deviation of a size, in typical ones, where all candidates are fitted at once."""


def from_everything(best: Explanation, problem: Problem, choices: Sequence[Variant]) -> Explanation:
    """The best of the given explanation and of those reached from the fit of everything.

    Args:
        problem: of the calibrated model, under the noise of ``best``.
    """
    machine = problem.machine
    there = present(best)
    owners = {v.candidate for v in there}
    # Each once, at its nominal shape, which comes first in the choices.
    physics = {
        v.candidate: v
        for v in choices[::-1]
        if not is_fault(machine.candidates[v.candidate]) and v.candidate not in owners
    }
    listed = (*there, *physics.values())
    whole = everything(problem, best.z[: len(problem.unknowns)], listed)
    problem = replace(problem, offsets=whole.problem.refined(whole.z).offsets)
    z = whole.z[: len(problem.unknowns)]
    shown = picture(problem, z, choices, present(whole))
    starts = ((), tuple(range(len(there))), thinned(shown, range(len(listed))))
    ends = {local_search(shown, wander(shown, start, LARGEST, PENALTY), LARGEST, PENALTY) for start in starts}
    found = [refit(problem, z, shown, chosen, rounds=2) for chosen in sorted(ends)]
    return min([best, *found], key=lambda e: e.score(PENALTY))


def everything(problem: Problem, z: Array, listed: Sequence[Variant]) -> Explanation:
    """All these candidates at once, each held back by a prior of its typical size."""
    whole = with_candidates(problem, listed, RIDGE)
    fitted = solve(whole, np.concatenate((z, whole.z0[len(z) :])), 3, chords=4)
    names = tuple(problem.machine.candidates[v.candidate].name for v in listed)
    return Explanation(names, tuple(listed), whole, *fitted)


def thinned(shown: Picture, chosen: Sequence[int]) -> tuple[int, ...]:
    """Members taken out one by one, whichever is missed least, while that costs less than the penalty."""
    left = tuple(chosen)
    while left:
        rests = [left[:k] + left[k + 1 :] for k in range(len(left))]
        gains = shown.gains(rests)
        rest = rests[int(np.argmax(gains))]
        whole = shown.gain(left)
        if len(left) <= LARGEST and np.isfinite(whole) and whole - gains.max() > PENALTY:
            break
        left = rest
    return tuple(sorted(left))
