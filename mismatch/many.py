"""When many effects act at once, none can be told from the calibrated model: fit all physics, then thin out."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from twinbench.mismatch.explanation import Explanation, present, refit, rewhitened, with_candidates
from twinbench.mismatch.fit import Problem
from twinbench.mismatch.noise import AUTOREGRESSION_ORDER, Whitener
from twinbench.mismatch.picture import Picture, Variant, is_fault, picture
from twinbench.mismatch.search import EFFECT_PENALTY, MOST_EFFECTS, local_search, wander
from twinbench.mismatch.solve import NEARLY, solve
from twinbench.physics.simulator import Array

MANY = 3
"""From so many effects on."""
THINNINGS_MOST = 4
"""Pictures that are thinned out one after the other, at most."""
KNOWN_SIZE = 6.0
"""Units by which an effect of roughly its usual size is better than chance, whatever how likely it is to be there."""
SIZE_PRIOR, TIGHT = 0.5, 0.5
"""Where all candidates are fitted at once: prior standard deviation of a size, in typical ones, and what all other
priors are shortened to. Loose, such a fit ends where large effects cancel each other."""


def from_everything(
    best: Explanation,
    problem: Problem,
    choices: Sequence[Variant],
    floor: Array,
    advance: Callable[[float], None] = lambda share: None,
) -> Explanation:
    """The best of the given explanation and of those reached from the fit of everything.

    That fit begins from the simulator as it came: a calibration without the effects has gone far out of its way
    to imitate them. And its errors say what is noise: those of few effects hide the rest.

    Args:
        problem: of the calibrated model, under the noise of ``best``, all of it there from the beginning.
        floor: (ny,) least noise of block means, in the outputs' units.
        advance: told the share that is done.
    """
    machine = problem.machine
    # Each once, at its nominal shape, which comes first in the choices.
    physics = {v.candidate: v for v in choices[::-1] if not is_fault(machine.candidates[v.candidate])}
    at = everything(problem, tuple(physics.values()), lambda share: advance(0.5 * share))
    for turn in range(THINNINGS_MOST):
        advance(0.5 + 0.5 * turn / THINNINGS_MOST)
        at = _under_own_noise(at, floor)
        around = replace(problem, whitener=at.problem.whitener, offsets=at.problem.offsets)
        z = at.z[: len(problem.unknowns)]
        shown = picture(around, z, choices, present(at))
        here = tuple(range(len(at.chosen)))
        starts = ((), here if len(here) <= MOST_EFFECTS else thinned(shown, here))
        ends = {
            local_search(shown, wander(shown, start, MOST_EFFECTS, EFFECT_PENALTY), MOST_EFFECTS, EFFECT_PENALTY)
            for start in starts
        }
        chosen = max(ends, key=lambda end: shown.score(end, EFFECT_PENALTY))
        if {shown.variants[i].candidate for i in chosen} == {v.candidate for v in at.chosen}:
            break
        at = refit(around, z, shown, chosen, rounds=3)
    else:
        at = _under_own_noise(at, floor)
    # Under the noise of whichever leaves less: what is unexplained makes any explanation cheap.
    whitener = min((best.problem.whitener, at.problem.whitener), key=lambda w: float(np.log(w.variance()).sum()))
    return min((_under(whitener, best), _under(whitener, at)), key=lambda e: e.score(EFFECT_PENALTY))


def completed(best: Explanation, shown: Picture) -> Explanation:
    """With the physics besides that is likely where so much is missing already, though it explains little.

    What is one of seven effects of 28 that might be there is likely by itself: it must earn less than the first.
    Left out, it would be made up for by what drifts: the health of a machine is wrong then, if hardly its readings.

    Args:
        shown: a picture around ``best``.
    """
    faults = {j for j, candidate in enumerate(best.problem.machine.candidates) if is_fault(candidate)}
    owner = [v.candidate for v in shown.variants]
    here = tuple(sorted(owner.index(v.candidate) for v in best.chosen))
    chosen = local_search(shown, here, MOST_EFFECTS, each_of_many(best), without=faults)
    return best if set(chosen) == set(here) else refit(best.bare, best.z[: best.first], shown, chosen, rounds=2)


def each_of_many(best: Explanation) -> float:
    """Units that an effect must earn where as much physics is missing as in ``best``; fewer than one alone must."""
    physics = sum(not is_fault(candidate) for candidate in best.problem.machine.candidates)
    found = max(len(best.names), 1)
    return KNOWN_SIZE + 2.0 * float(np.log(max((physics - found) / found, 1.0)))


def _under(whitener: Whitener, explanation: Explanation) -> Explanation:
    """Fitted again under a given noise."""
    problem = replace(explanation.problem, whitener=whitener)
    z, cost = solve(problem, explanation.z, 3)
    return replace(explanation, problem=problem, z=z, cost=cost)


def _under_own_noise(explanation: Explanation, floor: Array) -> Explanation:
    """Fitted again under the noise that it leaves."""
    problem = rewhitened(explanation.problem, explanation.z, floor, AUTOREGRESSION_ORDER).refined(explanation.z)
    z, cost = solve(problem, explanation.z, 3, chords=4)
    return replace(explanation, problem=problem, z=z, cost=cost)


def everything(
    problem: Problem, listed: Sequence[Variant], advance: Callable[[float], None] = lambda share: None
) -> Explanation:
    """All these candidates at once, held back by their priors."""
    held_back = replace(problem, unknowns=tuple(replace(u, sd=TIGHT * u.sd) for u in problem.unknowns))
    whole = with_candidates(held_back, listed, SIZE_PRIOR)
    whole = whole.refined(whole.z0)
    fitted = solve(whole, whole.z0, 8, chords=4, share=NEARLY, advance=advance)
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
        if len(left) <= MOST_EFFECTS and np.isfinite(whole) and whole - gains.max() > EFFECT_PENALTY:
            break
        left = rest
    return tuple(sorted(left))
