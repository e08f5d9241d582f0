"""The air production unit of a train: a compressor that loads and idles, a reservoir, and the compressor's oil."""

import numpy as np

from twinbench import Simulator, Variable


def rhs(x, u, theta):
    fill_bar_s, consumption_bar_s, heating_K_s = theta
    loaded = u[0]
    return np.array([fill_bar_s * loaded - consumption_bar_s, heating_K_s * loaded])


def output(x, u, theta):
    return np.array([x[0], x[1]])


def initial(u0, y0, theta):
    return np.array([y0[0], y0[1]])


TRAIN_COMPRESSOR = Simulator(
    name="train_compressor",
    says="a reservoir, filled while the compressor is loaded and drawn on always; oil that only the load heats",
    states=(
        Variable("p_bar", "bar", 0.0, 12.0, 9.0, 1.0, "gauge pressure in the reservoirs"),
        Variable("T_degC", "degC", 0.0, 120.0, 55.0, 5.0, "temperature of the oil"),
    ),
    inputs=(Variable("DV_electric", "1", 0.0, 1.0, 0.0, 0.5, "1 while the compressor is loaded"),),
    outputs=(
        Variable("reservoirs_bar", "bar", 0.0, 12.0, 9.0, 1.0, "gauge pressure in the reservoirs by the sensor"),
        Variable("T_oil_C", "degC", 0.0, 120.0, 55.0, 5.0, "temperature of the oil by its sensor"),
    ),
    parameters=(
        Variable("fill_bar_s", "bar/s", 0.0, 0.2, 0.02, 0.005, "rise of the pressure by the loaded compressor"),
        Variable("consumption_bar_s", "bar/s", 0.0, 0.02, 0.001, 0.0005, "fall of the pressure by what is consumed"),
        Variable("heating_K_s", "K/s", 0.0, 0.5, 0.03, 0.01, "rise of the oil's temperature under load"),
    ),
    rhs=rhs,
    output=output,
    initial=initial,
)
