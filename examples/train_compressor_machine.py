"""A train's air supply as a machine of the benchmark: a reservoir that leaks, oil that cools, and their slow wear."""

import numpy as np

from twinbench import Health, Machine, Noise, Reading, Simulator, Variable


def rhs(x, u, theta):
    """The loaded compressor fills the reservoir and heats its oil; the train draws air, and both losses go on."""
    p, T = x
    fill, consumption, leak, heating, cooling, T_amb = theta
    return np.array([fill * u[0] - consumption - leak * p, heating * u[0] - cooling * (T - T_amb)])


def loads(seconds, lean, rng):
    """The compressor loads for a minute or two and idles for half an hour, as its pressure switch has it."""
    edges, t = [], -rng.uniform(0.0, 2000.0)
    while t < seconds:
        loaded = rng.uniform(70.0, 110.0)
        edges += [t, t + loaded]
        t += loaded + rng.uniform(1500.0, 2300.0)
    return lambda time_s: (np.searchsorted(edges, time_s, side="right") % 2).astype(float)[:, None]


PLANT = Simulator(
    name="train_compressor",
    says="a reservoir, filled while the compressor is loaded; oil that the load heats and the surroundings cool",
    states=(
        Variable("p_bar", "bar", -5.0, 25.0, 9.0, 1.0, "gauge pressure in the reservoirs"),
        Variable("T_degC", "degC", 0.0, 120.0, 52.0, 3.0, "temperature of the oil"),
    ),
    inputs=(Variable("DV_electric", "1", 0.0, 1.0, 0.0, 0.5, "1 while the compressor is loaded"),),
    outputs=(
        Variable("reservoirs_bar", "bar", -5.0, 25.0, 9.0, 1.0, "gauge pressure in the reservoirs by the sensor"),
        Variable("T_oil_C", "degC", 0.0, 120.0, 52.0, 3.0, "temperature of the oil by its sensor"),
    ),
    parameters=(
        Variable("fill_bar_s", "bar/s", 0.0, 0.2, 0.025, 0.004, "rise of the pressure by the loaded compressor"),
        Variable("consumption_bar_s", "bar/s", 0.0, 0.02, 5e-4, 2e-4, "fall of the pressure by what is consumed"),
        Variable("leak_1_s", "1/s", 0.0, 1e-3, 6e-5, 2e-5, "fall of the pressure by leaks, over the pressure"),
        Variable("heating_K_s", "K/s", 0.0, 0.5, 0.045, 0.01, "rise of the oil's temperature under load"),
        Variable("cooling_1_s", "1/s", 0.0, 1e-2, 1e-4, 3e-5, "fall of the oil's temperature, over its excess"),
        Variable("T_amb_degC", "degC", -30.0, 50.0, 25.0, 5.0, "temperature of the surroundings"),
    ),
    rhs=rhs,
    output=lambda x, u, theta: x,
    initial=lambda u0, y0, theta: y0,
)

TRAIN_COMPRESSOR = Machine(
    name="train_compressor",
    plant=PLANT,
    reduced=PLANT.with_values(leak_1_s=0.0, consumption_bar_s=1e-3, cooling_1_s=0.0),
    estimated=("p_bar", "T_degC"),
    health=(
        Health("fill_bar_s", (0.03, 0.02)),
        Health("consumption_bar_s", (3e-4, 8e-4)),
        Health("heating_K_s", (0.035, 0.06)),
    ),
    readings=(Reading("reservoirs_bar", "p_bar"), Reading("T_oil_C", "T_degC")),
    noise=(Noise("DV_electric", 0.0), Noise("reservoirs_bar", 0.003), Noise("T_oil_C", 0.1)),
    loads=loads,
    start=lambda u0: np.array([9.0, 52.0]),
    sample_period_s=10.0,
)
