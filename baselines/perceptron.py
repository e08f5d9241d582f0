"""A perceptron that answers for one tick of the machine: what it reads of a transition, and how it is built.

The filters whose model is such a network, or has one beside its equations, train it on the same counterfactual
transitions and let it read the same: states, inputs, valve position and the health coordinates that act on the machine.
"""

from __future__ import annotations

import numpy as np
from torch import nn

from twinbench.data.batch import HEALTH, Array, Batch
from twinbench.methods.transitions import Transitions
from twinbench.physics.compressor import X
from twinbench.physics.health import ZETA_SCALE, to_zeta

N_ACTING = len(HEALTH) - 1  # the sensor's bias does not act on the machine


def network_input(batch: Batch, moves: Transitions) -> Array:
    """(M, 14) of transitions: states, inputs, valve position, health coordinates, each in its unit."""
    assert batch.truth is not None
    at = (moves.sequence, moves.sample)
    return read_of(moves.x, batch.truth.inputs[at], batch.truth.states[*at, X.valve_pos], moves.theta)


def read_of(x: Array, u: Array, valve: Array, theta: Array) -> Array:
    """What the network reads, (M, 14).

    Args:
        x: (M, 5) states in their units, order STATES.
        u: (M, 4) inputs in their units, order INPUTS.
        valve: (M,) the valve's position, dimensionless.
        theta: (M, 5) health in its units, order HEALTH.
    """
    return np.concatenate([x, u, valve[:, None], to_zeta(theta)[:, :N_ACTING]], axis=1)


def standard(read: Array) -> tuple[Array, Array]:
    """Mean and scale (14,) that the network's inputs are standardised by.

    Args:
        read: (M, 14) as ``network_input`` gives it, each in its unit.
    """
    mean, scale = read.mean(axis=0), read.std(axis=0)
    mean[-N_ACTING:], scale[-N_ACTING:] = 0.0, ZETA_SCALE
    return mean, scale


def perceptron(inputs: int, width: int, outputs: int) -> nn.Sequential:
    """Two hidden layers of that width, smooth everywhere."""
    return nn.Sequential(
        nn.Linear(inputs, width), nn.SiLU(), nn.Linear(width, width), nn.SiLU(), nn.Linear(width, outputs)
    )
