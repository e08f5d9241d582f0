"""Two tanks in series, as a machine of the benchmark: a pump fills the upper, that drains into the lower, that out.

The plant has what the reduced model leaves out: a pump that gives less per volt the faster it runs, outlets whose jet
contracts less at a low level, and walls that lean outwards.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from twinbench.machines.coordinates import Array
from twinbench.machines.loads import joined, pieces
from twinbench.machines.machine import Drive, Machine
from twinbench.machines.parts import Health, Lag, Reading
from twinbench.machines.sensors import Noise
from twinbench.physics.places import places
from twinbench.physics.simulator import Simulator, Variable

G_CM_S2 = 981.0
MID_CM = 20.0
"""The level about which walls lean and jets contract."""
STATES = (
    Variable("h1_cm", "cm", 0.0, 90.0, 20.0, 4.0, "level of the upper tank"),
    Variable("h2_cm", "cm", 0.0, 90.0, 20.0, 4.0, "level of the lower tank"),
    Variable("pump_acting_V", "V", 0.0, 12.0, 5.0, 1.0, "voltage that the pump's speed has followed"),
)
INPUTS = (
    Variable("pump_V", "V", 0.0, 12.0, 5.0, 1.5, "voltage of the pump"),
    Variable("valve", "1", 0.05, 1.2, 0.8, 0.15, "opening of the lower tank's outlet"),
)
OUTPUTS = (
    Variable("level1_cm", "cm", 0.0, 90.0, 20.0, 0.1, "level of the upper tank by its sensor"),
    Variable("level2_cm", "cm", 0.0, 90.0, 20.0, 0.1, "level of the lower tank by its sensor"),
)
PARAMETERS = (
    Variable("pump", "1", 0.4, 1.2, 1.0, 0.03, "what the pump still gives"),
    Variable("outlet1", "1", 0.3, 1.2, 1.0, 0.05, "what the upper outlet still lets through"),
    Variable("outlet2", "1", 0.3, 1.2, 1.0, 0.05, "what the lower outlet still lets through"),
    Variable("leak_cm2", "cm^2", 1e-4, 0.5, 0.01, 0.006, "hole of the upper tank to the outside"),
    Variable("bias2_cm", "cm", -8.0, 8.0, 0.0, 0.4, "bias of the lower level's sensor"),
    Variable("flow_cm3_s_V", "cm^3/s/V", 5.0, 60.0, 22.0, 2.0, "flow of the pump per volt"),
    Variable("hole1_cm2", "cm^2", 0.1, 2.0, 0.50, 0.05, "outlet of the upper tank"),
    Variable("hole2_cm2", "cm^2", 0.1, 2.0, 0.75, 0.05, "outlet of the lower tank when open"),
    Variable("area_cm2", "cm^2", 50.0, 500.0, 154.0, 8.0, "cross-section of either tank at mid level"),
    Variable("tau_pump_s", "s", 0.2, 10.0, 1.5, 0.3, "lag of the pump"),
    Variable("fade_1_V", "1/V", 0.0, 0.06, 0.018, 0.01, "what the pump gives less per volt"),
    Variable("contraction", "1", 0.0, 0.5, 0.10, 0.05, "how much wider a jet is at no level than at mid level"),
    Variable("lean", "1", 0.0, 0.5, 0.08, 0.05, "how much wider a tank is at mid level than at its bottom"),
)
P, X, U = (places(v.name for v in group) for group in (PARAMETERS, STATES, INPUTS))


@njit(cache=True, error_model="numpy")
def rhs(x, u, theta):  # type: ignore[no-untyped-def]
    """Rates of change (3,) in the states' units per second."""
    h1, h2, volts = max(x[X.h1_cm], 0.0), max(x[X.h2_cm], 0.0), x[X.pump_acting_V]
    jet1 = 1.0 + theta[P.contraction] * (1.0 - h1 / MID_CM)
    jet2 = 1.0 + theta[P.contraction] * (1.0 - h2 / MID_CM)
    pumped = theta[P.pump] * theta[P.flow_cm3_s_V] * volts * (1.0 - theta[P.fade_1_V] * volts)
    speed1, speed2 = math.sqrt(2.0 * G_CM_S2 * h1), math.sqrt(2.0 * G_CM_S2 * h2)
    between = theta[P.outlet1] * theta[P.hole1_cm2] * jet1 * speed1
    out = theta[P.outlet2] * theta[P.hole2_cm2] * u[U.valve] * jet2 * speed2
    area1 = theta[P.area_cm2] * (1.0 + theta[P.lean] * (h1 / MID_CM - 1.0))
    area2 = theta[P.area_cm2] * (1.0 + theta[P.lean] * (h2 / MID_CM - 1.0))
    dx = np.empty(3)
    dx[X.h1_cm] = (pumped - between - theta[P.leak_cm2] * speed1) / area1
    dx[X.h2_cm] = (between - out) / area2
    dx[X.pump_acting_V] = (u[U.pump_V] - volts) / theta[P.tau_pump_s]
    return dx


