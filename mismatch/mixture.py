"""Sizes and parameters with what all hypotheses together say of them: a mixture of Gaussians, one each."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import brentq
from scipy.special import ndtr

from twinbench.mismatch.naming.settle import Settled
from twinbench.mismatch.naming.view import scale_of
from twinbench.physics.simulator import Array

Z90 = 1.645
"""Standard deviations to either side that hold 90 % of a Gaussian."""
INTERVAL = 0.9
"""Probability that every interval holds."""
NEGLIGIBLE = 12.0
"""Nats behind the likeliest from which a hypothesis adds nothing."""


@dataclass(frozen=True)
class Mixture:
    """A number under several hypotheses.

    Attributes:
        weights: (H,) dimensionless, they sum to one.
        means: (H,) of the number, in its unit.
        sds: (H,) its standard deviations, in its unit.
    """

    weights: Array
    means: Array
    sds: Array

    @classmethod
    def of(cls, hypotheses: Sequence[Settled], numbers: Sequence[tuple[float, float]]) -> Mixture:
        """From the mean and the standard deviation of the number under each hypothesis."""
        means, sds = np.array(numbers).T
        return cls(weights(hypotheses), means, np.maximum(sds, 1e-300))

    def interval(self, low: float = -np.inf, high: float = np.inf) -> tuple[float, float]:
        """The middle 90 %, within what the number can be."""
        tail = (1.0 - INTERVAL) / 2.0
        ends = (self._quantile(tail), self._quantile(1.0 - tail))
        return max(ends[0], low), min(ends[1], high)

    def _quantile(self, p: float) -> float:
        reach = 8.0 * self.sds + np.spacing(np.abs(self.means))  # so that what is certain has two sides too
        low, high = float((self.means - reach).min()), float((self.means + reach).max())
        return float(brentq(lambda v: float(self.weights @ ndtr((v - self.means) / self.sds)) - p, low, high))


def weights(hypotheses: Sequence[Settled]) -> Array:
    """(H,) probabilities of hypotheses, were there no others."""
    logs = np.array([h.log for h in hypotheses])
    raw = np.exp(logs - logs.max())
    return np.asarray(raw / raw.sum())


def near(hypotheses: Sequence[Settled]) -> list[Settled]:
    """Those that are not far behind the likeliest of them."""
    best = max(h.log for h in hypotheses)
    return [h for h in hypotheses if h.log > best - NEGLIGIBLE]


def covariance(hypothesis: Settled) -> Array:
    """(K, K) posterior covariance of a hypothesis' unknowns, each in its own unit."""
    scale = np.array([scale_of(u) for u in hypothesis.problem.unknowns])
    return np.asarray(hypothesis.cov * np.outer(scale, scale))
