"""Do sizes learnt on the fitted recordings hold on those held back? If not, something else is missing too."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy.linalg import cholesky, solve_triangular
from scipy.stats import chi2

from twinbench.mismatch.explanation import Explanation
from twinbench.mismatch.fit import Problem, Unknown
from twinbench.mismatch.proof import Held
from twinbench.mismatch.tracks import Track

FORM_EXCESS = 2.0
"""Times that the chi-square may exceed what chance makes in one of a hundred: no drift's form is exact."""
TOLD_INFORMATION = 0.05
"""Information of the held-out recordings about a size, in what the fitted ones have, from which on it is compared."""


class Transfer(NamedTuple):
    """How far the sizes that held-out recordings want lie from those learnt: chi-square, and of how many of them."""

    chi2: float
    sizes: int

    @property
    def fails(self) -> bool:
        """Is that more than chance makes, and more than a drift's form can lack?"""
        return self.chi2 > FORM_EXCESS * float(chi2.isf(0.01, max(self.sizes, 1)))


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
    rest = ~shared
    absorbed = G[np.ix_(shared, rest)] @ np.linalg.solve(G[np.ix_(rest, rest)], G[np.ix_(rest, shared)])
    learnt = (G[np.ix_(shared, shared)] - absorbed) * np.outer(scale, scale)
    wanted, pull, squares = np.zeros_like(learnt), np.zeros(len(common)), []
    for r, track in enumerate(tracks):
        mine = tuple(replace(u, recording=0) for u in own if u.recording == r)
        whole = Problem(problem.machine, [track], (*common, *mine), problem.whitener, theta=problem.theta)
        at = np.concatenate((z[shared], held.own[r]))
        (columns,) = whole.columns(at, whole.residuals(at), range(len(common)))
        its, sizes = whole.whitener(held.columns[r]), whole.whitener(columns * scale)
        alone = replace(whole, unknowns=mine)
        G, b = alone.projected(held.own[r], [held.residuals[r]], [its], [sizes])
        wanted, pull = wanted + G, pull + b
        e = whole.whitener(held.residuals[r])
        squares.append(e[np.isfinite(e)] ** 2)
    noise = max(1.0, float(np.mean(np.concatenate(squares))))
    # In the frame where the learnt sizes are independent and of unit variance.
    frame = cholesky(learnt, lower=True)
    half = solve_triangular(frame, wanted, lower=True)
    information, axes = np.linalg.eigh(solve_triangular(frame, half.T, lower=True))
    along = axes.T @ solve_triangular(frame, pull, lower=True)
    told = information > TOLD_INFORMATION
    far = along[told] ** 2 / (information[told] * (1.0 + information[told]))
    return Transfer(float(np.sum(far)) / noise, int(told.sum()))
