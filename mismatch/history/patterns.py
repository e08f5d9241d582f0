"""Courses that a size may take, and the evidence of each: Gaussian, and closed, as all that the engine weighs."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.linalg import cho_solve, cholesky

from twinbench.mismatch.history.axis import KNOTS, Axis
from twinbench.physics.simulator import Array

CONSTANT, RAMP, STEP, WALK = "constant", "ramp", "step", "walk"
PATTERNS = (CONSTANT, RAMP, STEP, WALK)
STAYS = 0.5
"""Prior probability that a size is constant; the other courses share the rest evenly."""
CHANGES = 1.0
"""Prior sd of how much a ramp or a step changes a size in all, as a share of it."""
WALKS = (0.1, 0.2, 0.4, 0.8, 1.6)
"""Shares of a size by which it wanders from the first recording's beginning to the last one's end (sd): as likely."""


class Told(NamedTuple):
    """What the readings tell of a size over time, all else integrated out.

    Sizes are in prior standard deviations, the constant part from where it was linearised.

    Attributes:
        G: (1 + Q, 1 + Q) products of whitened columns: of the constant part, then of what is added at each knot.
        b: (1 + Q,) of these with the whitened residuals.
        log: nats that all else contributes.
        mean: of the constant part's prior.
    """

    G: Array
    b: Array
    log: float
    mean: float


class Pattern(NamedTuple):
    """A course that a size may take.

    Attributes:
        kind: one of ``PATTERNS``.
        prior: its probability before any reading.
        basis: (Q, k) dimensionless: what is added at each knot, in prior sds, per sd of k independent numbers.
        since_s: when a ramp begins or a step is done, on the axis; NaN of what has no such time.
        within_s: the times that it stands for.
    """

    kind: str
    prior: float
    basis: Array
    since_s: float = np.nan
    within_s: tuple[float, float] = (np.nan, np.nan)


class Weighed(NamedTuple):
    """A pattern after the readings.

    Attributes:
        log: its evidence and prior, nats.
        mean: (Q,) of the size at each knot from where it was linearised, dimensionless: in prior sds.
        sd: (Q,) of the same, dimensionless: in prior sds.
        added: (k,) posterior means of the pattern's own numbers, dimensionless: in their sds.
        added_sd: (k,) their posterior sds, likewise dimensionless.
    """

    pattern: Pattern
    log: float
    mean: Array
    sd: Array
    added: Array
    added_sd: Array


def patterns(axis: Axis, size: float) -> list[Pattern]:
    """All courses that are weighed.

    Args:
        size: how large the effect is, in prior sds.
    """
    order, along = axis.order, axis.along_s
    first, last = float(along.min()), float(along.max())
    share, amount = (1.0 - STAYS) / (len(PATTERNS) - 1), CHANGES * abs(size)
    found = [Pattern(CONSTANT, STAYS, np.zeros((len(along), 0)))]
    edges = np.linspace(first, last, KNOTS + 1)
    half = 0.5 * (edges[1] - edges[0])
    for t in edges[:-1]:  # also where nothing was recorded
        rise = np.maximum(along - t, 0.0) / (last - t)
        within = max(float(t) - half, first), float(t) + half
        found.append(Pattern(RAMP, share / KNOTS, amount * rise[:, None], float(t), within))
    for k in range(1, len(order)):
        before, after = float(along[order[k - 1]]), float(along[order[k]])
        leap = np.zeros(len(along))
        leap[order[k:]] = amount
        found.append(Pattern(STEP, share / (len(order) - 1), leap[:, None], after, (before, after)))
    walked = [walk(axis, part * abs(size)) for part in WALKS]
    if len(axis.names) > 1 and not axis.clock:
        walked += [from_one_to_the_next(axis, part * abs(size)) for part in WALKS]
    return [*found, *(Pattern(WALK, share / len(walked), basis) for basis in walked)]


def walk(axis: Axis, amount: float) -> Array:
    """(Q, Q - 1) basis of a random walk along the axis.

    Args:
        amount: sd of what it adds from the first knot to the last, in prior sds.
    """
    order = axis.order
    steps = np.sqrt(np.diff(axis.along_s[order]) / axis.span_s)
    found = np.zeros((len(order), len(order) - 1))
    found[order[1:]] = amount * np.tril(np.tile(steps, (len(steps), 1)))
    return found


def from_one_to_the_next(axis: Axis, amount: float) -> Array:
    """(Q, R - 1) basis of a random walk from recording to recording, where nothing says how far apart they are.

    Args:
        amount: sd of what it adds from the first recording to the last, in prior sds.
    """
    many = len(axis.names) - 1
    return np.asarray(amount / np.sqrt(many) * (axis.of[:, None] > np.arange(many)))


def weigh(told: Sequence[Told], pattern: Pattern) -> Weighed:
    """The evidence of a pattern beside whichever of several discrepancies suits it best.

    Args:
        told: with each discrepancy.
    """
    return max((_weigh(one, pattern) for one in told), key=lambda w: w.log)


def _weigh(told: Told, pattern: Pattern) -> Weighed:
    k = pattern.basis.shape[1]
    turn = np.zeros((len(told.b), 1 + k))
    turn[0, 0], turn[1:, 1:] = 1.0, pattern.basis
    L = cholesky(turn.T @ told.G @ turn + np.eye(1 + k), lower=True)
    right = turn.T @ told.b
    right[0] += told.mean
    found = cho_solve((L, True), right)
    log = told.log + 0.5 * float(right @ found) - 0.5 * told.mean**2 - float(np.log(np.diag(L)).sum())
    cov, shown = cho_solve((L, True), np.eye(1 + k)), np.column_stack((np.ones(len(pattern.basis)), pattern.basis))
    sd = np.sqrt(np.einsum("qi,ij,qj->q", shown, cov, shown))
    own = np.sqrt(np.diag(cov)[1:])
    return Weighed(pattern, log + float(np.log(pattern.prior)), shown @ found, sd, found[1:], own)
