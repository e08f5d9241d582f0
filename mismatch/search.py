"""Which sets of candidates look best in the picture: what is fitted in full."""

from __future__ import annotations

import itertools
from collections.abc import Sequence, Set

import numpy as np

from twinbench.mismatch.picture import Picture

EFFECT_PENALTY = 16.0
"""Log-likelihood units (twice) that each further effect must earn: log n + 2 log m for usual n and m."""
REFITS = 6
"""Sets that are fitted in full, per number of effects."""
MOVES = 6000
"""Steps of a random walk among sets."""
MOST_EFFECTS = 14
"""Effects in one explanation at most."""


def best_sets(
    shown: Picture, most: int, penalty: float = EFFECT_PENALTY, pairs: bool = True, start: Sequence[int] = ()
) -> list[tuple[int, ...]]:
    """Promising sets of variants: the best singles, the best pairs, and what a local search ends in.

    The local search adds, drops, swaps, and puts one for two until nothing helps.
    """
    n = len(shown.variants)
    owner, family = [v.candidate for v in shown.variants], shown.families
    alone = shown.gains([(i,) for i in range(n)])
    once = _first_of_each([int(i) for i in np.argsort(-alone)], owner)
    # What the best faulty sensor or input explains is always told.
    singles = dict.fromkeys([*once[:REFITS], *[i for i in once if shown.faults[i]][:1]])
    found: list[tuple[int, ...]] = [(i,) for i in singles if np.isfinite(alone[i])]
    if pairs:
        # Two effects that each look poor alone can be plain together.
        diagonal = np.maximum(np.diag(shown.G), 1e-12)
        options = [
            (i, j)
            for i, j in itertools.combinations(range(n), 2)
            if family[i] != family[j] and abs(shown.G[i, j]) < 0.995 * np.sqrt(diagonal[i] * diagonal[j])
        ]
        together = shown.gains(options)
        seen: set[frozenset[int]] = set()
        for place in np.argsort(-together):
            pair = options[place]
            names = frozenset(owner[i] for i in pair)
            if np.isfinite(together[place]) and names not in seen and len(seen) < REFITS:
                seen.add(names)
                found.append(pair)
    for begin in ((), tuple(start), *found[:1], *found[-1:]):
        local = local_search(shown, begin, most, penalty, pairs)
        if local and local not in found:
            found.append(local)
    return found


def _first_of_each(order: Sequence[int], owner: Sequence[int]) -> list[int]:
    seen: set[int] = set()
    return [i for i in order if not (owner[i] in seen or seen.add(owner[i]))]  # type: ignore[func-returns-value]


def local_search(
    shown: Picture, begin: Sequence[int], most: int, penalty: float, pairs: bool = True, without: Set[int] = frozenset()
) -> tuple[int, ...]:
    """Add, drop, swap, and put one for two, whatever helps most, until nothing does.

    Args:
        without: candidates that may not be in it.
    """
    owner, family = [v.candidate for v in shown.variants], shown.families.tolist()
    current = tuple(sorted(begin))
    score = shown.score(current, penalty)
    n = len(owner)
    while True:
        options = [current[:k] + current[k + 1 :] for k in range(len(current))]
        taken = {family[i] for i in current}
        outside = [i for i in range(n) if family[i] not in taken and owner[i] not in without]
        if len(current) < most:
            options += [(*current, i) for i in outside]
        for k in range(len(current)):
            rest = current[:k] + current[k + 1 :]
            kin = [i for i in range(n) if family[i] == family[current[k]] and i != current[k]]
            same = [i for i in kin if owner[i] not in without]
            options += [(*rest, i) for i in (*outside, *same)]
        if pairs and len(current) >= 2:
            for k, m in itertools.combinations(range(len(current)), 2):
                rest = tuple(x for place, x in enumerate(current) if place not in (k, m))
                options += [(*rest, i) for i in outside]
        scores = shown.scores(options, penalty)
        if not len(options) or not scores.max() > score + 1e-6:
            return current
        best = int(np.argmax(scores))
        current, score = tuple(sorted(options[best])), float(scores[best])


def wander(shown: Picture, begin: Sequence[int], most: int, penalty: float, seed: int = 0) -> tuple[int, ...]:
    """The best set that a random walk by adding, dropping and swapping one or two comes by (MC3, Madigan and York).

    Where many effects act at once, sets that differ in several members at a time can be worlds apart
    for a search that takes one step after another.
    """
    rng = np.random.default_rng(seed)
    family = shown.families
    memory: dict[tuple[int, ...], float] = {}

    def score(chosen: tuple[int, ...]) -> float:
        if chosen not in memory:
            memory[chosen] = shown.score(chosen, penalty)
        return memory[chosen]

    current = best = tuple(sorted(begin))
    for _ in range(MOVES):
        out = rng.permutation(len(current))[: rng.integers(0, min(2, len(current)) + 1)]
        rest = [i for place, i in enumerate(current) if place not in out]
        free = np.flatnonzero(~np.isin(family, family[rest]))
        added: list[int] = []
        for i in rng.permutation(free)[: rng.integers(0, 3)]:
            if family[i] not in family[added]:
                added.append(int(i))
        option = tuple(sorted((*rest, *added)))
        if option == current or len(option) > most:
            continue
        if np.log(rng.random()) < 0.5 * (score(option) - score(current)):
            current = option
            if score(current) > score(best):
                best = current
    return best


def replacements(shown: Picture, chosen: Sequence[int]) -> list[list[tuple[float, int]]]:
    """For each member of a set, what could stand in its place, and the gain lost by that, least first."""
    owner = [v.candidate for v in shown.variants]
    whole = shown.gain(chosen)
    taken = {owner[i] for i in chosen}
    out = []
    for k in range(len(chosen)):
        rest = [*chosen[:k], *chosen[k + 1 :]]
        losses: dict[int, tuple[float, int]] = {}
        for i, o in enumerate(owner):
            if o not in taken:
                losses[o] = min(losses.get(o, (np.inf, i)), (whole - shown.gain((*rest, i)), i))
        out.append(sorted(losses.values()))
    return out
