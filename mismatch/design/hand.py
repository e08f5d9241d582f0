"""What is at hand before an experiment: rivals where they stand, and what the recordings say of all that they share."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from scipy.linalg import cho_solve, solve_triangular

from twinbench.mismatch.calibrate import own_unknowns
from twinbench.mismatch.fit import Unknown
from twinbench.mismatch.naming.answer import shares
from twinbench.mismatch.naming.effect import memory_starts
from twinbench.mismatch.naming.ground import Ground
from twinbench.mismatch.naming.marginal import DISCREPANCY_PCT, LEAST_TRIED_PCT, factored
from twinbench.mismatch.naming.settle import Settled, columns_of
from twinbench.mismatch.naming.view import WANDERS, View, prior_mean
from twinbench.mismatch.tracks import Track
from twinbench.physics.simulator import Array

GROWN_PCT = (0.0, 0.1, 0.3, 0.7)
"""Sizes, in per cent, that the discrepancy may at least have beside a rival, up to its prior's sd: the likeliest one
counts, since the engine learns it anew when the experiment was made."""


class Known(NamedTuple):
    """What recordings say of the L unknowns that every recording of a machine shares, the discrepancy's F last.

    Attributes:
        G: (L, L) products of whitened columns, what each recording has for itself integrated out.
        b: (L,) products of these with the whitened residuals.
        mean: (L - F,) dimensionless prior mean of those that are not the discrepancy's, from where they stand.
    """

    G: Array
    b: Array
    mean: Array


@dataclass(frozen=True)
class Hand:
    """Rivals, and what is known of each.

    Attributes:
        rivals: hypotheses at their own fixed points.
        names: what each is called.
        ground: the noise, and the functions of the discrepancy, at all ports and wherever candidates go.
        known: of each rival.
        s: (P,) of each rival, the discrepancy beside it, per cent.
        measured: (ny,) bool, the outputs that are read.
        logs: (m,) dimensionless, evidence of each rival by the recordings at hand in nats, constants apart.
        low: (ny,) the least that an experiment may bring them to, in their units.
        high: (ny,) the most, likewise.
    """

    rivals: tuple[Settled, ...]
    names: tuple[str, ...]
    ground: Ground
    known: tuple[Known, ...]
    s: tuple[Array, ...]
    measured: np.ndarray
    logs: Array
    low: Array
    high: Array

    @property
    def probabilities(self) -> list[float]:
        """(m,) of each rival, as if it were one of them."""
        return shares(self.logs)

    def reach(self, u: Array, means: Array) -> float:
        """How far an experiment leaves what the recordings went through: the farthest of all inputs and outputs.

        It is in scales of each; nothing where there are no recordings.

        Args:
            u: (N, nu) its inputs, in their units.
            means: (B, ny) what is foretold of its outputs, in their units.
        """
        problem = self.rivals[0].problem
        if not problem.tracks:
            return 0.0
        simulator, most = problem.machine.simulator, 0.0
        groups = (
            (simulator.inputs, [t.u for t in problem.tracks], u),
            (simulator.outputs, [t.means for t in problem.tracks], means),
        )
        for variables, seen, goes in groups:
            every = np.concatenate(seen)
            for k in (k for k in range(len(variables)) if np.isfinite(every[:, k]).any()):
                low, high = np.nanmin(every[:, k]), np.nanmax(every[:, k])
                beyond = max(low - goes[:, k].min(), goes[:, k].max() - high, 0.0)
                most = max(most, float(beyond) / variables[k].scale)
        return most

    @cached_property
    def group(self) -> np.ndarray:
        """(F,) position of each function's port."""
        d = self.ground.discrepancy
        ports = len(d.ports) if self.ground.ports else 0
        return np.repeat(np.arange(ports), len(d.points))

    @cached_property
    def truths(self) -> list[tuple[Array, Array]]:
        """Of each rival's L unknowns the posterior mean (L,) from where they stand, and a root (L, k), in prior sds.

        The root is that of its effects' sizes and forms and of the discrepancy, the parameters as they are: all rivals
        would follow these alike, but far off their linearised runs would not. Without recordings a rival is what it
        stands at.
        """
        found = []
        for rival, known, s in zip(self.rivals, self.known, self.s, strict=True):
            if not self.rivals[0].problem.tracks:
                found.append((np.zeros(len(known.b)), np.zeros((len(known.b), 1))))
                continue
            precision = self.precision(known, s)
            A = known.G + np.diag(precision)
            right = known.b + np.concatenate((known.mean, np.zeros(len(self.group))))
            scale, L = factored(A)
            mean = scale * cho_solve((L, True), scale * right)
            fixed = sum(u.kind == "parameter" for u in rival.problem.unknowns)
            scale, L = factored(A[fixed:, fixed:])
            found.append((mean, np.vstack((np.zeros((fixed, len(L))), scale[:, None] * np.linalg.inv(L).T))))
        return found

    @cached_property
    def before(self) -> Array:
        """(m,) dimensionless, ``likeliest`` of each rival by the recordings at hand alone."""
        return np.array([self.likeliest(k, known.G, known.b[:, None])[0] for k, known in enumerate(self.known)])

    def likeliest(self, rival: int, G: Array, b: Array) -> Array:
        """(M,) dimensionless, log evidence in nats with the discrepancy as large as is likeliest for each reading.

        Args:
            G: (L, L) products of whitened columns of what a rival shares with all recordings.
            b: (L, M) products of these with M whitened readings.
        """
        s = self.s[rival]
        grown = [np.maximum(s, least) for least in GROWN_PCT] if len(s) else [s]
        different = [one for k, one in enumerate(grown) if not k or np.any(one > grown[k - 1])]
        return np.max([self._evidence(self.known[rival], G, b, one) for one in different], axis=0)

    def _evidence(self, known: Known, G: Array, b: Array, s: Array) -> Array:
        precision, mean = self.precision(known, s), np.concatenate((known.mean, np.zeros(len(self.group))))
        scale, L = factored(G + np.diag(precision))
        right = solve_triangular(L, scale[:, None] * (b + mean[:, None]), lower=True, check_finite=False)
        constant = 0.5 * np.log(precision).sum() - np.log(np.diag(L) / scale).sum() - 0.5 * known.mean @ known.mean
        return np.asarray(0.5 * np.sum(right**2, axis=0) + constant - 0.5 * np.sum((s / DISCREPANCY_PCT) ** 2))

    def precision(self, known: Known, s: Array) -> Array:
        """(L,) prior precision of the shared unknowns where the discrepancy has some sizes.

        Args:
            s: (P,) these sizes, per cent.
        """
        return np.concatenate((np.ones(len(known.mean)), 1.0 / np.maximum(s, LEAST_TRIED_PCT)[self.group] ** 2))


