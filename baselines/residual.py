"""A small network beside a model's equations, compiled: the rates that the equations leave out."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

from twinbench.baselines.augmented_model import true_inputs
from twinbench.machines.coordinates import Array

EDGE = 5.0
"""Standardised inputs of the residual are held within this many spreads of training: beyond what it was shown it stays
as it is at the edge. Results depend on it only under faults, where sigma points lie far out."""


class Residual(NamedTuple):
    """The network as compiled code takes it.

    Attributes:
        mean: (F,) of what it reads, each in its unit.
        scale: (F,) likewise.
        first: (F, W) dimensionless weights.
        first_bias: (W,) dimensionless.
        second: (W, W) dimensionless.
        second_bias: (W,) dimensionless.
        third: (W, n) dimensionless.
        third_bias: (n,) dimensionless.
        unit: (n,) of what it says, in the states' units per second.
        actuators: (a,) positions of what it reads of the states beside the n estimated ones.
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
    actuators: np.ndarray


@njit(cache=True, error_model="numpy")
def _silu(a):  # type: ignore[no-untyped-def]
    return a * (0.5 * (1.0 + np.tanh(0.5 * a)))


@njit(cache=True, error_model="numpy")
def residual_rates(net, seen):  # type: ignore[no-untyped-def]
    """Rates (M, n) in the states' units per second, from what the network reads (M, F), each in its unit."""
    a = np.empty_like(seen)
    for k in range(seen.shape[0]):
        for i in range(seen.shape[1]):
            a[k, i] = min(max((seen[k, i] - net.mean[i]) / net.scale[i], -EDGE), EDGE)
    h = _silu(a @ net.first + net.first_bias)
    h = _silu(h @ net.second + net.second_bias)
    return (h @ net.third + net.third_bias) * net.unit


@njit(cache=True, error_model="numpy")
def residual_input(model, net, points, u):  # type: ignore[no-untyped-def]
    """What the network reads (K, F) at points (K, size) under inputs u (nu,) as read."""
    out, health, n = np.empty((points.shape[0], net.mean.size)), model.step.size, net.unit.size
    for k in range(points.shape[0]):
        out[k, :n] = points[k, :n]
        out[k, n : n + u.size] = true_inputs(model, points[k], u)
        at = n + u.size
        for i in net.actuators:
            out[k, at] = points[k, i]
            at += 1
        for i in range(model.acts.size):
            if model.acts[i]:
                out[k, at] = points[k, health + i]
                at += 1
    return out
