"""The noise of measured inputs, told by a user or shown by the record: the machine got other inputs than are recorded.

What the noise of each stretch does to the readings is linear algebra along the run. So the readings' covariance is that
of the sensors plus that of the inputs, and both are whitened together.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.linalg import cholesky, solve_triangular
from scipy.sparse.linalg import ArpackNoConvergence, LinearOperator, eigsh

from twinbench.mismatch.course import Acts, Course
from twinbench.mismatch.seed import ENGINE_SEED
from twinbench.mismatch.sensors import SensorNoise
from twinbench.physics.simulator import Array

FELT = 0.1
"""Variance, in that of the sensors' noise, up to which the readings do not feel a combination of the stretches' noise:
the sensors' noise, which is learnt, takes in so little."""
FEW_FELT = 4
"""Combinations that are sought first: of most records the readings feel none. Any number gives the same ones."""
AT_ONCE = 256
"""Combinations that are followed at once: all of a long recording would need gigabytes. Any number gives the same."""


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
    def felt(moves: LinearOperator) -> Array:
        """(N, k) orthonormal combinations of the stretches' noise that the readings feel, dimensionless.

        Args:
            moves: (B * ny, N) dimensionless, in sds of the sensors' noise per sd.
        """
        many, few = moves.shape[1], FEW_FELT
        own = LinearOperator((many, many), lambda v: moves.rmatvec(moves.matvec(v)), dtype=float)
        begin = np.random.default_rng(ENGINE_SEED).normal(size=many)
        while 4 * few < many:
            try:
                variances, turn = eigsh(own, few, v0=begin)
            except ArpackNoConvergence:
                break
            if variances.min() <= FELT:
                return np.asarray(turn[:, variances > FELT])
            few *= 4
        whole = moves.matmat(np.eye(many))
        variances, turn = np.linalg.eigh(whole.T @ whole)
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


class Moves:
    """What the noise of a recording's measured inputs does to its readings, stretch by stretch: N pieces of noise.

    Long recordings have thousands of stretches, so it is not written out, but followed along the run and back.
    """

    def __init__(self, course: Course, sds: Array) -> None:
        """The noise of each measured input's stretches.

        Args:
            course: the recording's.
            sds: (nu,) standard deviation of a sample of each input, in its unit; 0 where it is set and not measured.
        """
        self._course, self._acts = course, list[Acts]()
        # A stretch's input is the mean over its samples, whose noise is independent.
        self._shares = 1.0 / np.sqrt(np.maximum(course.grid.samples, 1))
        for i in np.flatnonzero(sds):
            u = course.u.copy()
            u[:, i] += sds[i]
            self._acts.append(course.of_inputs(u).times(self._shares[:, None]))

    @property
    def many(self) -> int:
        """N, the stretches of all measured inputs."""
        return len(self._acts) * len(self._shares)

    def of(self, weights: Array) -> Array:
        """(B, ny, k) what combinations of the noise do to the readings, in the outputs' units.

        Args:
            weights: (N, k) dimensionless, of each stretch's noise in its sds.
        """
        parts = []
        for k in range(0, weights.shape[1], AT_ONCE):
            pieces = np.split(weights[:, k : k + AT_ONCE], len(self._acts))
            acts = self._course.none(pieces[0].shape[1])
            for act, piece in zip(self._acts, pieces, strict=True):
                acts.rates[:] += act.rates * piece[:, None]
                acts.reads[:] += act.reads * piece[:, None]
            parts.append(np.nan_to_num(self._course.columns(acts)))
        _, _, ny = self._course.sizes
        return np.concatenate([np.empty((len(self._course.track.starts), ny, 0)), *parts], axis=2)

    def whitened(self, noise: SensorNoise, residuals: Array) -> LinearOperator:
        """The same in sds of the sensors' noise, (B * ny, N).

        Args:
            residuals: (B, ny) in the outputs' units, NaN where missing.
        """

        def forth(weights: Array) -> Array:
            return noise.beside(self.of(weights.reshape(self.many, -1)), residuals)[:, :-1]

        def back(white: Array) -> Array:
            acted = self._course.transposed(noise.transposed(white, residuals))
            rows = [
                (a.rates * acted.rates).sum(axis=(1, 2)) + (a.reads * acted.reads).sum(axis=(1, 2)) for a in self._acts
            ]
            return np.concatenate(rows)

        return LinearOperator((residuals.size, self.many), forth, back, matmat=forth, dtype=float)

    def felt(self, noise: SensorNoise, residuals: Array) -> Array:
        """(B, ny, k) what the combinations do that the readings feel, in the outputs' units.

        Args:
            residuals: (B, ny) in the outputs' units, NaN where missing.
        """
        if not self._acts:
            return np.empty((*residuals.shape, 0))
        return self.of(InputNoise.felt(self.whitened(noise, residuals)))
