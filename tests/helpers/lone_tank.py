"""The least that a machine can be: one state, one input, one output, one health parameter; read every two seconds."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from twinbench.machines.loads import joined, pieces
from twinbench.machines.machine import Machine
from twinbench.machines.parts import Health, Reading
from twinbench.machines.sensors import Noise
from twinbench.physics.simulator import Simulator, Variable


@njit(cache=True, error_model="numpy")
def rhs(x, u, theta):
    """The level's rate of change (1,) in cm/s."""
    return np.array([(theta[1] * u[0] - theta[0] * theta[2] * math.sqrt(max(x[0], 0.0))) / 400.0])


@njit(cache=True, error_model="numpy")
def output(x, u, theta):
    """The level (1,) in cm."""
    return np.array([x[0]])


PLANT = Simulator(
    name="lone_tank",
    states=(Variable("level_cm", "cm", 0.0, 200.0, 40.0, 8.0),),
    inputs=(Variable("pump_V", "V", 0.0, 12.0, 6.0, 1.0),),
    outputs=(Variable("gauge_cm", "cm", 0.0, 200.0, 40.0, 0.2),),
    parameters=(
        Variable("outlet", "1", 0.3, 1.2, 1.0, 0.05),
        Variable("flow_cm3_s_V", "cm^3/s/V", 5.0, 60.0, 20.0, 2.0),
        Variable("hole", "cm^2.5/s", 1.0, 60.0, 19.0, 1.0),
    ),
    rhs=rhs,
    output=output,
    initial=lambda u0, y0, theta: np.array([y0[0]]),
)
LONE_TANK = Machine(
    name="lone_tank",
    plant=PLANT,
    reduced=PLANT,
    estimated=("level_cm",),
    health=(Health("outlet", (1.0, 0.7)),),
    readings=(Reading("gauge_cm", "level_cm"),),
    noise=(Noise("pump_V", 0.02), Noise("gauge_cm", 0.2)),
    loads=lambda seconds, lean, rng: joined(pieces(rng, seconds, (4.5, 7.5), 0.5, (60.0, 240.0), (5.0, 20.0))),
    sample_period_s=2.0,
)