def at_hand(rivals: Sequence[Settled], names: Sequence[str], ground: Ground) -> Hand:
    """What recordings say of rivals that were brought to their fixed points on them.

    Args:
        ground: with the functions that count from now on.
    """
    tracks, ny = rivals[0].problem.tracks, len(ground.noise.white)
    measured = np.ones(ny, dtype=bool)
    outputs = rivals[0].problem.machine.simulator.outputs
    low, high = (np.array([v.low - v.scale for v in outputs]), np.array([v.high + v.scale for v in outputs]))
    if tracks:
        means = np.concatenate([t.means for t in tracks])
        measured = np.isfinite(means).any(axis=0)
        # Bounds are declared by guess; where the machine was it may go again.
        low[measured] = np.minimum(low[measured], np.nanmin(means[:, measured], axis=0))
        high[measured] = np.maximum(high[measured], np.nanmax(means[:, measured], axis=0))
    functions = functions_of(View.around(rivals[0].problem, rivals[0].z), ground)
    known = tuple(_known(h, ground, functions) for h in rivals)
    s = tuple(_sizes(h, ground) for h in rivals)
    logs = np.array([h.log for h in rivals])
    return Hand(tuple(rivals), tuple(names), ground, known, s, measured, logs, low, high)


def weighed_as(hand: Hand, weights: Mapping[str, float]) -> Hand:
    """The same with the probabilities that a verdict gives its names, where it gives one to each.

    What does the same in the recordings may stand elsewhere once it is fitted by itself, and the verdict knows better.
    """
    if not all(weights.get(name, 0.0) > 0.0 for name in hand.names):
        return hand
    return replace(hand, logs=np.log([weights[name] for name in hand.names]))


def functions_of(view: View, ground: Ground) -> list[Array]:
    """Columns (B, ny, F) of the discrepancy at all its ports per recording; none where equations count as exact.

    One port after the other: what acts at all of them takes much room, and the time to fill it.
    """
    if not ground.ports:
        return [np.zeros((*r.shape, 0)) for r in view.residuals]
    d, found = ground.discrepancy, []
    for course in view.courses:
        functions = d.functions(course)
        found.append(
            np.concatenate([course.columns(d.acts(course, p, functions)) for p in range(len(d.ports))], axis=2)
        )
    return found


