"""Health parameters in unconstrained coordinates: zeta = T(theta), logistic or exponential.

The filters work on zeta (Eq. (5)), so that what is reported always keeps its bounds: positive leakage, finite heat
transfer, limited capacity. Each map is scaled so that d theta / d zeta is the parameter's ``scale`` at its healthy
value: one unit of zeta is one typical change.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array = NDArray[np.float64]

ZETA_SCALE = 4.0
"""Networks see health coordinates divided by this, so that a machine's life spans about one."""


class Coordinates(NamedTuple):
    """The map between a machine's health parameters and their coordinates, as compiled code takes it too.

    Attributes:
        healthy: (nh,) values of a fresh machine, in the parameters' units.
        low: (nh,) lower physical bounds, likewise.
        high: (nh,) upper physical bounds, likewise.
        exponential: (nh,) bool: the map is exponential; else it is logistic.
        slope: (nh,) dimensionless, of the map's argument per unit of zeta.
        offset: (nh,) dimensionless, the logistic map's argument at the healthy value.
    """

    healthy: Array
    low: Array
    high: Array
    exponential: np.ndarray
    slope: Array
    offset: Array

    def theta_and_slope(self, zeta: Array) -> tuple[Array, Array]:
        """Physical health parameters and d theta / d zeta, both (..., nh), from coordinates (..., nh).

        Args:
            zeta: (..., nh) dimensionless coordinates.
        """
        rows = np.ascontiguousarray(zeta, dtype=np.float64).reshape(-1, len(self.healthy))
        theta, slope = np.empty_like(rows), np.empty_like(rows)
        map_health(self, rows, theta, slope)
        return theta.reshape(zeta.shape), slope.reshape(zeta.shape)

    def to_theta(self, zeta: Array) -> Array:
        """Physical health parameters (..., nh) from unconstrained coordinates (..., nh).

        Args:
            zeta: (..., nh) dimensionless coordinates.
        """
        return self.theta_and_slope(zeta)[0]

    def to_zeta(self, theta: Array) -> Array:
        """Unconstrained coordinates (..., nh) of health parameters; healthy is zero.

        Parameters on or beyond a bound are taken a billionth inside it.

        Args:
            theta: (..., nh) health in the parameters' units.
        """
        share = np.clip((theta - self.low) / (self.high - self.low), 1e-9, 1 - 1e-9)
        logistic = np.log(share / (1 - share)) - self.offset
        ratio = np.clip(theta, self.low, self.high) / np.where(self.exponential, self.healthy, 1.0)
        exponential = np.log(np.where(self.exponential, ratio, 1.0))
        return np.where(self.exponential, exponential, logistic) / self.slope


def coordinates(healthy: Array, low: Array, high: Array, scale: Array, exponential: np.ndarray) -> Coordinates:
    """The map of parameters whose typical change is ``scale``.

    Args:
        healthy: (nh,) values of a fresh machine, in the parameters' units.
        low: (nh,) lower physical bounds, likewise.
        high: (nh,) upper physical bounds, likewise.
        scale: (nh,) typical changes, likewise.
        exponential: (nh,) bool: the map is exponential; else it is logistic.
    """
    share = (healthy - low) / (high - low)
    logit = np.where(exponential, 0.0, np.log(share / (1 - share)))
    slope = np.where(exponential, scale / healthy.clip(1e-9), scale / ((high - low) * share * (1 - share)))
    return Coordinates(healthy, low, high, exponential, slope, logit)


@njit(cache=True)
def map_one(c, j, zeta):  # type: ignore[no-untyped-def]
    """Value and d theta / d zeta of the j-th parameter, in compiled code."""
    s = c.slope[j] * zeta
    if c.exponential[j]:
        theta = min(max(c.healthy[j] * np.exp(min(max(s, -50.0), 50.0)), c.low[j]), c.high[j])
        return theta, c.slope[j] * theta
    share = 1.0 / (1.0 + np.exp(-min(max(s + c.offset[j], -500.0), 500.0)))
    width = c.high[j] - c.low[j]
    return c.low[j] + width * share, c.slope[j] * width * share * (1.0 - share)


@njit(cache=True)
def map_health(c, zeta, theta, slope):  # type: ignore[no-untyped-def]
    """``theta_and_slope`` in compiled code: rows of (M, nh), written into ``theta`` and ``slope``."""
    for i in range(zeta.shape[0]):
        for j in range(zeta.shape[1]):
            theta[i, j], slope[i, j] = map_one(c, j, zeta[i, j])
