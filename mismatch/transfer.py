"""Do sizes learnt on the fitted recordings hold on those held back? If not, something else is missing too."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy.linalg import cholesky, solve_triangular
from scipy.stats import chi2

from mismatch.explanation import Explanation
from mismatch.fit import Problem, Unknown
from mismatch.proof import Held
from mismatch.tracks import Track
from physics.simulator import Array

FORM = 3.0
"""Times that the chi-square may exceed what chance makes in one of a hundred: no drift's form is exact."""
TOLD = 0.05
"""Information of the held-out recordings about a size, in what the fitted ones have, from which on it is compared."""


class Transfer(NamedTuple):
    """How far the sizes that held-out recordings want lie from those learnt: chi-square, and of how many of them."""

    chi2: float
    sizes: int

    @property
    def fails(self) -> bool:
        """Is that more than chance makes, and more than a drift's form can lack?"""
        return self.chi2 > FORM * float(chi2.isf(0.01, max(self.sizes, 1)))


def transfer(best: Explanation, held: Held, tracks: Sequence[Track], own: Sequence[Unknown]) -> Transfer:
    """Consistency of everything shared between recordings, own unknowns of each recording taken out.

    Args:
        held: errors of ``best`` on the held-out recordings ``tracks``, whose own unknowns are ``own``.
    """
    problem, z = best.problem, best.z
    shared = np.array([u.recording == -1 for u in problem.unknowns])
    common = tuple(u for u in problem.unknowns if u.recording == -1)
    scale = np.array([u.scale for u in common])
    G, _, _ = problem.normal(z, problem.residuals(z))
    learnt = _without(G, shared) * np.outer(scale, scale)
    wanted, pull, squares = np.zeros_like(learnt), np.zeros(len(common)), []
    for r, track in enumerate(tracks):
        mine = tuple(replace(u, recording=0) for u in own if u.recording == r)
        alone = Problem(problem.machine, [track], (*common, *mine), problem.whitener, theta=problem.theta)
        at = np.concatenate((z[shared], held.own[r]))
        (columns,) = alone.columns(at, alone.residuals(at), range(len(common)))
        J = alone.whitener(np.concatenate((columns * scale, held.columns[r]), axis=-1))
        e = alone.whitener(held.residuals[r])
        seen = np.isfinite(e) & np.isfinite(J).all(axis=-1)
        J, e = J[seen], e[seen]
        precision = np.array([u.sd**-2 for u in mine])
        whole = J.T @ J + np.diag([*np.zeros(len(common)), *precision])
        b = J.T @ e
        b[len(common) :] += precision * (np.array([u.mean for u in mine]) - held.own[r])
        first = np.arange(len(whole)) < len(common)
        wanted += _without(whole, first)
        pull += b[first] - whole[np.ix_(first, ~first)] @ np.linalg.solve(whole[np.ix_(~first, ~first)], b[~first])
        squares.append(e**2)
    noise = max(1.0, float(np.mean(np.concatenate(squares))))
    # In the frame where the learnt sizes are independent and of unit variance.
    frame = cholesky(learnt, lower=True)
    half = solve_triangular(frame, wanted, lower=True)
    information, axes = np.linalg.eigh(solve_triangular(frame, half.T, lower=True))
    along = axes.T @ solve_triangular(frame, pull, lower=True)
    told = information > TOLD
    return Transfer(
        float(np.sum(along[told] ** 2 / (information[told] * (1.0 + information[told])))) / noise, int(told.sum())
    )


def _without(G: Array, kept: np.ndarray) -> Array:
    """A normal matrix of the kept unknowns, the others eliminated."""
    rest = ~kept
    return G[np.ix_(kept, kept)] - G[np.ix_(kept, rest)] @ np.linalg.solve(G[np.ix_(rest, rest)], G[np.ix_(rest, kept)])
