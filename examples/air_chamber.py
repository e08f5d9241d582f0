"""A closed chamber of compressed air that is left alone and loses pressure at a constant rate."""

import numpy as np

from twinbench import Simulator, Variable


def rhs(x, u, theta):
    return np.array([-theta[0]])


def output(x, u, theta):
    return np.array([x[0]])


def initial(u0, y0, theta):
    return np.array([y0[0]])


AIR_CHAMBER = Simulator(
    name="air_chamber",
    says="a closed chamber of compressed air with a constant leak",
    states=(Variable("p_bar", "bar", 0.0, 10.0, 5.0, 2.0, "gauge pressure in the chamber"),),
    inputs=(),
    outputs=(Variable("p_gauge_bar", "bar", 0.0, 10.0, 5.0, 2.0, "gauge pressure by the sensor"),),
    parameters=(Variable("k_bar_s", "bar/s", 0.0, 1.0, 0.01, 0.02, "leak"),),
    rhs=rhs,
    output=output,
    initial=initial,
)
