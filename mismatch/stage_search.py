"""Third and fourth stage, in turns: picture all candidates at once, and fit in full what looks best there.

A picture is right near the fit only. So the next one is taken from what was fitted, until nothing changes; then
everything is judged under the noise that the last fit leaves.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.stats import chi2

from twinbench.mismatch.asked import Progress
from twinbench.mismatch.climb import climb, gross, most_and_others
from twinbench.mismatch.explanation import Explanation, fitted_again, present, refit, rewhitened
from twinbench.mismatch.fit import Problem
from twinbench.mismatch.guards import Guards
from twinbench.mismatch.many import MANY, from_everything
from twinbench.mismatch.noise import AUTOREGRESSION_ORDER
from twinbench.mismatch.onset import find_onsets, settled_onsets
from twinbench.mismatch.picture import Picture, Variant, picture
from twinbench.mismatch.rivals import plainest
from twinbench.mismatch.search import EFFECT_PENALTY, MOST_EFFECTS, best_sets, local_search
from twinbench.physics.simulator import Array

LEAST_GAIN = 20.0
"""Log-likelihood units (twice) below which nothing is named, whatever the noise would allow."""
TURNS = 8
FINALISTS = 8
"""Explanations of gross errors that are weighed against the best at the end."""
PROMISING = 5
"""Sets that are fitted in full on the way; all at the end, where they may be rivals."""
ON_THE_WAY = 2
"""Rounds of fits that are not the last."""
NULL_DRAWS, NULL_INFLATION = 400, 1.3


@dataclass(frozen=True)
class Searched:
    """What the search ends with.

    Attributes:
        before, best: the calibrated model, and the best explanation or None.
        tried: explanations in the order of merit.
        finalists: those that gross errors are explained by nearly as well.
        shown: the last picture.
        threshold: the gain that an effect must have.
    """

    before: Explanation
    best: Explanation | None
    tried: list[Explanation]
    finalists: list[Explanation]
    shown: Picture
    threshold: float


@dataclass(frozen=True)
class Search:
    """What all turns of the search share.

    Attributes:
        choices: all variants of all candidates.
        floor: (ny,) least noise of block means, in the outputs' units.
    """

    choices: Sequence[Variant]
    floor: Array
    progress: Progress
    guards: Guards

    @property
    def order(self) -> int:
        """Of the autoregression that the noise may be."""
        return AUTOREGRESSION_ORDER if self.guards.whitening else 0

    def pictured(self, problem: Problem, at: Explanation, turn: int = TURNS) -> Picture:
        """All candidates around an explanation, on top of a problem without effects."""
        steps = len(self.choices) * len(problem.tracks)
        count = iter(range(steps))
        return picture(
            problem,
            at.z[: len(problem.unknowns)],
            self.choices,
            present(at),
            lambda: self.progress("screen", (turn + next(count, steps) / steps) / (TURNS + 1)),
            self.guards.projection,
        )

    def unchanged(self, shown: Picture, best: Explanation) -> bool:
        """Would a search from what is there end where it is?"""
        here = tuple(range(len(best.chosen)))
        ends = local_search(shown, here, MOST_EFFECTS, EFFECT_PENALTY, self.guards.pairs)
        owners = {shown.variants[i].candidate for i in ends}
        return owners == {v.candidate for v in best.chosen}

    def refitted(
        self, problem: Problem, at: Explanation, shown: Picture, penalty: float, turn: int
    ) -> list[Explanation]:
        """The promising sets fitted, the best of them with its shape parameters free; best first."""
        z = at.z[: len(problem.unknowns)]
        sets = best_sets(shown, MOST_EFFECTS, penalty, self.guards.pairs, range(len(at.chosen)))
        if turn < TURNS:
            sets = sorted(sets, key=lambda s: -shown.score(s, penalty))[:PROMISING]
        found = []
        for k, chosen in enumerate(sets):
            self.progress("refit", (turn + k / len(sets)) / (TURNS + 1))
            found.append((refit(problem, z, shown, chosen), chosen))
        found.sort(key=lambda f: f[0].score(penalty))
        out = [e for e, _ in found]
        if found:
            out[0] = refit(problem, z, shown, found[0][1], rounds=4 if turn == TURNS else ON_THE_WAY)
        return sorted(out, key=lambda e: e.score(penalty))


@dataclass(frozen=True)
class _Reached:
    """Where the search stands: the problem without effects, the calibrated model, and the best explanation so far."""

    problem: Problem
    before: Explanation
    best: Explanation
    finalists: list[Explanation] = field(default_factory=list)


def searched(before: Explanation, search: Search) -> Searched:
    """Picture, fit what looks best, picture again from there, until nothing changes; then judge with true noise."""
    at = _climbed(_Reached(before.problem, before, before), search)
    if not at.finalists:
        at = _turned(at, search)
        at = _from_everything(at, search)
    return _judged(at, search)


def _climbed(at: _Reached, search: Search) -> _Reached:
    """Where errors are gross: sets of effects grown one by one, each fitted in full."""
    problem, before = at.problem, at.before
    if not gross(problem, before.z, search.floor):
        return at
    best, *others = climb(
        before, search.choices, search.guards.pairs, lambda share: search.progress("screen", share / (TURNS + 1))
    )
    problem = rewhitened(best.problem, best.z, search.floor, search.order, problem)
    best = fitted_again(problem, best)
    finalists = most_and_others([e for e in others if e.names], FINALISTS)
    return _Reached(replace(problem, offsets=best.problem.offsets), before, best, finalists)


def _turned(at: _Reached, search: Search) -> _Reached:
    """Pictures and fits in turns, until nothing changes."""
    problem, before, best = at.problem, at.before, at.best
    for turn in range(TURNS):
        shown = search.pictured(problem, best, turn)
        if best.names and search.unchanged(shown, best):
            break
        if not best.names and turn == 0 and (since := find_onsets(problem, best.z, shown)):
            problem = replace(problem, since=since)
            best = before = replace(before, problem=problem)
            shown = search.pictured(problem, best, turn)
        found = search.refitted(problem, best, shown, EFFECT_PENALTY, turn)
        if not found or not found[0].score(EFFECT_PENALTY) < best.score(EFFECT_PENALTY) - 1.0:
            break
        best = found[0]
        # What is explained no longer counts as noise.
        problem = rewhitened(best.problem, best.z, search.floor, search.order, problem)
        best = fitted_again(problem, best, ON_THE_WAY)
        problem = replace(problem, offsets=best.problem.offsets)
        if len(best.names) >= MANY:
            break
    return _Reached(problem, before, best)


def _from_everything(at: _Reached, search: Search) -> _Reached:
    """Where many effects act at once: the search once more, from the fit of all of them."""
    if len(at.best.names) < MANY:
        return at
    # What seems to begin in mid-recording may be another effect that has not been thought of.
    problem = replace(at.problem, whitener=at.best.problem.whitener, since=())
    best = from_everything(
        at.best,
        problem,
        search.choices,
        0.3 * search.floor,
        lambda share: search.progress("refit", (TURNS - 1 + share) / (TURNS + 1)),
    )
    return _Reached(replace(problem, since=best.problem.since), at.before, best)


def _judged(at: _Reached, search: Search) -> Searched:
    """Everything fitted again under the noise that the best leaves, and the best of that, if it gains enough."""
    problem = rewhitened(at.best.problem, at.best.z, 0.3 * search.floor, search.order, at.problem)
    if problem.since:
        problem = replace(problem, since=settled_onsets(at.best.problem, at.best.z).since)
    best, before = fitted_again(problem, at.best), fitted_again(problem, at.before)
    problem = replace(problem, offsets=best.problem.offsets)
    shown = search.pictured(problem, best)
    threshold = null_threshold(shown, search.guards)
    # What was climbed to has earned its place by independent readings.
    tried = [] if at.finalists else search.refitted(problem, best, shown, threshold, TURNS)
    if best.names:
        tried.append(best)
    finalists = [fitted_again(problem, e) for e in at.finalists]
    tried.sort(key=lambda e: e.score(threshold))
    if not tried or not (finalists or tried[0].score(threshold) < before.cost):
        return Searched(before, None, tried, finalists, shown, threshold)
    if not finalists and plainest(tried) is not best:
        best = fitted_again(problem, plainest(tried))
        tried = [best, *(e for e in tried if e.names != best.names)]
        shown = search.pictured(replace(problem, offsets=best.problem.offsets), best)
    return Searched(before, best, tried, finalists, shown, threshold)


def null_threshold(shown: Picture, guards: Guards = Guards(), seed: int = 0) -> float:
    """Gain that the best single candidate reaches by noise alone in one of a hundred recordings, inflated."""
    if not guards.nominal_null:
        return float(chi2.isf(0.01, 1))
    rng = np.random.default_rng(seed)
    d = np.diag(shown.G)
    informative = d > 1e-3
    if not informative.any():
        return LEAST_GAIN
    G = shown.G[np.ix_(informative, informative)] / np.sqrt(np.outer(d[informative], d[informative]))
    w, V = np.linalg.eigh(G)
    root = V * np.sqrt(np.maximum(w, 0.0))
    draws = root @ rng.normal(size=(len(w), NULL_DRAWS))
    return max(LEAST_GAIN, NULL_INFLATION * float(np.quantile((draws**2).max(axis=0), 0.99)))
