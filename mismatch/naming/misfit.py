"""How well a hypothesis fits where a step would take it, with all that no step moves integrated out."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from twinbench.mismatch.fit import Problem
from twinbench.mismatch.naming.ground import Ground, Products
from twinbench.mismatch.naming.marginal import UNTOLD
from twinbench.mismatch.naming.view import WANDERS
from twinbench.physics.simulator import Array


class Wandering(NamedTuple):
    """Columns of what differs from place to place, in its prior sds.

    Attributes:
        white: (B * ny, W) per recording, whitened.
        own: (W, W) dimensionless products of these with each other.
        cross: (W, F) dimensionless products with the discrepancy's.
    """

    white: Sequence[Array]
    own: Array
    cross: Array

    @classmethod
    def of(cls, products: Products, white: Sequence[Array], share: float) -> Wandering:
        """The last columns of products that were made smaller to a share, from those that were not.

        Args:
            white: (B * ny, W) per recording, whitened, by WANDERS.
        """
        k = slice(products.own.shape[1] - 1 - white[0].shape[1], -1)
        return cls(
            [w * (share / WANDERS) for w in white], products.own[:, k, k].sum(axis=0), products.cross[:, k].sum(axis=0)
        )


def misfit(
    problem: Problem, ground: Ground, s: Array, wandering: Wandering | None = None
) -> Callable[[Array, Problem], float]:
    """Twice minus the log posterior of unknowns (K,), the discrepancy of a size integrated out, constants apart.

    It is asked with the unknowns and with the problem, which may differ from the one given in when effects begin.

    Args:
        s: (P,) size of the discrepancy at each port, per cent.
        wandering: what else is integrated out.
    """
    square, spreads = squared(ground, s, wandering), problem.spreads

    def of(z: Array, problem: Problem) -> float:
        residuals = problem.residuals(z)
        if diverged(problem, residuals):
            return np.inf
        return float(np.sum(((z - problem.z0) / spreads) ** 2)) + square(residuals)

    return of


def diverged(problem: Problem, residuals: Sequence[Array]) -> bool:
    """Does a run break off before the readings do?

    Args:
        residuals: (B, ny) per recording, in the outputs' units.
    """
    return any(np.isnan(r[np.isfinite(t.means)]).any() for r, t in zip(residuals, problem.tracks, strict=True))


def squared(ground: Ground, s: Array, wandering: Wandering | None = None) -> Callable[[Sequence[Array]], float]:
    """Squares of what readings differ by, (B, ny) per recording, in sds of the noise; the discrepancy integrated out.

    Args:
        s: (P,) size of the discrepancy at each port, per cent.
        wandering: what else is integrated out.
    """
    d = 1.0 / np.sqrt(ground.precision(s))
    FF, white = ground.FF.sum(axis=0), list(ground.white)
    if wandering is not None:
        d = np.concatenate((np.ones(len(wandering.own)), d))
        FF = np.block([[wandering.own, wandering.cross], [wandering.cross.T, FF]])
        white = [np.concatenate(pair, axis=1) for pair in zip(wandering.white, white, strict=True)]
    some = np.flatnonzero(d**2 * np.diag(FF) > UNTOLD)
    d, shown = d[some], [w[:, some] for w in white]
    factor = cho_factor(np.eye(len(some)) + d[:, None] * FF[np.ix_(some, some)] * d) if len(some) else None

    def of(differences: Sequence[Array]) -> float:
        total, right = 0.0, np.zeros(len(some))
        for r, difference in enumerate(differences):
            left = ground.whitened(r, np.empty((*difference.shape, 0)), difference)[:, 0]
            total += float(left @ left)
            right += shown[r].T @ left
        return total - (float((d * right) @ cho_solve(factor, d * right)) if factor is not None else 0.0)

    return of
