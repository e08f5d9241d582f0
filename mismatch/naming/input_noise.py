"""The noise of measured inputs, told by a user or shown by the record: the machine got other inputs than are recorded.

What the noise of each stretch does to the readings is linear algebra along the run. So the readings' covariance is that
of the sensors plus that of the inputs, and both are whitened together.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.linalg import cholesky, solve_triangular

from twinbench.mismatch.course import Course, together
from twinbench.physics.simulator import Array

FELT = 0.1
"""Variance, in that of the sensors' noise, up to which the readings do not feel a combination of the stretches' noise:
the sensors' noise, which is learnt, takes in so little."""


class InputNoise(NamedTuple):
    """Of one recording, after the sensors' noise was whitened.

    Attributes:
        moves: (B * ny, N) what N combinations of the stretches' noise do to the readings, dimensionless: in sds of the
            sensors' noise per sd.
        root: (N, N) dimensionless, the lower Cholesky factor L of its posterior precision, I + moves' moves.
    """

    moves: Array
    root: Array

    @classmethod
    def of(cls, moves: Array) -> InputNoise:
        """From what it does to the readings.

        Args:
            moves: (B * ny, N) dimensionless, in sds of the sensors' noise per sd.
        """
        return cls(moves, np.asarray(cholesky(np.eye(moves.shape[1]) + moves.T @ moves, lower=True)))

    @staticmethod
    def felt(moves: Array) -> Array:
        """(N, k) orthonormal combinations of the stretches' noise that the readings feel, dimensionless.

        Args:
            moves: (B * ny, N) dimensionless, in sds of the sensors' noise per sd.
        """
        variances, turn = np.linalg.eigh(moves.T @ moves)
        return np.asarray(turn[:, variances > FELT])

    def whitened(self, white: Array) -> Array:
        """Columns (B * ny, K) in sds of the noise of sensors and inputs.

        By ``I - moves (I + L)^-T L^-1 moves'``, a root of the inverse covariance: all scalar products are right.

        Args:
            white: (B * ny, K) dimensionless, in sds of the sensors' noise.
        """
        along = solve_triangular(self.root, self.moves.T @ white, lower=True)
        along = solve_triangular(self.root + np.eye(len(self.root)), along, lower=True, trans=1)
        return np.asarray(white - self.moves @ along)

    def drawn(self, white: Array, rng: np.random.Generator) -> Array:
        """A draw of these combinations, (N,) in sds of the noise, given what a fit leaves of the readings.

        Args:
            white: (B * ny,) that, dimensionless, in sds of the sensors' noise.
        """
        along = solve_triangular(self.root, self.moves.T @ white, lower=True) + rng.normal(size=len(self.root))
        return np.asarray(solve_triangular(self.root, along, lower=True, trans=1))


def moved_by(course: Course, sds: Array) -> Array:
    """(B, ny, N) what the noise of each stretch and input does to the readings, in the outputs' units per sd of it.

    Args:
        sds: (nu,) standard deviation of a sample of each input, in its unit; 0 where it is set and not measured.
    """
    if not sds.any():
        return np.zeros((len(course.track.starts), course.sizes[2], 0))
    # A stretch's input is the mean over its samples, whose noise is independent.
    shares = 1.0 / np.sqrt(np.maximum(course.grid.samples, 1))
    acts = []
    for i in np.flatnonzero(sds):
        u = course.u.copy()
        u[:, i] += sds[i]
        acts.append(course.of_inputs(u).times(np.diag(shares)))
    return course.columns(together(acts))
