"""What no catalogue holds, as a smooth random function of where the machine is, acting on one balance or flux.

The function is common to all recordings. Its covariance is the sum of two Gaussian kernels, a short and a long one,
in the directions that the machine really moved in; the few functions that make up most of it stand for it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from twinbench.mismatch.course import Acts, Course
from twinbench.physics.simulator import Array, Port

SHORT, LONG = 0.5, 2.0
"""Length scales, in spreads of where the machine was."""
FUNCTIONS = 40
"""Functions that stand for the covariance at most; twice as many change nothing that is found."""
ENOUGH_OF_IT = 0.98
"""Share of the covariance that they have to make up."""
MAIN = 10
"""Combinations of the functions by which the size of an effect may differ from place to place."""
MOVED = 0.05
"""Share of a standard spread below which the machine did not move in a direction."""
PER_CENT = 0.01
_SEEN = 600  # visited points that the functions are chosen by


@dataclass(frozen=True)
class Discrepancy:
    """The functions, and the ports at which they may act.

    Attributes:
        ports: where.
        units: per port, one per cent of what commonly acts there, in the state's unit per second, or that of what is
            there.
        centre: (n,) mean of where the machine was, in the units of ``Course.visited``.
        spread: (n,) its sd, in these units; infinite where it does not move.
        turn: (n, D) main directions, dimensionless.
        points: (R, D) where the functions are anchored, along the main directions, in units of the spread.
        root: (R, R) Cholesky factor of their covariance, dimensionless.
        width2: square of the unit of length.
        main: (R, M) dimensionless, the combinations of the functions that vary most along the courses.
    """

    ports: tuple[Port, ...]
    units: Array
    centre: Array
    spread: Array
    turn: Array
    points: Array
    root: Array
    width2: float
    main: Array

    def functions(self, course: Course) -> Array:
        """(S, R) the functions along a course, each of prior variance one together with the others."""
        at = (course.visited - self.centre) / self.spread @ self.turn
        k = _kernel(at, self.points, self.width2)
        return np.asarray(np.linalg.solve(self.root, k.T).T)

    def acts(self, course: Course, port: int, functions: Array) -> Acts:
        """What the functions do at a port, one per cent of what is common there; R changes.

        Args:
            functions: (S, R) along the course, dimensionless.
        """
        return course.forced(self.ports[port], float(self.units[port]), functions)


def discrepancy(courses: Sequence[Course], common: Mapping[Port, float]) -> Discrepancy:
    """Functions of where courses went.

    Args:
        common: the ports at which they may act, with what commonly acts there: in the state's unit per second at a
            balance, else in the unit of what is there.
    """
    every = np.concatenate([c.visited for c in courses])
    centre, spread = every.mean(axis=0), every.std(axis=0)
    spread = np.where(spread > 1e-6 * (np.abs(centre) + 1e-12), spread, np.inf)
    scaled = (every - centre) / spread
    variances, turn = np.linalg.eigh(np.cov(scaled.T).reshape(len(centre), -1))
    turn = turn[:, variances > MOVED]
    at = scaled @ turn
    width2 = float(np.mean(np.sum(at**2, axis=1))) / 2.0 / 2.0
    points = _anchors(at[:: max(1, len(at) // _SEEN)], width2)
    root = np.asarray(np.linalg.cholesky(_kernel(points, points, width2) + 1e-8 * np.eye(len(points))), dtype=float)
    ports, units = tuple(common), PER_CENT * np.array([*common.values()])
    made = Discrepancy(ports, units, centre, spread, turn, points, root, width2, np.eye(len(points)))
    along = np.concatenate([made.functions(c) for c in courses])
    main = np.linalg.svd(along[:: max(1, len(along) // _SEEN)], full_matrices=False)[2][:MAIN].T
    return replace(made, main=main)


def _kernel(a: Array, b: Array, width2: float) -> Array:
    d2 = np.maximum(np.sum(a**2, 1)[:, None] + np.sum(b**2, 1)[None] - 2.0 * a @ b.T, 0.0) / width2
    return np.asarray(0.5 * np.exp(-0.5 * d2 / SHORT**2) + 0.5 * np.exp(-0.5 * d2 / LONG**2))


def _anchors(at: Array, width2: float) -> Array:
    """Points that leave the least of the covariance over the visited ones, one after the other (pivoted Cholesky)."""
    left, rows = np.ones(len(at)), np.zeros((0, len(at)))
    chosen: list[int] = []
    while len(chosen) < FUNCTIONS and left.sum() > (1.0 - ENOUGH_OF_IT) * len(at):
        i = int(np.argmax(left))
        row = (_kernel(at[i : i + 1], at, width2)[0] - rows[:, i] @ rows) / np.sqrt(left[i])
        rows, left = np.vstack((rows, row)), np.maximum(left - row**2, 0.0)
        left[i] = 0.0
        chosen.append(i)
    return at[chosen]
