"""Evidence of linear Gaussian models: what is unknown is integrated out, the discrepancy's size is learnt."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.linalg import cho_solve, cholesky, solve_triangular
from scipy.linalg.lapack import dpotrf, dtrtri
from scipy.special import log_ndtr

from twinbench.physics.simulator import Array

DISCREPANCY_PCT = 0.7
"""Prior sd of the discrepancy, in per cent of what commonly acts at its port."""
LEARNT = 0.1
"""Nats that a round of learning must gain to be followed by another, and by which two ends differ that are one."""
LEARNING_ROUNDS = 15
UNTOLD = 1e-3
"""Information (prior variance over noise variance) below which a function is left out: half of it in nats is lost."""
LEAST_PCT, LEAST_TRIED_PCT = 1e-4, 1e-3
"""Size of a discrepancy that is none, per cent: a size of nothing could not be divided by. Where effects are tried
beside one, it is never smaller than the other."""
HAIR = 1e-10
"""Share of its diagonal that is added to a matrix before it is factored. Evidence changes by less than that in nats."""


class Reduced(NamedTuple):
    """A quadratic form with a block of it integrated out.

    ``log p = -(q - ...)/2``, over the K unknowns that are left.

    Attributes:
        G: (K, K) products of their whitened columns.
        b: (K,) products of these with the whitened residuals.
        log: what the block contributed, nats.
    """

    G: Array
    b: Array
    log: float


def eliminated(G: Array, b: Array, block: np.ndarray, mean: Array, precision: Array) -> Reduced:
    """Integrate out some unknowns with a Gaussian prior.

    Args:
        G: (K, K) products of whitened columns.
        b: (K,) products of these with whitened residuals.
        block: (k,) positions of the unknowns.
        mean: (k,) of their prior, in the units that the columns are per.
        precision: (k,) of their prior, in these units to the power -2.
    """
    rest = np.setdiff1d(np.arange(len(b)), block)
    A = G[np.ix_(block, block)] + np.diag(precision)
    scale, L = factored(A)
    factor = L, True
    right = b[block] + precision * mean
    cross = G[np.ix_(block, rest)]
    solved = scale[:, None] * cho_solve(factor, scale[:, None] * np.column_stack((cross, right)))
    log = 0.5 * float(right @ solved[:, -1]) - 0.5 * float(mean @ (precision * mean))
    log -= float(np.log(np.diag(L) / scale).sum()) - 0.5 * float(np.log(precision).sum())
    left = G[np.ix_(rest, rest)] - cross.T @ solved[:, :-1]
    return Reduced(0.5 * (left + left.T), b[rest] - cross.T @ solved[:, -1], log)


def factored(A: Array) -> tuple[Array, Array]:
    """Scales (U,), dimensionless, that make the diagonal of A one, and the Cholesky factor (U, U) of A so scaled.

    Args:
        A: (U, U) dimensionless, positive definite.
    """
    scale = 1.0 / np.sqrt(np.diag(A))
    return scale, np.asarray(cholesky(A * np.outer(scale, scale) + HAIR * np.eye(len(A)), lower=True))


class Learnt(NamedTuple):
    """Evidence with the discrepancy integrated out.

    Attributes:
        log: of the evidence, constants apart, in nats; the prior of the sizes is in it.
        s: (P,) size of the discrepancy at each port, per cent.
        weights: (F,) posterior mean of its functions' weights, per cent.
    """

    log: float
    s: Array
    weights: Array


def learn(G: Array, b: Array, group: np.ndarray, s: Array, free: int = -1, rounds: int = LEARNING_ROUNDS) -> Learnt:
    """The discrepancy's size at each port by the highest evidence (MacKay's fixed point under a half-normal prior).

    Args:
        G: (F, F) products of the functions' whitened columns, all else integrated out.
        b: (F,) likewise with residuals.
        group: (F,) positions of each function's port.
        s: (P,) sizes to begin from, per cent.
        free: a port whose size has no prior, or -1.
    """
    s2, last, log = np.maximum(s, LEAST_PCT) ** 2, -np.inf, 0.0
    mean, telling, some, G_some = np.zeros(len(b)), np.diag(G), np.arange(len(b)), G
    for _ in range(rounds):
        mean = np.zeros(len(b))
        saying = np.flatnonzero(s2[group] * telling > UNTOLD)  # the others say nothing at this size
        if not len(saying):
            return Learnt(_prior(s2, free), np.sqrt(s2), mean)
        if not np.array_equal(saying, some):
            some, G_some = saying, G[np.ix_(saying, saying)]
        d = np.sqrt(s2[group[some]])
        M = d[:, None] * G_some
        M *= d
        M.flat[:: len(some) + 1] += 1.0
        L, _ = dpotrf(M.T, lower=1, overwrite_a=1)  # in place: the transpose lies as LAPACK wants it
        v = solve_triangular(L, d * b[some], lower=True, check_finite=False)
        mean[some] = d * solve_triangular(L, v, lower=True, trans=1, check_finite=False)
        log = 0.5 * float(v @ v) - float(np.log(np.diag(L)).sum()) + _prior(s2, free)
        if log - last < LEARNT:
            break
        last = log
        inverse, _ = dtrtri(L, lower=1, overwrite_c=1)
        known = 1.0 - np.einsum("ij,ij->j", inverse, inverse)  # less the posterior's share of the prior variance
        many = np.maximum(np.bincount(group[some], known, len(s2)), 1e-3)
        squares = np.bincount(group[some], mean[some] ** 2, len(s2)) + 1e-12
        bent = 4.0 * squares / (DISCREPANCY_PCT**2 * many**2)
        bounded = 2.0 * squares / many / (1.0 + np.sqrt(1.0 + bent))
        if free >= 0:
            bounded[free] = max(squares[free] / many[free], 1.0)
        s2 = np.clip(bounded, LEAST_PCT**2, 1e8)
    return Learnt(log, np.sqrt(s2), mean)


def _prior(s2: Array, free: int) -> float:
    each = -0.5 * s2 / DISCREPANCY_PCT**2
    if free >= 0:
        each[free] = 0.0
    return float(each.sum())


def one_sided(mean: Array, sd: Array, bounded: np.ndarray) -> Array:
    """What a half-normal prior adds to a normal one's log evidence, (..., K).

    Args:
        mean: (..., K) of the posterior, each in its own unit.
        sd: (..., K) likewise.
        bounded: (K,) bool, is the prior half-normal?
    """
    return np.asarray(np.where(bounded, np.log(2.0) + log_ndtr(mean / np.maximum(sd, 1e-300)), 0.0))
