"""Sizes and parameters with what all hypotheses together say of them: a mixture of Gaussians, one each."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import numpy as np
from scipy.optimize import brentq
from scipy.special import ndtr

from twinbench.mismatch.naming.answer import shares
from twinbench.mismatch.naming.name import NEAR
from twinbench.mismatch.naming.settle import Settled
from twinbench.mismatch.variants import is_amplitude, per_size
from twinbench.physics.simulator import Array

Z90 = 1.645
"""Standard deviations to either side that hold 90 % of a Gaussian."""
INTERVAL = 0.9
"""Probability that every interval holds."""


class Likely(Protocol):
    """Whatever has an evidence."""

    @property
    def log(self) -> float:
        """In nats."""


def interval_of(
    hypotheses: Sequence[Likely], numbers: Sequence[tuple[float, float]], low: float = -np.inf, high: float = np.inf
) -> tuple[float, float]:
    """The middle 90 % of a number under several hypotheses, within what it can be.

    Args:
        numbers: its mean and its standard deviation under each.
    """
    means, sds = np.array(numbers).T
    weights, sds, tail = np.array(shares([h.log for h in hypotheses])), np.maximum(sds, 1e-300), (1.0 - INTERVAL) / 2.0
    ends = (_quantile(tail, weights, means, sds), _quantile(1.0 - tail, weights, means, sds))
    return max(ends[0], low), min(ends[1], high)


def _quantile(p: float, weights: Array, means: Array, sds: Array) -> float:
    reach = 8.0 * sds + np.spacing(np.abs(means))  # so that what is certain has two sides too
    low, high = float((means - reach).min()), float((means + reach).max())
    return float(brentq(lambda v: float(weights @ ndtr((v - means) / sds)) - p, low, high))


def near(hypotheses: Sequence[Settled]) -> list[Settled]:
    """Those that are not so far behind the likeliest of them that they add nothing."""
    best = max(h.log for h in hypotheses)
    return [h for h in hypotheses if h.log > best - NEAR]


def having(hypotheses: Sequence[Settled], candidate: int) -> list[Settled]:
    """Those near ones that have the effect of a candidate."""
    return near([h for h in hypotheses if candidate in h.candidates])


def numbers_of(hypothesis: Settled, place: int) -> list[tuple[float, float]]:
    """Mean and standard deviation of each parameter of an effect, as a hypothesis has them.

    Args:
        place: of the effect in the hypothesis.
    """
    candidate = hypothesis.problem.machine.candidates[hypothesis.candidates[place]]
    at, n = hypothesis.entries(place)[0], len(candidate.at)
    if not is_amplitude(candidate):
        return [
            (float(hypothesis.at[k]), float(np.sqrt(hypothesis.cov[k, k])) * hypothesis.problem.unknowns[k].spread)
            for k in range(at, at + n)
        ]
    size, sd = float(hypothesis.at[at] - candidate.null[0]), float(hypothesis.sds[place])
    moves = per_size(candidate)
    return [(float(a + size * s), abs(float(sd * s))) for a, s in zip(candidate.null, moves, strict=True)]
