"""The twin of a network: a ``Simulator`` whose equations are read off its links."""

from __future__ import annotations

import functools
import json
from collections.abc import Mapping
from typing import Any

import numpy as np

from twinbench.physics.simulator import Array, Equation, Simulator
from twinbench.proof.lumped.network import CONDUCTANCE, ORIFICE, RESISTANCE, SOURCE, SPRING, Network, tables

LUMPED = "lumped"
"""What a case calls the simulator that its network describes."""
NEWTON_STEPS = 30
_SHORTEST = 1.0 / 64.0  # of a Newton step: one that helps only if it is shorter still is taken anyway


def twin(network: Network) -> Simulator:
    """The simulator of a network; the same network gives the same simulator, compiled once."""
    return _twin(json.dumps(network.to_json(), sort_keys=True))


def twin_of(given: Mapping[str, Any]) -> Simulator:
    """The simulator of a network that ``Network.to_json`` wrote down."""
    return twin(Network.from_json(given))


@functools.cache
def _twin(text: str) -> Simulator:
    network = Network.from_json(json.loads(text))
    read = tables(network).read

    def output(x: Array, u: Array, theta: Array) -> Array:
        y = np.empty(read.size)
        for i in range(read.size):
            y[i] = x[read[i]]
        return y

    rhs = _rhs(network)
    return Simulator(
        name=network.name,
        says=network.says,
        states=network.states,
        inputs=network.inputs,
        outputs=network.outputs,
        parameters=network.parameters,
        rhs=rhs,
        output=output,
        initial=_initial(network, rhs),
        calibrate=tuple(v.name for v in network.parameters if v.name not in network.known),
    )


def _rhs(network: Network) -> Equation:
    kind, a, b, k, own, knee, store, _ = tables(network)
    n, nu = len(network.states), len(network.inputs)

    def rhs(x: Array, u: Array, theta: Array) -> Array:
        dx = np.zeros(n)
        for j in range(kind.size):
            ends = np.zeros(2)
            for e in range(2):
                i = a[j] if e == 0 else b[j]
                if i >= n + nu:
                    ends[e] = theta[i - n - nu]
                elif i >= n:
                    ends[e] = u[i - n]
                elif i >= 0:
                    ends[e] = x[i]
            d = ends[0] - ends[1]
            size = theta[k[j]] if k[j] >= 0 else 1.0
            if kind[j] == CONDUCTANCE:
                flow = size * d
            elif kind[j] == RESISTANCE:
                flow = d / size
            elif kind[j] == ORIFICE:
                flow = size * d / (d * d + knee[j] * knee[j]) ** 0.25
            elif kind[j] == SOURCE:
                flow = size * ends[0]
            elif kind[j] == SPRING:
                flow = size * x[own[j]]
                dx[own[j]] += d
            else:
                flow = x[own[j]]
                dx[own[j]] += d - size * x[own[j]]
            if 0 <= a[j] < n:
                dx[a[j]] -= flow
            if 0 <= b[j] < n:
                dx[b[j]] += flow
        for i in range(n):
            if store[i] >= 0:
                dx[i] /= theta[store[i]]
        return dx

    return rhs


def _initial(network: Network, rhs: Equation) -> Equation:
    """The steady state under the first inputs; what a sensor reads, as it reads it."""
    read = tables(network).read
    nominal, scale = (np.array([getattr(v, name) for v in network.states]) for name in ("nominal", "scale"))

    def initial(u0: Array, y0: Array, theta: Array) -> Array:
        x = nominal.copy()
        x[read] = y0
        free = np.setdiff1d(np.arange(x.size), read)
        x[free] = steady(rhs, u0, theta, nominal, scale)[free]
        return x

    return initial


def steady(rhs: Equation, u: Array, theta: Array, x0: Array, scale: Array) -> Array:
    """The state (nx,) that does not change under inputs u, by Newton's method from x0.

    Args:
        rhs: rates of change.
        u: (nu,) inputs in their units.
        theta: (np,) parameters, each in its unit.
        x0: (nx,) each state in its unit.
        scale: (nx,) a typical change of each, likewise.
    """
    x = x0.copy()
    rate = rhs(x, u, theta)
    for _ in range(NEWTON_STEPS):
        slope = np.stack([(rhs(x + s, u, theta) - rate) / s.sum() for s in np.diag(1e-6 * scale)], axis=-1)
        move, share = -np.linalg.lstsq(slope, rate, rcond=None)[0], 1.0
        while share > _SHORTEST and _size(rhs(x + share * move, u, theta), scale) >= _size(rate, scale):
            share /= 2.0
        x = x + share * move
        rate = rhs(x, u, theta)
        if (np.abs(move) < 1e-9 * scale).all():
            break
    return x


def _size(rate: Array, scale: Array) -> float:
    return float(np.linalg.norm(rate / scale))