def own_columns(view: View, rival: Settled, ground: Ground, wanders: Sequence[int] | None = None) -> list[Array]:
    """Columns of a rival's unknowns, then of what its size differs by from place to place, per recording.

    Args:
        wanders: positions of the sizes that may differ, where they are not those of the rival's own problem.
    """
    columns = columns_of(view, ground, rival.wanders if wanders is None else wanders)
    for one in columns:
        one[:, :, len(view.z) :] *= rival.share / WANDERS
    return columns


def shared(rival: Settled) -> list[int]:
    """Positions of the unknowns that all recordings have in common."""
    return [k for k, u in enumerate(rival.problem.unknowns) if u.recording == -1]


def own_of(rival: Settled, track: Track) -> tuple[Unknown, ...]:
    """What a new recording has for itself: where it starts, what drifts in it, and what effects remember."""
    machine = rival.problem.machine
    return (*own_unknowns(machine.simulator, [track]), *memory_starts(machine, rival.effects, 1))


def _known(h: Settled, ground: Ground, functions: Sequence[Array]) -> Known:
    view, K = View.around(h.problem, h.z), len(h.z)
    own, F = K + wandering(h, ground), many_functions(ground)
    columns = own_columns(view, h, ground)
    G, b = np.zeros((own + F, own + F)), np.zeros(own + F)
    for r, residual in enumerate(view.residuals):
        white = ground.whitened(r, np.concatenate((columns[r], functions[r]), axis=2), residual)
        G += white[:, :-1].T @ white[:, :-1]
        b += white[:, :-1].T @ white[:, -1]
    common, mean = shared(h), prior_mean(view)
    out = np.setdiff1d(np.arange(K), common)
    left = folded_out(G, b[:, None], out, mean[out])
    return Known(left.G, left.b[:, 0], np.concatenate((mean[common], np.zeros(own - K))))


class Folded(NamedTuple):
    """Unknowns with a prior sd of one integrated out, for M readings at once.

    Attributes:
        G: (L, L) products of the whitened columns that are left.
        b: (L, M) likewise.
        log: (M,) dimensionless, what those that went contributed in nats.
    """

    G: Array
    b: Array
    log: Array


def folded_out(G: Array, b: Array, out: np.ndarray, mean: Array) -> Folded:
    """Integrate unknowns out of products for several readings.

    Args:
        G: (K, K) products of whitened columns.
        b: (K, M) products of these with M whitened readings.
        out: (k,) positions of the unknowns.
        mean: (k,) of their prior, dimensionless: in prior sds.
    """
    if not len(out):
        return Folded(G, b, np.zeros(b.shape[1]))
    left = np.setdiff1d(np.arange(len(G)), out)
    scale, L = factored(G[np.ix_(out, out)] + np.eye(len(out)))
    right, cross = b[out] + mean[:, None], G[np.ix_(out, left)]
    solved = scale[:, None] * cho_solve((L, True), scale[:, None] * np.concatenate((cross, right), axis=1))
    by_cross, by_right = solved[:, : len(left)], solved[:, len(left) :]
    log = 0.5 * np.einsum("km,km->m", right, by_right) - 0.5 * mean @ mean - float(np.log(np.diag(L) / scale).sum())
    kept = G[np.ix_(left, left)] - cross.T @ by_cross
    return Folded(0.5 * (kept + kept.T), b[left] - cross.T @ by_right, log)


def _sizes(h: Settled, ground: Ground) -> Array:
    """(P,) of the discrepancy beside a hypothesis at all ports, per cent: none where none was found."""
    if not ground.ports:
        return np.zeros(0)
    s = np.full(len(ground.discrepancy.ports), LEAST_TRIED_PCT)
    s[[p for p, _ in ground.kept]] = h.learnt.s
    return s


def wandering(h: Settled, ground: Ground) -> int:
    """How many columns there are of what a hypothesis's sizes differ by from place to place."""
    return len(h.wanders) * ground.discrepancy.main.shape[1]


def many_functions(ground: Ground) -> int:
    """F, of the discrepancy at all its ports; none where equations count as exact."""
    return len(ground.discrepancy.ports) * len(ground.discrepancy.points) if ground.ports else 0
