"""Two tanks in series: a pump fills the upper, it drains into the lower, the lower drains out (Torricelli)."""

import math

import numpy as np

from twinbench import Simulator, Variable

AREA_CM2 = 154.0  # cross-section of either tank, measured
G_CM_S2 = 981.0


def flux(x, u, theta):
    pump_cm3_s_V, hole1_cm2, hole2_cm2 = theta
    between = hole1_cm2 * math.sqrt(2.0 * G_CM_S2 * max(x[0], 0.0))
    out = hole2_cm2 * math.sqrt(2.0 * G_CM_S2 * max(x[1], 0.0))
    return np.array([pump_cm3_s_V * u[0], between, out])


def balance(x, u, theta, f):
    return np.array([(f[0] - f[1]) / AREA_CM2, (f[1] - f[2]) / AREA_CM2])


def output(x, u, theta):
    return np.array([x[0], x[1]])


def initial(u0, y0, theta):
    return np.array([y0[0], y0[1]])


TANKS = Simulator(
    name="two_tanks",
    says="a pump fills an upper tank, which drains into a lower one",
    states=(
        Variable("h1_cm", "cm", 0.0, 60.0, 20.0, 8.0, "level of the upper tank"),
        Variable("h2_cm", "cm", 0.0, 60.0, 20.0, 8.0, "level of the lower tank"),
    ),
    inputs=(Variable("pump_V", "V", 0.0, 10.0, 5.0, 1.5, "voltage of the pump"),),
    outputs=(
        Variable("level1_cm", "cm", 0.0, 60.0, 20.0, 8.0, "level of the upper tank by its sensor"),
        Variable("level2_cm", "cm", 0.0, 60.0, 20.0, 8.0, "level of the lower tank by its sensor"),
    ),
    parameters=(
        Variable("pump_cm3_s_V", "cm^3/s/V", 5.0, 60.0, 20.0, 2.0, "flow of the pump per volt"),
        Variable("hole1_cm2", "cm^2", 0.1, 2.0, 0.5, 0.05, "outlet of the upper tank"),
        Variable("hole2_cm2", "cm^2", 0.1, 2.0, 0.5, 0.05, "outlet of the lower tank"),
    ),
    fluxes=(
        Variable("pumped_cm3_s", "cm^3/s", 0.0, 1000.0, 100.0, 30.0, "flow of the pump"),
        Variable("between_cm3_s", "cm^3/s", 0.0, 1000.0, 100.0, 30.0, "flow from the upper into the lower tank"),
        Variable("out_cm3_s", "cm^3/s", 0.0, 1000.0, 100.0, 30.0, "flow out of the lower tank"),
    ),
    flux=flux,
    balance=balance,
    output=output,
    initial=initial,
)
