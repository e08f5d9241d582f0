"""A perceptron that answers for one tick of the machine: what it reads of a transition, and how it is built.

The filters whose model is such a network, or has one beside its equations, train it on the same counterfactual
transitions and let it read the same: states, inputs, actuators and the health coordinates that act on the machine.
"""

from __future__ import annotations

import numpy as np
from torch import nn

from twinbench.baselines.layout import acting, actuators
from twinbench.data.batch import Array, Batch
from twinbench.machines.coordinates import ZETA_SCALE
from twinbench.machines.machine import Machine
from twinbench.methods.transitions import Transitions


def network_input(batch: Batch, moves: Transitions) -> Array:
    """What the network reads of transitions, (M, F)."""
    assert batch.truth is not None
    at = (moves.sequence, moves.sample)
    columns, _ = actuators(batch.machine)
    return read_of(batch.machine, moves.x, batch.truth.inputs[at], batch.truth.states[at][:, columns], moves.theta)


def read_of(machine: Machine, x: Array, u: Array, follow: Array, theta: Array) -> Array:
    """What the network reads, (M, F): states, inputs, actuators, health coordinates that act, each in its unit.

    Args:
        machine: whose.
        x: (M, n) estimated states in their units.
        u: (M, nu) inputs in their units.
        follow: (M, a) what follows an input by a lag, in its unit.
        theta: (M, nh) health in its units.
    """
    return np.concatenate([x, u, follow, machine.coordinates.to_zeta(theta)[:, acting(machine)]], axis=1)


def standard(machine: Machine, read: Array) -> tuple[Array, Array]:
    """Mean and scale (F,) that the network's inputs are standardised by.

    Args:
        machine: whose.
        read: (M, F) as ``read_of`` gives it, each in its unit.
    """
    mean, scale = read.mean(axis=0), read.std(axis=0).clip(1e-9)
    health = slice(len(mean) - int(acting(machine).sum()), None)
    mean[health], scale[health] = 0.0, ZETA_SCALE
    return mean, scale


def perceptron(inputs: int, width: int, outputs: int) -> nn.Sequential:
    """Two hidden layers of that width, smooth everywhere."""
    return nn.Sequential(
        nn.Linear(inputs, width), nn.SiLU(), nn.Linear(width, width), nn.SiLU(), nn.Linear(width, outputs)
    )
