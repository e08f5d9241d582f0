"""Bounds of unknowns, and where a step of many goes if some of them may not go on."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from twinbench.mismatch.fit import Problem
from twinbench.physics.simulator import Array


@dataclass(frozen=True)
class Bounds:
    """Of unknowns.

    Attributes:
        low: (K,) each in its own unit.
        high: (K,) likewise.
        scale: (K,) prior standard deviations, in the same units.
        one_way: (K,) bool, is the prior's mean a bound?
    """

    low: Array
    high: Array
    scale: Array
    one_way: np.ndarray

    @classmethod
    def of(cls, problem: Problem) -> Bounds:
        u = problem.unknowns
        one_way = np.array([v.mean in (v.low, v.high) for v in u], dtype=bool)
        return cls(np.array([v.low for v in u]), np.array([v.high for v in u]), problem.spreads, one_way)

    def around(self, z: Array) -> tuple[Array, Array]:
        """The lower and the upper ones (K,) from somewhere, dimensionless: in prior sds.

        Args:
            z: (K,) from where, each in its own unit.
        """
        return (self.low - z) / self.scale, (self.high - z) / self.scale


def bounded(A: Array, slope: Array, low: Array, high: Array) -> tuple[Array, np.ndarray]:
    """The x (N,) that makes ``slope x - x A x / 2`` largest, the first K within bounds; and which of those are at one.

    Bounds are taken in and let go until none is crossed and none holds back what wants to go inside.

    Args:
        A: (N, N) dimensionless, positive definite.
        slope: (N,) dimensionless, at nothing.
        low: (K,) dimensionless bounds, none above nothing.
        high: (K,) likewise, none below it.

    Returns:
        x, and (K,) bool positions padded to (N,).
    """
    rest = len(slope) - len(low)
    low, high = (np.concatenate((side, np.full(rest, end))) for side, end in ((low, -np.inf), (high, np.inf)))
    held, x = np.zeros(len(slope), dtype=bool), np.zeros(len(slope))
    for _ in range(2 * len(slope)):
        free = ~held
        x[free] = cho_solve(cho_factor(A[np.ix_(free, free)]), slope[free] - A[np.ix_(free, held)] @ x[held])
        out = free & ((x < low) | (x > high))
        if out.any():
            x, held = np.clip(x, low, high), held | out
            continue
        inwards = np.where(x <= low, 1.0, -1.0) * (slope - A @ x) * held
        if inwards.max(initial=0.0) <= 0.0:
            break
        held[int(np.argmax(inwards))] = False
    return np.clip(x, low, high), held
