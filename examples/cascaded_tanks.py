"""Two cascaded tanks as a textbook has them: a pump fills the upper, which drains into the lower, which drains out."""

import math

import numpy as np

from twinbench import Simulator, Variable


def rhs(x, u, theta):
    k1, k2, k3, k4 = theta
    upper, lower = math.sqrt(max(x[0], 0.0)), math.sqrt(max(x[1], 0.0))
    return np.array([k4 * u[0] - k1 * upper, k2 * upper - k3 * lower])


def output(x, u, theta):
    return np.array([x[1]])


def initial(u0, y0, theta):
    return np.array([y0[0], y0[0]])


CASCADED_TANKS = Simulator(
    name="cascaded_tanks",
    says="two tanks in series that drain by Torricelli's law; levels in volts of the lower tank's sensor",
    states=(
        Variable("h1_V", "V", 0.0, 15.0, 5.0, 2.0, "level of the upper tank, which no sensor shows"),
        Variable("h2_V", "V", 0.0, 15.0, 5.0, 2.0, "level of the lower tank"),
    ),
    inputs=(Variable("u_V", "V", 0.0, 10.0, 3.0, 1.0, "voltage of the pump"),),
    outputs=(Variable("level2_V", "V", 0.0, 10.0, 5.0, 2.0, "level of the lower tank by its sensor"),),
    parameters=(
        Variable("k1", "V^0.5/s", 0.0, 1.0, 0.05, 0.02, "outlet of the upper tank"),
        Variable("k2", "V^0.5/s", 0.0, 1.0, 0.05, 0.02, "what of it arrives in the lower"),
        Variable("k3", "V^0.5/s", 0.0, 1.0, 0.05, 0.02, "outlet of the lower tank"),
        Variable("k4", "1/s", 0.0, 1.0, 0.05, 0.02, "flow of the pump per volt"),
    ),
    rhs=rhs,
    output=output,
    initial=initial,
)
