"""What these recordings cannot tell from an explanation: for each of its effects, what could be there instead."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from mismatch.explanation import Explanation, refit
from mismatch.picture import Picture
from mismatch.search import PENALTY, local_search, replacements
from physics.simulator import Array

NEAR, NEAR_SHARE, NEAR_MOST = 10.0, 0.02, 45.0
"""Units that the next explanation must stay behind to be ruled out: so many and a share of the gain, since no form
is exact, up to so many in all."""
LIKELY = 4
"""Replacements of each effect that are fitted in full, if the linear picture holds them for possible."""
TIED = 0.97
"""Two effects whose sizes are correlated so much can take each other's place in any share."""


def slack(before: Explanation, best: Explanation) -> float:
    """Units that another explanation may lie behind the best and still be possible."""
    return min(NEAR + NEAR_SHARE * (before.cost - best.cost), NEAR_MOST)


def rivals(
    before: Explanation, best: Explanation, shown: Picture, tried: Sequence[Explanation], pairs: bool = True
) -> list[list[str]]:
    """For each effect of ``best``, names that could stand in its place, likeliest first.

    Another name can stand alone in an effect's place; several can together, where the best explanation
    without it is nearly as good; and a fellow whose size is tied to its own can take over its part.

    Args:
        shown: a picture around ``best``.
        tried: other explanations that were fitted in full.
    """
    near = slack(before, best)
    machine = best.problem.machine
    n_base = len(best.z) - sum(len(machine.candidates[v.candidate].at) for v in best.chosen)
    base = replace(best.problem, unknowns=best.problem.unknowns[:n_base])
    owner = [v.candidate for v in shown.variants]
    chosen = [owner.index(v.candidate) for v in best.chosen]
    here = shown.score(chosen, PENALTY)
    # What can become an effect is no other thing than it.
    same = [{c.name for c in machine.candidates if name in (c.name, c.mechanism.contains)} for name in best.names]
    sets = set()
    for k, options in enumerate(replacements(shown, chosen)):
        rest = (*chosen[:k], *chosen[k + 1 :])
        sets |= {(*rest, i) for loss, i in options[:LIKELY] if loss < 2.0 * near}
        out_of_play = {j for j, c in enumerate(machine.candidates) if c.name in same[k]}
        without = local_search(shown, rest, len(chosen) + 1, PENALTY, pairs, out_of_play)
        if here - shown.score(without, PENALTY) < 2.0 * near:
            sets.add(without)
    fitted = [*tried, *(refit(base, best.z[:n_base], shown, s, rounds=1) for s in sorted(sets))]
    tied = _tied(best, n_base)
    out = []
    for k in range(len(chosen)):
        close: dict[str, float] = {}
        for e in fitted:
            behind = e.score(PENALTY) - best.score(PENALTY)
            if not same[k] & set(e.names) and behind < near:
                for other in set(e.names) - set(best.names):
                    close[other] = min(close.get(other, np.inf), behind)
        ranked = sorted(close, key=lambda other: close[other])
        out.append([*(best.names[j] for j in np.flatnonzero(tied[k])), *ranked])
    return out


def plainest(tried: Sequence[Explanation]) -> Explanation:
    """The best of these, or one hardly worse that has what an effect of the best contains in its place."""
    best = tried[0]
    contained = {c.name: c.mechanism.contains for c in best.problem.machine.candidates}
    plainer = {contained[name] or name for name in best.names}
    for e in tried[1:]:
        if set(e.names) == plainer and e.cost - best.cost < PENALTY:
            return e
    return best


def _tied(best: Explanation, n_base: int) -> np.ndarray:
    """Which effects' sizes are tied to which others', (n, n) of bool."""
    problem = best.problem
    G, _, _ = problem.normal(best.z, problem.residuals(best.z))
    scale = 1.0 / np.sqrt(np.maximum(np.diag(G), 1e-300))
    covariance = np.linalg.pinv(G * np.outer(scale, scale), hermitian=True, rcond=1e-12)
    lengths = [len(problem.machine.candidates[v.candidate].at) for v in best.chosen]
    at = n_base + np.concatenate(([0], np.cumsum(lengths[:-1]))).astype(int)
    sizes: Array = covariance[np.ix_(at, at)]
    spread = np.sqrt(np.maximum(np.diag(sizes), 1e-300))
    return (np.abs(sizes / np.outer(spread, spread)) > TIED) & ~np.eye(len(at), dtype=bool)
