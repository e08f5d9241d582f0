"""The cascaded tanks as a machine of the benchmark: its outlets and its pump are known only roughly, and may change."""

import numpy as np

from twinbench import Health, Machine, Noise, Reading, Simulator, Variable

RATE = 0.05


def rhs(x, u, theta):
    """Torricelli's law: the pump fills the upper tank, which drains into the lower, which drains out."""
    upper, lower = np.sqrt(max(x[0], 0.0)), np.sqrt(max(x[1], 0.0))
    return np.array([theta[3] * u[0] - theta[0] * upper, theta[1] * upper - theta[2] * lower])


def loads(seconds, lean, rng):
    """The pump moves to another voltage every two minutes or so."""
    knots = np.arange(0.0, seconds + 400.0, 120.0)
    volts = rng.uniform(1.5, 3.6, len(knots))
    return lambda time_s: np.interp(time_s, knots, volts)[:, None]


PLANT = Simulator(
    name="cascaded_tanks",
    says="two tanks in series that drain by Torricelli's law; levels in volts of the lower tank's sensor",
    states=(
        Variable("h1_V", "V", 0.0, 60.0, 5.0, 1.0, "level of the upper tank, which no sensor shows"),
        Variable("h2_V", "V", 0.0, 60.0, 5.0, 1.0, "level of the lower tank"),
    ),
    inputs=(Variable("u_V", "V", 0.0, 10.0, 3.0, 1.0, "voltage of the pump"),),
    outputs=(Variable("level2_V", "V", 0.0, 60.0, 5.0, 1.0, "level of the lower tank by its sensor"),),
    parameters=(
        Variable("k1", "V^0.5/s", 0.01, 0.15, RATE, 0.005, "outlet of the upper tank"),
        Variable("k2", "V^0.5/s", 0.01, 0.15, RATE, 0.005, "what of it arrives in the lower"),
        Variable("k3", "V^0.5/s", 0.01, 0.15, RATE, 0.005, "outlet of the lower tank"),
        Variable("k4", "1/s", 0.01, 0.15, RATE, 0.005, "flow of the pump per volt"),
    ),
    rhs=rhs,
    output=lambda x, u, theta: x[1:],
    initial=lambda u0, y0, theta: np.array([y0[0], y0[0]]),
)

CASCADED_TANKS = Machine(
    name="cascaded_tanks",
    plant=PLANT,
    reduced=PLANT,
    estimated=("h1_V", "h2_V"),
    health=tuple(Health(k, (0.044, 0.056), (0.04, 0.062), either_way=True) for k in ("k1", "k2", "k3", "k4")),
    readings=(Reading("level2_V", "h2_V"),),
    noise=(Noise("u_V", 0.0), Noise("level2_V", 0.03)),
    loads=loads,
    sample_period_s=4.0,
)
