"""What these recordings cannot tell from an explanation: for each of its effects, what could be there instead."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from twinbench.mismatch.explanation import Explanation, refit
from twinbench.mismatch.picture import Picture
from twinbench.mismatch.search import EFFECT_PENALTY, local_search, replacements
from twinbench.physics.simulator import Array

NEAR_UNITS, NEAR_SHARE, NEAR_MOST = 10.0, 0.02, 45.0
"""Units that the next explanation must stay behind to be ruled out: so many and a share of the gain, since no form
is exact, up to so many in all."""
FITTED_LIKELY, FITTED_MOST = 4, 12
"""Replacements of each effect that are fitted in full, if the linear picture holds them for possible; so many of the
accepted ones', if it cannot tell them apart."""
OWN_COLUMNS_MOST = 3
"""Effects of an explanation whose alternatives are fitted with columns of their own, not only with the picture's."""
TIED = 0.97
"""Two effects whose sizes are correlated so much can take each other's place in any share."""
FAR_TIMES = 2.0
"""Times as much may another explanation lie behind on the fitted recordings, if those held out make up for it."""
ONE = 0.5
"""Units that names for one and the same thing differ by at most."""


class Rivals(NamedTuple):
    """Names that an effect cannot be told from, likeliest first, and how many things it and they are names for.

    Attributes:
        groups: the effect's own name and these, grouped: names in one group are names for one thing.
    """

    names: list[str]
    things: int
    groups: tuple[tuple[str, ...], ...] = ()


def slack(worth: float) -> float:
    """Units that another explanation may lie behind and still be possible, of something that gains so much."""
    return min(NEAR_UNITS + NEAR_SHARE * max(worth, 0.0), NEAR_MOST)


def alternatives(
    before: Explanation,
    best: Explanation,
    shown: Picture,
    pairs: bool = True,
    advance: Callable[[float], None] = lambda share: None,
) -> list[Explanation]:
    """What could stand in the place of one effect of ``best`` or another, and ``best`` without each, fitted in full.

    Another candidate can stand alone in an effect's place; several can together, where the picture without the
    effect is nearly as good.

    Args:
        shown: a picture around ``best``.
    """
    near = slack(before.cost - best.cost)
    machine = best.problem.machine
    owner = [v.candidate for v in shown.variants]
    chosen = [owner.index(v.candidate) for v in best.chosen]
    here = shown.score(chosen, EFFECT_PENALTY)
    sets: set[tuple[int, ...]] = set()
    for k, options in enumerate(replacements(shown, chosen)):
        rest = (*chosen[:k], *chosen[k + 1 :])
        sets |= {(*rest, i) for loss, i in options[:FITTED_LIKELY] if loss < 2.0 * near}
        sets |= {rest} if rest else set()
        out_of_play = {j for j, c in enumerate(machine.candidates) if c.name in _same(best, best.names[k])}
        without = local_search(shown, rest, len(chosen) + 1, EFFECT_PENALTY, pairs, out_of_play)
        if without and here - shown.score(without, EFFECT_PENALTY) < 2.0 * near:
            sets.add(without)
    found = []
    for place, one in enumerate(sorted(sets)):
        advance(place / len(sets))
        found.append(refit(best.bare, best.z[: best.first], shown, one, fresh_rounds(best)))
    return found


def nearest(before: Explanation, best: Explanation, shown: Picture, fitted: Sequence[Explanation]) -> list[Explanation]:
    """Further candidates in each effect's place, fitted: all that the picture cannot tell from it, and the next.

    What was never weighed against another has no probability, and a list of what could be meant must be complete.

    Args:
        fitted: what was fitted already.
    """
    near = slack(before.cost - best.cost)
    candidates = best.problem.machine.candidates
    owner = [v.candidate for v in shown.variants]
    chosen = [owner.index(v.candidate) for v in best.chosen]
    known = {frozenset(e.names) for e in fitted}
    sets = {}
    for k, options in enumerate(replacements(shown, chosen)):
        rest = (*chosen[:k], *chosen[k + 1 :])
        for place, (loss, i) in enumerate(options[:FITTED_MOST]):
            names = frozenset(candidates[owner[j]].name for j in (*rest, i))
            if names not in known and np.isfinite(loss) and (place == 0 or loss < near):
                sets[names] = (*rest, i)
    return [refit(best.bare, best.z[: best.first], shown, one, fresh_rounds(best)) for one in sets.values()]


def fresh_rounds(best: Explanation) -> int:
    """Rounds with columns of its own that a set like it but for one effect needs: few of many change little."""
    return 1 if len(best.names) <= OWN_COLUMNS_MOST else 0


