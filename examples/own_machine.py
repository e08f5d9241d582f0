"""A stirred tank with an electric heater, through which water flows: the heater wears, the jacket loses more heat."""

import numpy as np

from twinbench import Health, Lag, Machine, Noise, Reading, Simulator, Variable

WATER_J_KG_K, T_IN_K, T_ROOM_K = 4186.0, 288.0, 293.0


def rhs(x, u, theta):
    """Rates of the two temperatures in K/s; theta stands in the order of the parameters below."""
    lost = theta[1] * (x[0] - T_ROOM_K) * (1.0 + theta[4] * (x[0] - T_ROOM_K))
    gained = theta[0] * u[0] - u[1] * WATER_J_KG_K * (x[0] - T_IN_K)
    return np.array([(gained - lost) / (theta[2] * WATER_J_KG_K), (x[0] - x[1]) / theta[3]])


PLANT = Simulator(
    name="stirred_tank",
    states=(
        Variable("T_tank_K", "K", 270.0, 400.0, 310.0, 4.0, "temperature of the tank"),
        Variable("T_probe_K", "K", 270.0, 400.0, 310.0, 4.0, "temperature of the probe"),
    ),
    inputs=(
        Variable("power_W", "W", 0.0, 9000.0, 4500.0, 1000.0, "power of the heater"),
        Variable("flow_kg_s", "kg/s", 0.0, 0.2, 0.045, 0.01, "flow through the tank"),
    ),
    outputs=(Variable("T_out_K", "K", 270.0, 400.0, 310.0, 0.2, "temperature as the probe reads it"),),
    parameters=(
        Variable("heater", "1", 0.3, 1.2, 1.0, 0.03, "share of its power that the heater still gives"),
        Variable("loss_W_K", "W/K", 1.0, 200.0, 20.0, 4.0, "heat loss to the room"),
        Variable("mass_kg", "kg", 0.5, 10.0, 2.0, 0.2, "water in the tank"),
        Variable("tau_s", "s", 0.5, 60.0, 5.0, 1.0, "lag of the probe"),
        Variable("convection_1_K", "1/K", 0.0, 0.05, 0.008, 0.004, "rise of the heat loss with temperature"),
    ),
    rhs=rhs,
    output=lambda x, u, theta: x[1:],
    initial=lambda u0, y0, theta: np.array([y0[0], y0[0]]),
)


def loads(seconds, lean, rng):
    """Power and flow move to another value each minute."""
    knots = np.arange(0.0, seconds + 120.0, 60.0)
    power, flow = rng.uniform(2500.0, 6500.0, len(knots)), rng.uniform(0.03, 0.06, len(knots))
    return lambda time_s: np.stack([np.interp(time_s, knots, power), np.interp(time_s, knots, flow)], axis=-1)


MACHINE = Machine(
    name="stirred_tank",
    plant=PLANT,
    reduced=PLANT.with_values(convection_1_K=0.0),
    estimated=("T_tank_K",),
    health=(Health("heater", (1.0, 0.75)), Health("loss_W_K", (20.0, 60.0), exponential=True)),
    readings=(Reading("T_out_K", "T_probe_K"),),
    noise=(Noise("power_W", 10.0), Noise("flow_kg_s", 3e-4), Noise("T_out_K", 0.15, 0.1, 4.0)),
    loads=loads,
    lags=(Lag("T_probe_K", "T_tank_K", "tau_s"),),
    sample_period_s=0.5,
)
