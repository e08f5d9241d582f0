"""Fit by forward runs: Gauss-Newton within bounds and priors, whitened residuals, all recordings at once."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from twinbench.mismatch.fit import Problem
from twinbench.physics.simulator import Array

ENOUGH = 0.05
"""A fit is done when a step gains less than this, in units of twice the log-likelihood."""
NEARLY = 0.01
"""Share of the cost that a round of a fit which need only be near must gain to be followed by another."""
HOP = 0.05
"""How far (sd) from where a fit began or ended another begins, as a share of each unknown's scale. On the Cascaded
Tanks twice as much does as well."""
LEAST_DAMPING, FIRST_DAMPING, MOST_DAMPING = 1e-6, 1e-4, 100.0
"""Damping of a step: none to speak of, what is tried first where that is not enough, and the most."""
TRIES, GOOD_STEP = 6, 0.25
"""How often damping is raised tenfold, and the share of the promised fall in cost at which a step is good enough."""


class _Limits(NamedTuple):
    """Bounds of the unknowns and their typical sizes of change, (K,) each, in their units."""

    low: Array
    high: Array
    scale: Array


class _At(NamedTuple):
    """Where a fit is: the unknowns (K,), their cost, and the damping of the next step."""

    z: Array
    cost: float
    damping: float


def solve(
    problem: Problem,
    z: Array,
    rounds: int = 8,
    chords: int = 2,
    share: float = 0.0,
    advance: Callable[[float], None] = lambda share: None,
) -> tuple[Array, float]:
    """Damped Gauss-Newton; each Jacobian serves a few steps.

    Args:
        z: (K,) where the unknowns begin, each in its own unit.
        rounds: Jacobians at most.
        chords: steps that each serves besides the first.
        share: a round that gains less than this of the cost is the last, for a fit that need only be near.
        advance: told the share of the rounds that is done, round by round.

    Returns:
        The unknowns (K,) and their cost.
    """
    limits = _Limits(*(np.array([getattr(u, side) for u in problem.unknowns]) for side in _Limits._fields))
    z = np.clip(z, limits.low, limits.high)
    cost = problem.cost(z)
    damping = LEAST_DAMPING
    for k in range(rounds):
        advance(k / rounds)
        G, whitened = problem.normal(z)
        before = cost
        for _ in range(chords + 1):
            last, b = cost, problem.right_side(z, whitened)
            z, cost, damping = _step(problem, _At(z, cost, damping), G, b, limits)
            if last - cost < ENOUGH:
                break
        if before - cost < max(ENOUGH, share * before):
            break
    advance(1.0)
    return z, cost


def _step(problem: Problem, at: _At, G: Array, b: Array, limits: _Limits) -> _At:
    """One step within the bounds, damped until the cost falls as it should (Levenberg and Marquardt).

    Args:
        G, b: normal matrix (K, K) and right-hand side (K,).

    Returns:
        Where it ends, which is where it began if nothing helped.
    """
    (z, cost, damping), (low, high, scale) = at, limits
    free = ~(((z <= low) & (b < 0)) | ((z >= high) & (b > 0)))
    if not free.any():
        return at
    A = G[np.ix_(free, free)]
    damps = np.diag(np.maximum(np.diag(A), 1e-12 / scale[free] ** 2))
    best, lowest, mild = z, cost, damping
    for _ in range(TRIES):
        step = np.zeros_like(z)
        try:
            step[free] = np.linalg.solve(A + damping * damps, b[free])
        except np.linalg.LinAlgError:
            step[free] = np.linalg.lstsq(A + damping * damps, b[free], rcond=None)[0]
        candidate = np.clip(z + step, low, high)
        step = candidate - z
        found = problem.cost(candidate)
        agrees = (cost - found) / max(float(2.0 * b @ step - step @ G @ step), 1e-12)
        if agrees > GOOD_STEP:
            return _At(candidate, found, max(damping / 10.0, LEAST_DAMPING) if agrees > 1.0 - GOOD_STEP else damping)
        if found < lowest - 1e-9:
            best, lowest, mild = candidate, found, damping
        elif lowest < cost:
            break
        damping = min(10.0 * max(damping, FIRST_DAMPING), MOST_DAMPING)
    return _At(best, lowest, mild if lowest < cost else damping)
