"""From a filter's own coordinates to the state that is reported."""

from __future__ import annotations

import numpy as np
from numba import njit

from twinbench.machines.coordinates import Array, Coordinates, map_one
from twinbench.methods.estimator import FLAG_MISSING, FLAG_SPIKE, Z95, State
from twinbench.methods.frontend import Clean


@njit(cache=True, error_model="numpy")
def report_one(health, z, P, keep, mean, cov, low, high):  # type: ignore[no-untyped-def]
    """``report`` of one machine, written into ``mean``, ``cov``, ``low`` and ``high``; for compiled code."""
    states = keep.size - health.slope.size
    for i in range(keep.size):
        k = keep[i]
        half = Z95 * np.sqrt(P[k, k])
        if i < states:
            mean[i], low[i], high[i] = z[k], z[k] - half, z[k] + half
            scale = 1.0
        else:
            j = i - states
            mean[i], scale = map_one(health, j, z[k])
            low[i], high[i] = map_one(health, j, z[k] - half)[0], map_one(health, j, z[k] + half)[0]
        for other in range(i):
            cov[i, other] *= scale
            cov[other, i] = cov[i, other]
        for other in range(i, keep.size):
            cov[other, i] = P[k, keep[other]] * scale
        cov[i, i] *= scale


@njit(cache=True, error_model="numpy")
def _report(health, z, P, keep, mean, cov, low, high):  # type: ignore[no-untyped-def]
    for b in range(z.shape[0]):
        report_one(health, z[b], P[b], keep, mean[b], cov[b], low[b], high[b])


def report(health: Coordinates, z: Array, P: Array, keep: np.ndarray, memory: tuple[np.ndarray, ...]) -> State:
    """Physical units: delta method for the covariance, mapped bounds for the health intervals.

    Args:
        health: the machine's map of its nh health parameters.
        z: (B, n) mean in the filter's coordinates: states in their units, health as dimensionless zeta.
        P: (B, n, n) its covariance, in those units squared.
        keep: (m,) positions in z, dimensionless: where the estimated states stand, then the nh zeta.
        memory: the method's own arrays, in units of its own, every shape (B, ...).
    """
    shape = (len(z), len(keep))
    mean, low, high, cov = np.empty(shape), np.empty(shape), np.empty(shape), np.empty((*shape, len(keep)))
    _report(health, z, P, keep, mean, cov, low, high)
    return State(mean, cov, low, high, memory)


def clean_flags(clean: Clean) -> np.ndarray:
    """(B,) flags of what the front end saw."""
    missing = (~clean.accepted & ~clean.spike).any(axis=1)
    return np.where(clean.spike.any(axis=1), FLAG_SPIKE, 0) | np.where(missing, FLAG_MISSING, 0)
