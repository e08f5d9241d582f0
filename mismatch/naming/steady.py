"""Is an effect the same everywhere? What stands in for physics that the catalogue lacks fits here more, there less."""

from __future__ import annotations

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from twinbench.mismatch.naming.ground import Ground
from twinbench.mismatch.naming.marginal import eliminated, factored
from twinbench.mismatch.naming.settle import Settled
from twinbench.physics.simulator import Array

UNSTEADY = 0.3
"""By which share of itself the size of a stand-in differs (sd), from recording to recording and from place to place."""


def one_size(chosen: Settled, i: int, ground: Ground) -> float:
    """Nats for one size of an effect in all recordings, against a size of its own in each."""
    own, cross, _ = chosen.products
    k = chosen.entries(i)[0]
    share = UNSTEADY * abs(chosen.mean[k])  # in prior sds, of which the column is one
    G, b, _ = chosen.products.over()
    rows = share * np.concatenate((own[:, k, :-1], cross[:, k]), axis=1)
    whole = np.block([[G, rows.T], [rows, np.diag(share**2 * own[:, k, k])]])
    right = np.concatenate((b, share * own[:, k, -1]))
    left = eliminated(whole, right, np.arange(len(b)), *chosen.prior(ground))
    return -_log(left.G, left.b, 1.0)


def one_form(chosen: Settled, i: int, ground: Ground) -> float:
    """Nats for a form that is nearly exact, against one that is off by far more; 0 for a fault, which has no form."""
    at = chosen.wandering(i)
    if not len(at):
        return 0.0
    G, b, _ = chosen.products.over()
    mean, precision = chosen.prior(ground)
    rest = np.setdiff1d(np.arange(len(b)), at)
    left = eliminated(G, b, rest, mean[rest], precision[rest])
    return _log(left.G, left.b, 1.0) - _log(left.G, left.b, (chosen.share / UNSTEADY) ** 2)


def squares_beside(chosen: Settled, ground: Ground) -> tuple[float, list[float]]:
    """Squares, in variances of the noise, that the readings owe to what no form holds, at its posterior mean.

    First those of the discrepancy beside the effects, then for each effect those of what its size differs by from
    place to place. What has the right form needs little of either.
    """
    G, b, _ = chosen.products.over()
    mean, precision = chosen.prior(ground)
    scale, L = factored(G + np.diag(precision))
    likeliest = scale * cho_solve((L, True), scale * (b + precision * mean))

    def of(at: np.ndarray) -> float:
        return float(likeliest[at] @ G[np.ix_(at, at)] @ likeliest[at])

    beside = np.arange(len(chosen.mean), len(b))
    return of(beside), [of(chosen.wandering(i)) for i in range(len(chosen.effects))]


def _log(G: Array, b: Array, precision: float) -> float:
    """Evidence of columns with a prior around nothing, against their absence, nats."""
    A, _ = factor = cho_factor(G + precision * np.eye(len(b)), lower=True)
    return float(0.5 * b @ cho_solve(factor, b) - np.log(np.diag(A)).sum() + 0.5 * len(b) * np.log(precision))
