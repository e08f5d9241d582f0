"""All physics at once, then fewer: where many effects act, one at a time finds what covers several of them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.special import log_ndtr

from twinbench.mismatch.fit import Problem
from twinbench.mismatch.naming.ground import Ground
from twinbench.mismatch.naming.picture import one_way
from twinbench.mismatch.naming.settle import Effect, Settled, settled
from twinbench.physics.simulator import Array


def all_at_once(problem: Problem, z: Array, effects: Sequence[Effect], ground: Ground) -> Settled:
    """Those of many effects that are likely together, brought to their fixed point.

    They are thinned out without a discrepancy, which would take what they have not explained yet, and again with it.

    Args:
        problem: with no effect in it.
        z: (K,) where the problem's unknowns stand, each in its own unit.
        effects: each but slightly present.
    """
    exact = ground.exact
    few = thinned(settled(problem, z, effects, exact, exact.s), exact)
    return thinned(settled(few.bare, few.own, few.now, ground, ground.s), ground)


def thinned(found: Settled, ground: Ground) -> Settled:
    """Leave out half of the effects that seem needless, or fewer of them, as long as the evidence rises."""
    needed: set[int] = set()
    while True:
        odds = odds_without(found)
        out = [k for k in np.argsort(-odds) if odds[k] > 0.0 and found.effects[k].variant.candidate not in needed]
        out = out[: (len(out) + 1) // 2]
        if not out:
            return found
        while out:
            rest = [e for k, e in enumerate(found.now) if k not in out]
            fewer = settled(found.bare, found.own, rest, ground, found.learnt.s, rival=found.log)
            if fewer.log > found.log:
                found = fewer
                break
            if len(out) == 1:
                needed.add(found.effects[out[0]].variant.candidate)
            out = out[: len(out) // 2]


def odds_without(found: Settled) -> Array:
    """(E,) log odds, dimensionless, of each effect's absence against its presence, all others present.

    It is the density of nothing in the posterior over that in the prior. Reference: Dickey, The weighted likelihood
    ratio, linear hypotheses on normal location parameters, Ann. Math. Statist. 42 (1971).
    """
    candidates = [found.problem.machine.candidates[e.variant.candidate] for e in found.effects]
    sides = np.array([one_way(c) for c in candidates], dtype=bool)
    sd, prior = np.array([e.sd for e in found.effects]), np.array([e.prior for e in found.effects])
    ratio = found.sizes / found.sds
    away = np.where(sides, np.log(2.0) + log_ndtr(np.abs(ratio)), 0.0)
    return np.asarray(np.log(sd / found.sds) - 0.5 * ratio**2 - away - prior)
