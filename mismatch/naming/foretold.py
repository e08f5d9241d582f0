"""How well a hypothesis foretells readings that it has not seen, all that it leaves uncertain counted in.

A run of the mended simulator errs by its parameters' uncertainty and by the discrepancy. Neither speaks against a name.
What a hypothesis foretells is a Gaussian: the mean by its posterior, the covariance from the noise, the parameters, the
recording's own start and the discrepancy.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.linalg import cho_solve, solve_triangular

from twinbench.mismatch.fit import ENDLESS, Problem, Unknown
from twinbench.mismatch.naming.ground import Ground
from twinbench.mismatch.naming.input_noise import Moves
from twinbench.mismatch.naming.marginal import LEAST_PCT, factored
from twinbench.mismatch.naming.settle import Settled, columns_of
from twinbench.mismatch.naming.view import WANDERS, View, prior_mean
from twinbench.mismatch.tracks import Track
from twinbench.physics.simulator import Array

UNFORETOLD = -1e6
"""Nats of readings at which a run went beyond all numbers: less than any other reading has."""


def foretold(
    hypothesis: Settled, ground: Ground, tracks: Sequence[Track], own: Sequence[Unknown], at: Sequence[Array]
) -> float:
    """Density of recordings that a hypothesis has not learnt from, nats, constants apart.

    It is summed over the recordings, each by itself. The discrepancy is that of where the learnt ones went; beyond, the
    hypothesis is surer than it should be.

    Args:
        tracks: the recordings.
        own: unknowns that each of them has for itself.
        at: where these stand, (K,) per recording, each in its own unit.
    """
    mean, root = _posterior(hypothesis, ground)
    log = 0.0
    for r, (track, start) in enumerate(zip(tracks, at, strict=True)):
        mine = [replace(u, recording=0) for u in own if u.recording == r]
        columns, residual = _seen(hypothesis, ground, track, mine, start, mean, root)
        if np.isnan(residual[np.isfinite(track.means)]).any() or np.abs(columns).max(initial=0.0) > ENDLESS:
            return UNFORETOLD
        both = np.concatenate((columns, residual[:, :, None]), axis=2)
        log += density(ground.noise.whitened(both))
    return log


def _posterior(hypothesis: Settled, ground: Ground) -> tuple[Array, Array]:
    """Of all unknowns, the discrepancy's last: mean (U,) from where they stand, and a root (U, U) of the covariance.

    Both are in prior sds, those of the discrepancy in per cent. The unknowns are where the hypothesis has them, within
    their bounds, and the rest as it goes with that.
    """
    G, b, _ = hypothesis.products.over()
    mean, precision = hypothesis.prior(ground)
    A, slope = G + np.diag(precision), b + precision * mean
    scale, L = factored(A)
    x, rest = np.zeros(len(slope)), slice(len(hypothesis.z), None)
    x[: len(hypothesis.z)] = (hypothesis.at - hypothesis.z) / hypothesis.problem.spreads
    own, factor = factored(A[rest, rest])
    x[rest] = own * cho_solve((factor, True), own * (slope - A @ x)[rest])
    return x, scale[:, None] * np.linalg.inv(L).T


def _seen(
    hypothesis: Settled,
    ground: Ground,
    track: Track,
    own: Sequence[Unknown],
    start: Array,
    mean: Array,
    root: Array,
) -> tuple[Array, Array]:
    """Columns (B, ny, U) of all that is uncertain of a recording, per sd; and readings less what is foretold, (B, ny).

    Args:
        own: unknowns of the recording itself, where they stand in ``start`` (K,), each in its unit.
        mean, root: of the posterior, (U,) and (U, U), as ``_posterior`` gives them.
    """
    learnt = hypothesis.problem
    shared = [k for k, u in enumerate(learnt.unknowns) if u.recording == -1]
    unknowns = (*(learnt.unknowns[k] for k in shared), *own)
    z = np.concatenate((hypothesis.z[shared], start))
    problem = Problem(learnt.machine, [track], unknowns, learnt.sd, theta=learnt.theta, since=learnt.since[:1])
    view = View.around(problem.refined(z), z)
    (columns,) = columns_of(view, ground, [shared.index(k) for k in hypothesis.wanders])
    many, first = len(learnt.unknowns), len(unknowns)
    wander = columns[:, :, first:] * (hypothesis.share / WANDERS)
    (whole,) = view.of_discrepancy(ground.discrepancy, [p for p, _ in ground.kept])
    kept, unseen = [], []
    parts = np.split(whole, len(ground.kept), axis=2)
    for part, (_, turn), s in zip(parts, ground.kept, hypothesis.learnt.s, strict=True):
        turned = np.linalg.qr(turn, mode="complete")[0]
        kept.append(part @ turn)
        unseen.append(part @ turned[:, turn.shape[1] :] * max(s, LEAST_PCT))
    known = np.nan_to_num(np.concatenate((columns[:, :, : len(shared)], wander, *kept), axis=2))
    at = [*shared, *range(many, len(mean))]
    alone = np.nan_to_num(columns[:, :, len(shared) : first])
    foreseen = known @ mean[at] + alone @ prior_mean(view)[len(shared) : first]
    moved = Moves(view.courses[0], problem.machine.input_sds).felt(ground.noise, view.residuals[0])
    uncertain = np.concatenate((known @ root[at], alone, *unseen, moved), axis=2)
    return np.nan_to_num(uncertain), view.residuals[0] - foreseen


def density(white: Array) -> float:
    """Nats of whitened readings, constants apart, what is uncertain integrated out.

    Args:
        white: (B, ny, U + 1) dimensionless: what is uncertain per sd, the readings last.
    """
    flat = white.reshape(-1, white.shape[2])
    X, y = flat[:, :-1], flat[:, -1]
    scale, L = factored(np.eye(X.shape[1]) + X.T @ X)
    right = solve_triangular(L, scale * (X.T @ y), lower=True)
    return -0.5 * float(y @ y - right @ right) - float(np.log(np.diag(L) / scale).sum())
