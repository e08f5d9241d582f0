"""The sensors' noise: white and slowly changing parts per channel, whitened in innovations form."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numba import njit, types
from scipy.optimize import minimize

from twinbench.physics.integrate import MATRIX
from twinbench.physics.jit import VECTOR
from twinbench.physics.simulator import Array

FIRST_MEMORY, LONGEST_MEMORY = 5.0, 15.0
"""Blocks that the coloured part remembers at first, and at most: what lasts longer cannot be told from left-out
physics, and counts as that."""
SHORTEST_MEMORY = 0.3
_EVALUATIONS = 150


class SensorNoise(NamedTuple):
    """Of block means: white noise beside first-order coloured noise.

    Attributes:
        white: (ny,) variance of the white part, in the outputs' units squared.
        coloured: (ny,) variance of the coloured part, likewise.
        memory: (ny,) time in which the coloured part falls to 1/e, in units of a block.
    """

    white: Array
    coloured: Array
    memory: Array

    @property
    def variance(self) -> Array:
        """(ny,) of both parts, in the outputs' units squared."""
        return self.white + self.coloured

    @classmethod
    def first_guess(cls, floor: Array) -> SensorNoise:
        """From the noise of block means.

        Args:
            floor: (ny,) by their second differences, in the outputs' units.
        """
        return cls(0.7 * floor**2, 0.5 * floor**2, np.full(len(floor), FIRST_MEMORY))

    def whitened(self, values: Array) -> Array:
        """Innovations (B, ny, K) of values in sd; a row with a missing value (NaN) is nothing.

        Args:
            values: (B, ny, K) in the outputs' units; the last column decides what is missing.
        """
        out = np.ascontiguousarray(values)
        out = out.copy() if out is values else out
        for c in range(values.shape[1]):
            part = np.ascontiguousarray(out[:, c])
            _innovations(part, self.white[c], self.coloured[c], np.exp(-1.0 / self.memory[c]))
            out[:, c] = part
        return out

    def beside(self, columns: Array, residuals: Array) -> Array:
        """Columns and last the residuals in sd, (B * ny, K + 1); a row without a residual is nothing.

        Args:
            columns: (B, ny, K) in the outputs' units.
            residuals: (B, ny) in the outputs' units, NaN where missing.
        """
        both = np.concatenate((np.nan_to_num(columns), residuals[:, :, None]), axis=2)
        return self.whitened(both).reshape(-1, both.shape[2])

    def transposed(self, white: Array, residuals: Array) -> Array:
        """The transpose of ``beside`` for one column: weights (B, ny), per the outputs' units, of what is whitened.

        Args:
            white: (B * ny,) dimensionless, weights of what comes out.
            residuals: (B, ny) in the outputs' units, NaN where missing.
        """
        out = white.reshape(residuals.shape).copy()
        for c, keeps in enumerate(np.exp(-1.0 / self.memory)):
            part, seen = np.ascontiguousarray(out[:, c]), np.isfinite(residuals[:, c])
            _backwards(part, seen, self.white[c], self.coloured[c], keeps)
            out[:, c] = part
        return out

    def log(self, series: Sequence[Array]) -> float:
        """Nats of what a fit leaves, constants apart.

        Args:
            series: that, (B, ny) per recording, in the outputs' units; NaN where nothing was read.
        """
        keeps = np.exp(-1.0 / self.memory)
        return -sum(
            _surprise(np.ascontiguousarray(s[:, c : c + 1]), self.white[c], self.coloured[c], keeps[c])
            for s in series
            for c in range(len(keeps))
        )

    def learnt(self, series: Sequence[Array], floor: Array) -> SensorNoise:
        """Maximum likelihood on what a fit leaves.

        Args:
            series: that, (B, ny) per recording, in the outputs' units.
            floor: (ny,) least noise of block means, in the outputs' units.
        """
        found = [
            _most_likely([s[:, c] for s in series], floor[c], tuple(float(p[c]) for p in self))
            for c in range(len(self.white))
        ]
        return SensorNoise(*(np.array(part) for part in zip(*found, strict=True)))


def _most_likely(series: Sequence[Array], floor: float, start: tuple[float, ...]) -> Array:
    columns = [np.ascontiguousarray(s[:, None]) for s in series]

    def minus_log_likelihood(v: Array) -> float:
        white, coloured, memory = np.exp(v)
        if not SHORTEST_MEMORY < memory < LONGEST_MEMORY or white + coloured < 1e-4 * floor**2:
            return 1e12
        return sum(_surprise(c, white, coloured, np.exp(-1.0 / memory)) for c in columns)

    first = np.log(
        np.clip(
            start, [1e-6 * floor**2, 1e-6 * floor**2, 2.0 * SHORTEST_MEMORY], [np.inf, np.inf, 0.9 * LONGEST_MEMORY]
        )
    )
    options = {"maxfev": _EVALUATIONS, "xatol": 0.02, "fatol": 0.1}
    return np.asarray(np.exp(minimize(minus_log_likelihood, first, method="Nelder-Mead", options=options).x))


@njit(types.void(MATRIX, types.float64, types.float64, types.float64), cache=True, error_model="numpy", nogil=True)
def _innovations(values, white, coloured, keeps):  # type: ignore[no-untyped-def]
    many = values.shape[1]
    mean, P = np.zeros(many), coloured
    for k in range(values.shape[0]):
        if np.isnan(values[k, many - 1]):
            for j in range(many):
                mean[j] *= keeps
                values[k, j] = 0.0
            P = keeps * keeps * P + coloured * (1.0 - keeps * keeps)
            continue
        S = P + white
        gain, over = P / S, 1.0 / np.sqrt(S)
        for j in range(many):
            e = values[k, j] - mean[j]
            mean[j] = keeps * (mean[j] + gain * e)
            values[k, j] = e * over
        P = keeps * keeps * P * (1.0 - gain) + coloured * (1.0 - keeps * keeps)


@njit(
    types.void(VECTOR, types.boolean[::1], types.float64, types.float64, types.float64),
    cache=True,
    error_model="numpy",
    nogil=True,
)
def _backwards(values, seen, white, coloured, keeps):  # type: ignore[no-untyped-def]
    """The transpose of ``_innovations``, in place."""
    gain, over, P = np.zeros(values.shape[0]), np.zeros(values.shape[0]), coloured
    for k in range(values.shape[0]):
        if seen[k]:
            gain[k], over[k] = P / (P + white), 1.0 / np.sqrt(P + white)
        P = keeps * keeps * P * (1.0 - gain[k]) + coloured * (1.0 - keeps * keeps)
    mean = 0.0
    for k in range(values.shape[0] - 1, -1, -1):
        e = values[k] * over[k]
        values[k] = e + keeps * gain[k] * mean
        mean = keeps * (1.0 - gain[k]) * mean - e


@njit(types.float64(MATRIX, types.float64, types.float64, types.float64), cache=True, error_model="numpy", nogil=True)
def _surprise(values, white, coloured, keeps):  # type: ignore[no-untyped-def]
    """Minus the log-likelihood of one column, constants apart."""
    mean, P, total = 0.0, coloured, 0.0
    for k in range(values.shape[0]):
        if np.isnan(values[k, 0]):
            mean *= keeps
            P = keeps * keeps * P + coloured * (1.0 - keeps * keeps)
            continue
        S = P + white
        gain, e = P / S, values[k, 0] - mean
        mean = keeps * (mean + gain * e)
        total += 0.5 * (np.log(S) + e * e / S)
        P = keeps * keeps * P * (1.0 - gain) + coloured * (1.0 - keeps * keeps)
    return total