@njit(cache=True, error_model="numpy")
def output(x, u, theta):  # type: ignore[no-untyped-def]
    """Noise-free readings (2,) in the outputs' units."""
    return np.array([x[X.h1_cm], x[X.h2_cm] + theta[P.bias2_cm]])


def initial(u0: Array, y0: Array, theta: Array) -> Array:
    """Levels as they are read, a pump that has settled.

    Args:
        u0: (2,) first inputs in their units.
        y0: (2,) first readings in their units.
        theta: (13,) in the parameters' units.
    """
    return np.array([y0[0], y0[1] - theta[P.bias2_cm], u0[U.pump_V]])


PLANT = Simulator(
    name="two_tanks",
    says="a pump fills an upper tank, which drains into a lower one, which drains through a valve",
    states=STATES,
    inputs=INPUTS,
    outputs=OUTPUTS,
    parameters=PARAMETERS,
    rhs=rhs,
    output=output,
    initial=initial,
)


def loads(seconds: float, lean: Array, rng: np.random.Generator) -> Drive:
    """Steps and ramps of the pump and the valve.

    Args:
        seconds: how long the recording lasts.
        lean: (2,) dimensionless, in [0, 1]: to which end pump and valve tend.
        rng: what they are drawn from.
    """
    pump = pieces(rng, seconds, (3.2, 6.8), lean[0], (40.0, 180.0), (2.0, 20.0))
    valve = pieces(rng, seconds, (0.65, 0.95), lean[1], (60.0, 240.0), (2.0, 20.0))
    return joined(pump, valve)


TWO_TANKS = Machine(
    name="two_tanks",
    says="two tanks in series",
    plant=PLANT,
    reduced=PLANT.with_values(fade_1_V=0.0, contraction=0.0, lean=0.0),
    estimated=("h1_cm", "h2_cm"),
    health=(
        Health("pump", (1.0, 0.8)),
        Health("outlet1", (1.0, 0.7)),
        Health("outlet2", (1.0, 0.7)),
        Health("leak_cm2", (0.01, 0.06), exponential=True, farthest=0.001),
        Health("bias2_cm", (-1.0, 1.0), (-2.0, 2.0), either_way=True, on_readings=True, farthest=-6.0),
    ),
    readings=(
        Reading("level1_cm", "h1_cm", key="h1", says="upper level", reads="upper level"),
        Reading("level2_cm", "h2_cm", bias="bias2_cm", key="h2", says="lower level", reads="lower level"),
    ),
    noise=(
        Noise("pump_V", 0.02),
        Noise("valve", 0.0),
        Noise("level1_cm", 0.12, 0.08, 2.0),
        Noise("level2_cm", 0.12, 0.08, 2.0),
    ),
    loads=loads,
    leans=2,
    lags=(Lag("pump_acting_V", "pump_V", "tau_pump_s"),),
    recalibrated=("flow_cm3_s_V", "hole1_cm2", "hole2_cm2", "area_cm2"),
    sample_period_s=0.2,
)
