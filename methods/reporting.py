"""From a filter's own coordinates to the state that is reported."""

from __future__ import annotations

import numpy as np

from data.batch import STATES, Array
from methods.estimator import FLAG_MISSING, FLAG_SPIKE, Z95, State
from methods.frontend import Clean
from physics.health import theta_and_slope


def report(z: Array, P: Array, keep: np.ndarray, memory: tuple[np.ndarray, ...]) -> State:
    """Physical units: delta method for the covariance, mapped bounds for the health intervals.

    Args:
        z, P: (B, n), (B, n, n) in the filter's coordinates.
        keep: (10,) where the five states and the five zeta stand in z.
    """
    n = len(STATES)
    sd = np.sqrt(np.diagonal(P, axis1=1, axis2=2)[:, keep])
    x, zeta = z[:, keep[:n]], z[:, keep[n:]]
    half = Z95 * sd[:, n:]
    theta, slope = theta_and_slope(np.stack([zeta, zeta - half, zeta + half]))
    scale = np.concatenate([np.ones_like(x), slope[0]], axis=1)
    cov = P[:, keep[:, None], keep] * scale[:, :, None] * scale[:, None, :]
    spread = Z95 * sd[:, :n]
    mean, low, high = (np.concatenate(ends, axis=1) for ends in zip((x, x - spread, x + spread), theta, strict=True))
    return State(mean, cov, low, high, memory)


def clean_flags(clean: Clean) -> np.ndarray:
    """(B,) flags of what the front end saw."""
    missing = (~clean.accepted & ~clean.spike).any(axis=1)
    return np.where(clean.spike.any(axis=1), FLAG_SPIKE, 0) | np.where(missing, FLAG_MISSING, 0)
