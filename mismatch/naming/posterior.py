"""What a linearised hypothesis says of its unknowns, within their bounds, and its evidence there."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.linalg import cho_factor, cho_solve
from scipy.special import erfcx

from twinbench.mismatch.naming.bounded import bounded
from twinbench.mismatch.naming.ground import Ground, Products
from twinbench.mismatch.naming.marginal import HAIR, Learnt, eliminated, learn
from twinbench.physics.simulator import Array

BOUND_TURNS = 4
"""Times at most that the discrepancy is learnt because other unknowns stand at their bounds; most hypotheses meet none
and take one. What more of them would change was not measured."""


class Posterior(NamedTuple):
    """Of the unknowns (K,) and what wanders (W,), around where a hypothesis stands.

    Attributes:
        log: evidence in nats, constants apart, within the bounds.
        learnt: the discrepancy beside them.
        cov: (K + W, K + W) their dimensionless covariance, in prior sds squared, bounds apart.
        step: (K,) to the likeliest within the bounds, dimensionless: in prior sds.
        promised: nats that the step gains.
        A: (K + W, K + W) dimensionless curvature in prior sds, the prior in it.
        slope: (K + W,) dimensionless, likewise.
        low: (K,) bounds of the unknowns, from there, dimensionless: in prior sds.
        high: (K,) dimensionless, likewise.
    """

    log: float
    learnt: Learnt
    cov: Array
    step: Array
    promised: float
    A: Array
    slope: Array
    low: Array
    high: Array

    def damped(self, damping: float) -> Array:
        """(K,) a shorter step, dimensionless: less in directions that the readings tell little of.

        Args:
            damping: by which share of itself the curvature of each unknown is larger (Levenberg and Marquardt).
        """
        A = self.A + damping * np.diag(np.diag(self.A))
        return bounded(A, self.slope, self.low, self.high)[0][: len(self.low)]


def posterior(products: Products, mean: Array, ground: Ground, s: Array, low: Array, high: Array) -> Posterior:
    """What the products say.

    Args:
        mean: (K + W,) of the prior, from where the hypothesis stands, dimensionless: in prior sds.
        s: (P,) discrepancy to begin with, per cent.
        low: (K,) bounds of the unknowns, from there, dimensionless: in prior sds.
        high: (K,) likewise.
    """
    G, b, _ = products.over()
    n, many = len(mean), len(b)
    held, x = np.zeros(many, dtype=bool), np.zeros(many)
    step, at_bound = np.zeros(n), np.zeros(n, dtype=bool)
    for _ in range(BOUND_TURNS):
        # What a bound holds stands there, and the discrepancy is learnt with it there.
        held[:n], x[:n] = at_bound, np.where(at_bound, step, 0.0)
        free, left = np.flatnonzero(~held[:n]), np.flatnonzero(~held)
        right = b - G @ x
        inner = eliminated(G[np.ix_(left, left)], right[left], np.arange(len(free)), mean[free], np.ones(len(free)))
        learnt = learn(inner.G, inner.b, ground.group, s)
        block = np.arange(n, many)
        outer = eliminated(G, b, block, np.zeros(len(block)), ground.precision(learnt.s))
        A, slope = outer.G + np.eye(n), outer.b + mean
        A[np.diag_indices(n)] *= 1.0 + HAIR
        step, at_bound = bounded(A, slope, low, high)
        if np.array_equal(at_bound, held[:n]):
            break
    cov = cho_solve(cho_factor(A), np.eye(n))
    # What wanders moves with no step: it is integrated out of what the step gains, as the discrepancy is.
    wander, k = slope[len(low) :], slice(len(low), n)
    idle = 0.5 * float(wander @ cho_solve(cho_factor(A[k, k]), wander)) if len(wander) else 0.0
    promised = float(slope @ step) - 0.5 * float(step @ A @ step) - idle
    stands, sd = x[held], np.sqrt(np.diag(cov)[held[:n]])
    log = inner.log + learnt.log + float(stands @ (b[held] - 0.5 * G[np.ix_(held, held)] @ stands))
    log -= 0.5 * float(np.sum((stands - mean[held[:n]]) ** 2))
    # At a bound only the flank exp(-t x - x^2/2) of what is likelier beyond it is left, in place of a whole Gaussian.
    flank = np.abs(slope - A @ step)[held[:n]] * sd
    log += float(np.log(sd * erfcx(flank / np.sqrt(2.0))).sum())
    return Posterior(log, learnt, cov, step[: len(low)], promised, A, slope, low, high)