def rivals(
    before: Explanation,
    best: Explanation,
    fitted: Sequence[Explanation],
    also: Callable[[Explanation], float] = lambda e: 0.0,
) -> list[Rivals]:
    """For each effect of ``best``, names that could stand in its place.

    They come from explanations without it that are nearly as good; and a fellow whose size is tied to its own
    can take over its part. One that needs more effects than the best has no form to excuse: it must be nearly as
    good but for noise.

    Args:
        fitted: other explanations, ``alternatives`` among them.
        also: units that an explanation lies behind the best on other recordings.
    """
    tied = _tied(best)

    def behind(e: Explanation) -> float:
        return e.score(EFFECT_PENALTY) - best.score(EFFECT_PENALTY)

    instead, alone = [], []
    for name in best.names:
        without = [e for e in fitted if not _same(best, name) & set(e.names)]
        # What it gains over the best explanation of fewer effects that lacks it.
        worth = min([before.cost, *(e.cost for e in without if len(e.names) < len(best.names))]) - best.cost
        close: dict[frozenset[str], float] = {}
        for e in sorted(without, key=lambda e: -e.cost):
            near = slack(worth) if len(e.names) <= len(best.names) else NEAR_UNITS
            if behind(e) < FAR_TIMES * near and (in_all := behind(e) + also(e)) < near:
                close[frozenset(e.names)] = in_all
        all_but = set(best.names) - {name}
        alone.append({other for names in close if all_but <= names for other in names - all_but})
        # Of one that does with less than another nothing is learnt from the other.
        instead.append({names: b for names, b in close.items() if not any(other < names for other in close)})
    out = []
    for k, plain in enumerate(instead):
        others: dict[str, float] = {}
        for names, b in plain.items():
            # Where another effect of the best is gone too, what takes its place alone stands for that one.
            gone = [j for j, lost in enumerate(best.names) if j != k and lost not in names]
            for other in names - set(best.names) - set().union(*(alone[j] for j in gone)):
                others[other] = min(b, others.get(other, np.inf))
        ranked = sorted(others, key=lambda other: (others[other], other))
        fellows = [best.names[j] for j in np.flatnonzero(tied[k])]
        # Itself, at nothing behind, is one of them.
        behind_by = {best.names[k]: 0.0, **{other: others[other] for other in ranked}}
        groups = [*_grouped(behind_by), *((fellow,) for fellow in fellows)]
        out.append(Rivals([*fellows, *ranked], len(groups), tuple(groups)))
    return out


def _grouped(behind: dict[str, float]) -> list[tuple[str, ...]]:
    """Names for one thing together: those whose losses differ by next to nothing, in steps."""
    groups: list[list[str]] = []
    last = -np.inf
    for name, loss in sorted(behind.items(), key=lambda item: item[1]):
        if not loss - last <= ONE:
            groups.append([])
        groups[-1].append(name)
        last = loss
    return [tuple(group) for group in groups]


def losses(
    before: Explanation,
    best: Explanation,
    fitted: Sequence[Explanation],
    also: Callable[[Explanation], float] = lambda e: 0.0,
) -> dict[frozenset[str], float]:
    """Units that everything fitted lies behind ``best``, what it must earn in them; the empty set is no effect.

    Args:
        also: units besides on other recordings; asked for what is near.
    """
    found = {frozenset(best.names): 0.0}
    for e in (before, *fitted):
        loss, names = e.score(EFFECT_PENALTY) - best.score(EFFECT_PENALTY), frozenset(e.names)
        if names != frozenset(best.names):
            loss += also(e) if loss < FAR_TIMES * NEAR_MOST else 0.0
            found[names] = min(loss, found.get(names, np.inf))
    return found


def _same(explanation: Explanation, name: str) -> set[str]:
    """Itself, and what can become it: no other thing."""
    candidates = explanation.problem.machine.candidates
    return {c.name for c in candidates if name in (c.name, c.mechanism.contains)}


def plainest(tried: Sequence[Explanation]) -> Explanation:
    """The best of these, or one hardly worse that has what an effect of the best contains in its place."""
    best = tried[0]
    plainer = {best.problem.machine.candidates[v.candidate].family for v in best.chosen}
    for e in tried[1:]:
        if set(e.names) == plainer and e.cost - best.cost < EFFECT_PENALTY:
            return e
    return best


def _tied(best: Explanation) -> np.ndarray:
    """Which effects' sizes are tied to which others', (n, n) of bool."""
    problem = best.problem
    G, _, _ = problem.normal(best.z, problem.residuals(best.z))
    scale = 1.0 / np.sqrt(np.maximum(np.diag(G), 1e-300))
    covariance = np.linalg.pinv(G * np.outer(scale, scale), hermitian=True, rcond=1e-12)
    lengths = [len(problem.machine.candidates[v.candidate].at) for v in best.chosen]
    at = best.first + np.concatenate(([0], np.cumsum(lengths[:-1]))).astype(int)
    sizes: Array = covariance[np.ix_(at, at)]
    spread = np.sqrt(np.maximum(np.diag(sizes), 1e-300))
    return (np.abs(sizes / np.outer(spread, spread)) > TIED) & ~np.eye(len(at), dtype=bool)
