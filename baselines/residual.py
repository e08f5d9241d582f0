"""A small network beside a model's equations, compiled: the rates that the equations leave out."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

from twinbench.baselines.augmented_model import true_inputs
from twinbench.data.batch import HEALTH, INPUTS, STATES, Array
from twinbench.physics.compressor import X

N_X, N_U, N_ZETA = len(STATES), len(INPUTS), len(HEALTH) - 1
VALVE = X.valve_pos
EDGE = 5.0
"""Standardised inputs of the residual are held within this many spreads of training: beyond what it was shown it stays
as it is at the edge. Results depend on it only under faults, where sigma points lie far out."""


class Residual(NamedTuple):
    """The network as compiled code takes it.

    Attributes:
        mean: (14,) of what it reads, each in its unit.
        scale: (14,) likewise.
        first: (14, W) dimensionless weights.
        first_bias: (W,) dimensionless.
        second: (W, W) dimensionless.
        second_bias: (W,) dimensionless.
        third: (W, 5) dimensionless.
        third_bias: (5,) dimensionless.
        unit: (5,) of what it says, in the states' units per second.
    """

    mean: Array
    scale: Array
    first: Array
    first_bias: Array
    second: Array
    second_bias: Array
    third: Array
    third_bias: Array
    unit: Array


@njit(cache=True, error_model="numpy")
def _silu(a):  # type: ignore[no-untyped-def]
    return a * (0.5 * (1.0 + np.tanh(0.5 * a)))


@njit(cache=True, error_model="numpy")
def residual_rates(net, seen):  # type: ignore[no-untyped-def]
    """Rates (M, 5) in the states' units per second, from what the network reads (M, 14), each in its unit."""
    a = np.empty_like(seen)
    for k in range(seen.shape[0]):
        for i in range(seen.shape[1]):
            a[k, i] = min(max((seen[k, i] - net.mean[i]) / net.scale[i], -EDGE), EDGE)
    h = _silu(a @ net.first + net.first_bias)
    h = _silu(h @ net.second + net.second_bias)
    return (h @ net.third + net.third_bias) * net.unit


@njit(cache=True, error_model="numpy")
def residual_input(model, points, u):  # type: ignore[no-untyped-def]
    """What the network reads (K, 14) at points (K, n) under inputs u (4,) as read."""
    out, health = np.empty((points.shape[0], N_X + N_U + 1 + N_ZETA)), model.step.size
    for k in range(points.shape[0]):
        out[k, :N_X] = points[k, :N_X]
        out[k, N_X : N_X + N_U] = true_inputs(model, points[k], u)
        out[k, N_X + N_U] = points[k, VALVE]
        out[k, N_X + N_U + 1 :] = points[k, health : health + N_ZETA]
    return out
