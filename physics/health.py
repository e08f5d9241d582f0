"""Health parameters in unconstrained coordinates: zeta = T(theta), logistic or exponential.

The filters work on zeta (Eq. (5)), so that what is reported always keeps its bounds: positive
leakage, finite heat transfer, limited capacity and efficiency. Each map is scaled so that
d theta / d zeta = ``scale`` at the healthy value: one unit of zeta is one typical change.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from twinbench.physics.compressor import HEALTH

Array = NDArray[np.float64]

HEALTHY = np.array([v.nominal for v in HEALTH])
LOW = np.array([v.low for v in HEALTH])
HIGH = np.array([v.high for v in HEALTH])
SPAN = np.array([0.12, 0.10, 0.037, 0.35, 6.0])
"""How far each parameter moves over a machine's life; errors in per cent of range refer to it."""
ZETA_SCALE = 4.0
"""Networks see health coordinates divided by this, so that a machine's life spans about one."""

_EXPONENTIAL = np.array([False, False, True, True, False])  # leakage and heat transfer
_SCALE = np.array([v.scale for v in HEALTH])
_SHARE = (HEALTHY - LOW) / (HIGH - LOW)
_SLOPE = np.where(_EXPONENTIAL, _SCALE / HEALTHY.clip(1e-9), _SCALE / ((HIGH - LOW) * _SHARE * (1 - _SHARE)))
_OFFSET = np.where(_EXPONENTIAL, 0.0, np.log(_SHARE / (1 - _SHARE)))


@njit(cache=True)
def map_one(j, zeta):  # type: ignore[no-untyped-def]
    """``theta_and_slope`` of the j-th parameter, in compiled code."""
    s = _SLOPE[j] * zeta
    if _EXPONENTIAL[j]:
        theta = min(max(HEALTHY[j] * np.exp(min(max(s, -50.0), 50.0)), LOW[j]), HIGH[j])
        return theta, _SLOPE[j] * theta
    share = 1.0 / (1.0 + np.exp(-min(max(s + _OFFSET[j], -500.0), 500.0)))
    return LOW[j] + (HIGH[j] - LOW[j]) * share, _SLOPE[j] * (HIGH[j] - LOW[j]) * share * (1.0 - share)


@njit(cache=True)
def map_health(zeta, theta, slope):  # type: ignore[no-untyped-def]
    """``theta_and_slope`` in compiled code: rows of (M, 5), written into ``theta`` and ``slope``."""
    for i in range(zeta.shape[0]):
        for j in range(zeta.shape[1]):
            theta[i, j], slope[i, j] = map_one(j, zeta[i, j])


def theta_and_slope(zeta: Array) -> tuple[Array, Array]:
    """Physical health parameters and d theta / d zeta, both (..., 5), from coordinates (..., 5).

    Args:
        zeta: (..., 5) dimensionless coordinates, order HEALTH.
    """
    rows = np.ascontiguousarray(zeta, dtype=np.float64).reshape(-1, len(HEALTH))
    theta, slope = np.empty_like(rows), np.empty_like(rows)
    map_health(rows, theta, slope)
    return theta.reshape(zeta.shape), slope.reshape(zeta.shape)


def to_theta(zeta: Array) -> Array:
    """Physical health parameters (..., 5) from unconstrained coordinates (..., 5).

    Args:
        zeta: (..., 5) dimensionless coordinates, order HEALTH.
    """
    return theta_and_slope(zeta)[0]


def d_theta_d_zeta(zeta: Array) -> Array:
    """Slope of ``to_theta``, (..., 5); positive everywhere inside the bounds.

    Args:
        zeta: (..., 5) dimensionless coordinates, order HEALTH.
    """
    return theta_and_slope(zeta)[1]


def to_zeta(theta: Array) -> Array:
    """Unconstrained coordinates (..., 5) of health parameters; healthy is zero.

    Parameters on or beyond a bound are taken a billionth inside it.

    Args:
        theta: (..., 5) health in the parameters' units, order HEALTH.
    """
    share = np.clip((theta - LOW) / (HIGH - LOW), 1e-9, 1 - 1e-9)
    logistic = np.log(share / (1 - share)) - _OFFSET
    ratio = np.clip(theta, LOW, HIGH) / np.where(_EXPONENTIAL, HEALTHY, 1.0)
    exponential = np.log(np.where(_EXPONENTIAL, ratio, 1.0))
    return np.where(_EXPONENTIAL, exponential, logistic) / _SLOPE


ZETA_LIMIT = np.abs(to_zeta(np.array([0.75, 0.75, 0.002, 0.30, -11.0])))
"""Bounds of the coordinates on either side, far outside a machine's life."""
ZETA_LOW, ZETA_HIGH = -ZETA_LIMIT, np.minimum(ZETA_LIMIT, to_zeta(HIGH))
"""Bounds that keep an interval's width: beyond a parameter's physical bound both of its ends would be that bound."""
