"""All physics at once, then fewer: where many effects act, one at a time finds what covers several of them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from twinbench.mismatch.fit import Problem
from twinbench.mismatch.naming.bounded import Bounds
from twinbench.mismatch.naming.effect import Effect
from twinbench.mismatch.naming.ground import Ground, Products
from twinbench.mismatch.naming.marginal import LEARNT, one_sided
from twinbench.mismatch.naming.posterior import posterior
from twinbench.mismatch.naming.settle import SETTLED, Settled, odds_of, settled
from twinbench.mismatch.seed import ENGINE_SEED
from twinbench.mismatch.solve import HOP
from twinbench.physics.simulator import Array

BEGINNINGS = 6
"""Places at most from which all physics at once is thinned out, until two ends are one: of the same effects or of
effects that do the same. On the Cascaded Tanks six beginnings end at 223 to 431 nats, of which two differ by 1.4; with
three nats the search ended there."""


def all_at_once(problem: Problem, z: Array, effects: Sequence[Effect], ground: Ground) -> Settled:
    """Those of many effects that are likely together, brought to their fixed point.

    They are thinned out without a discrepancy, which would take what is not explained yet, and again with it.

    Args:
        problem: with no effect in it.
        z: (K,) where the problem's unknowns stand, each in its own unit.
        effects: each but slightly present.
    """
    exact = ground.exact
    few = thinned(settled(problem, z, effects, exact, exact.s), exact)
    return thinned(settled(few.bare, few.own, few.now, ground, ground.s), ground)


def from_elsewhere(
    first: Settled, problem: Problem, z: Array, effects: Sequence[Effect], ground: Ground
) -> list[Settled]:
    """All at once from other places, until the two likeliest ends are one; all ends, the likeliest first.

    The way there has kinks, at thresholds above all, and where it ends may hang on where it begins.

    Args:
        first: the first end; the other arguments are as of ``all_at_once``.
        z: (K,) where the first one began, each unknown in its own unit.
    """
    rng, scale = np.random.default_rng(ENGINE_SEED), np.array([u.scale for u in problem.unknowns])
    ends = [first]
    while len(ends) < BEGINNINGS and (len(ends) < 2 or ends[0].log - ends[1].log >= LEARNT):
        hop = HOP * scale * rng.standard_normal(len(scale))
        ends.append(all_at_once(problem, z + hop, effects, ground))
        ends.sort(key=lambda h: -h.log)
    return ends


def thinned(found: Settled, ground: Ground) -> Settled:
    """Leave out half of the effects that seem needless, or fewer of them, as long as the evidence rises."""
    needed: set[int] = set()
    while True:
        whole = Whole(found, ground)
        odds = [whole.less([k]).odds for k in range(len(found.effects))]
        order = np.argsort(odds)[::-1]
        out = [k for k in order if odds[k] > 0.0 and found.effects[k].variant.candidate not in needed]
        out = out[: (len(out) + 1) // 2]
        if not out:
            return found
        while out:
            fewer = whole.settled_less(whole.less(out), found.log)
            if fewer.log > found.log:
                found = fewer
                break
            if len(out) == 1:
                needed.add(found.effects[out[0]].variant.candidate)
            out = out[: len(out) // 2]


class Less(NamedTuple):
    """A hypothesis less some effects, as far as can be told from where the whole one is.

    Attributes:
        odds: log odds of the absence of these against their presence.
        own: (K,) where the unknowns that are no effect's should go, each in its own unit.
        effects: those that are left, as they should then be; ``now`` as they are.
    """

    odds: float
    own: Array
    effects: tuple[Effect, ...]
    now: tuple[Effect, ...]


class Whole:
    """A hypothesis of which effects are left out."""

    def __init__(self, found: Settled, ground: Ground) -> None:
        self._found, self._ground, self._bounds = found, ground, Bounds.of(found.problem)
        self._low, self._high = self._bounds.around(found.z)
        _, self._log = self._told(found.products, np.arange(len(found.mean)))

    def less(self, out: Sequence[int]) -> Less:
        """It without some effects.

        All that is unknown is moved, and the discrepancy learnt anew: it takes what it can of these effects. Their
        shapes, and where their memories start, stay unknown: from afar a column cannot tell that they do nothing by
        then.

        Args:
            out: positions of the effects.
        """
        found, bounds = self._found, self._bounds
        sizes = [int(found.entries(i)[0]) for i in out]
        gone = np.concatenate((sizes, *(found.wandering(i) for i in out))).astype(int)
        kept = np.setdiff1d(np.arange(len(found.mean)), gone)
        step, log = self._told(found.products.less(gone, sizes, found.mean[sizes]), kept)
        sides = one_sided(np.abs(found.sizes[out]), found.sds[out], bounds.one_way[sizes]).sum()
        prior = found.odds - odds_of(found.problem, [e for k, e in enumerate(found.effects) if k not in out])
        moved, free = found.z.copy(), kept[kept < len(found.z)]
        moved[free] += step * bounds.scale[free]
        rest, now = (
            tuple(e for k, e in enumerate(these) if k not in out) for these in (found.effects_at(moved), found.now)
        )
        return Less(log - self._log - float(sides) - prior, moved[: found.first], rest, now)

    def settled_less(self, start: Less, rival: float, far: bool = False) -> Settled:
        """It without some effects, brought to its fixed point; from where it stood if not from where it should go.

        Did it go there? If more is promised than the whole hypothesis promised already, it got lost on the way.

        Args:
            rival: evidence of the best hypothesis so far, nats.
            far: as of ``settled``.
        """
        found, s = self._found, self._found.learnt.s
        moved = settled(found.bare, start.own, start.effects, self._ground, s, far, rival)
        if moved.promised <= found.promised + SETTLED:
            return moved
        stayed = settled(found.bare, found.own, start.now, self._ground, s, far, rival)
        return max(moved, stayed, key=lambda h: h.log)

    def _told(self, products: Products, kept: np.ndarray) -> tuple[Array, float]:
        """The step of the unknowns that are kept, in prior sds, and the evidence there."""
        found, free = self._found, kept[kept < len(self._low)]
        said = posterior(products, found.mean[kept], self._ground, found.learnt.s, self._low[free], self._high[free])
        return said.step, said.log - 0.5 * products.over()[2]
