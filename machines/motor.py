"""A fan-cooled DC motor with a load, as a machine of the benchmark.

The plant has what the reduced model leaves out: dry friction, iron that saturates, magnets that weaken when warm, and a
frame that stores heat.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from twinbench.machines.coordinates import Array
from twinbench.machines.loads import joined, pieces
from twinbench.machines.machine import Drive, Machine
from twinbench.machines.parts import Health, Lag, Reading
from twinbench.machines.sensors import Drift, Noise
from twinbench.physics.places import places
from twinbench.physics.simulator import Simulator, Variable

COPPER_1_K = 0.0039
"""Rise of the winding's resistance per kelvin above 293 K."""
STATES = (
    Variable("current_A", "A", -50.0, 250.0, 40.0, 10.0, "armature current"),
    Variable("omega_rad_s", "rad/s", 0.0, 300.0, 120.0, 20.0, "shaft speed"),
    Variable("T_winding_K", "K", 230.0, 500.0, 335.0, 15.0, "winding temperature"),
    Variable("T_probe_K", "K", 230.0, 500.0, 335.0, 15.0, "temperature of the thermistor"),
    Variable("T_frame_K", "K", 230.0, 500.0, 315.0, 10.0, "temperature of the frame"),
)
INPUTS = (
    Variable("voltage_V", "V", 0.0, 300.0, 150.0, 40.0, "armature voltage"),
    Variable("load_Nm", "N m", 0.0, 120.0, 30.0, 12.0, "torque of the load"),
)
OUTPUTS = (
    Variable("speed_rad_s", "rad/s", 0.0, 300.0, 120.0, 0.5, "shaft speed by the encoder"),
    Variable("amps_A", "A", -50.0, 250.0, 40.0, 0.4, "armature current by the shunt"),
    Variable("T_wind_K", "K", 230.0, 500.0, 335.0, 0.4, "winding temperature by its thermistor"),
)
PARAMETERS = (
    Variable("flux", "1", 0.5, 1.2, 1.0, 0.02, "what is left of the magnets' flux"),
    Variable("brushes", "1", 0.5, 4.0, 1.0, 0.06, "multiplier of the armature's resistance"),
    Variable("drag", "1", 0.2, 8.0, 1.0, 0.25, "multiplier of the viscous friction"),
    Variable("cooling", "1", 0.2, 1.5, 1.0, 0.06, "multiplier of the heat that the winding gives off"),
    Variable("amps_bias_A", "A", -15.0, 15.0, 0.0, 0.7, "bias of the shunt"),
    Variable("R_ohm", "ohm", 0.2, 2.0, 0.6, 0.06, "armature resistance at 293 K"),
    Variable("L_H", "H", 0.02, 0.3, 0.08, 0.01, "armature inductance"),
    Variable("K_Nm_A", "N m/A", 0.4, 2.5, 1.0, 0.05, "motor constant"),
    Variable("J_kg_m2", "kg m^2", 0.3, 6.0, 1.5, 0.2, "inertia of rotor and load"),
    Variable("b_Nms", "N m s", 0.0, 0.5, 0.05, 0.02, "viscous friction"),
    Variable("C_J_K", "J/K", 1000.0, 20000.0, 4000.0, 600.0, "heat capacity of the winding"),
    Variable("G_W_K", "W/K", 10.0, 200.0, 60.0, 8.0, "cooling of the winding"),
    Variable("T_amb_K", "K", 250.0, 320.0, 295.0, 5.0, "temperature of the surroundings"),
    Variable("tau_probe_s", "s", 0.5, 30.0, 4.0, 1.0, "lag of the thermistor"),
    Variable("dry_Nm", "N m", 0.0, 10.0, 1.5, 0.7, "dry friction"),
    Variable("saturation", "1", 0.0, 0.3, 0.03, 0.02, "loss of flux at 60 A"),
    Variable("weakening_1_K", "1/K", 0.0, 0.005, 6e-4, 3e-4, "loss of flux per kelvin above 330 K"),
    Variable("G_frame_W_K", "W/K", 0.0, 60.0, 14.0, 6.0, "from the winding to the frame"),
    Variable("C_frame_J_K", "J/K", 500.0, 30000.0, 4500.0, 1000.0, "heat capacity of the frame"),
)
P, X, U = (places(v.name for v in group) for group in (PARAMETERS, STATES, INPUTS))


@njit(cache=True, error_model="numpy")
def rhs(x, u, theta):  # type: ignore[no-untyped-def]
    """Rates of change (5,) in the states' units per second."""
    i, w, T, frame = x[X.current_A], x[X.omega_rad_s], x[X.T_winding_K], x[X.T_frame_K]
    R = theta[P.brushes] * theta[P.R_ohm] * (1.0 + COPPER_1_K * (T - 293.0))
    iron = 1.0 - theta[P.saturation] * (i / 60.0) ** 2 / (1.0 + (i / 120.0) ** 2)
    K = theta[P.flux] * theta[P.K_Nm_A] * iron * (1.0 - theta[P.weakening_1_K] * (T - 330.0))
    friction = theta[P.drag] * theta[P.b_Nms] * w + theta[P.dry_Nm] * math.tanh(w / 2.0)
    into_frame = theta[P.G_frame_W_K] * (T - frame)
    given_off = theta[P.cooling] * theta[P.G_W_K] * (T - theta[P.T_amb_K])
    dx = np.empty(5)
    dx[X.current_A] = (u[U.voltage_V] - R * i - K * w) / theta[P.L_H]
    dx[X.omega_rad_s] = (K * i - friction - u[U.load_Nm]) / theta[P.J_kg_m2]
    dx[X.T_winding_K] = (R * i * i - given_off - into_frame) / theta[P.C_J_K]
    dx[X.T_probe_K] = (T - x[X.T_probe_K]) / theta[P.tau_probe_s]
    dx[X.T_frame_K] = (into_frame - 0.3 * theta[P.G_frame_W_K] * (frame - theta[P.T_amb_K])) / theta[P.C_frame_J_K]
    return dx


@njit(cache=True, error_model="numpy")
def output(x, u, theta):  # type: ignore[no-untyped-def]
    """Noise-free readings (3,) in the outputs' units."""
    return np.array([x[X.omega_rad_s], x[X.current_A] + theta[P.amps_bias_A], x[X.T_probe_K]])


def initial(u0: Array, y0: Array, theta: Array) -> Array:
    """As it is read, the frame between winding and surroundings.

    Args:
        u0: (2,) first inputs in their units.
        y0: (3,) first readings in their units.
        theta: (19,) in the parameters' units.
    """
    frame = theta[P.T_amb_K] + 0.7 * (y0[2] - theta[P.T_amb_K])
    return np.array([y0[1] - theta[P.amps_bias_A], y0[0], y0[2], y0[2], frame])


PLANT = Simulator(
    name="dc_motor",
    says="DC motor with brushes, a fan and a load",
    states=STATES,
    inputs=INPUTS,
    outputs=OUTPUTS,
    parameters=PARAMETERS,
    rhs=rhs,
    output=output,
    initial=initial,
)


def loads(seconds: float, lean: Array, rng: np.random.Generator) -> Drive:
    """Steps and ramps of voltage and load.

    Args:
        seconds: how long the recording lasts.
        lean: (2,) dimensionless, in [0, 1]: to which end voltage and load tend.
        rng: what they are drawn from.
    """
    voltage = pieces(rng, seconds, (110.0, 220.0), lean[0], (40.0, 180.0), (2.0, 15.0))
    load = pieces(rng, seconds, (10.0, 45.0), lean[1], (30.0, 150.0), (1.0, 10.0))
    return joined(voltage, load)


MOTOR = Machine(
    name="motor",
    says="DC motor with a load",
    plant=PLANT,
    reduced=PLANT.with_values(dry_Nm=0.0, saturation=0.0, weakening_1_K=0.0, G_frame_W_K=0.0),
    estimated=("current_A", "omega_rad_s", "T_winding_K"),
    health=(
        Health("flux", (1.0, 0.85)),
        Health("brushes", (1.0, 1.4), exponential=True),
        Health("drag", (1.0, 3.0), exponential=True),
        Health("cooling", (1.0, 0.6), exponential=True, farthest=0.25),
        Health("amps_bias_A", (-2.0, 2.0), (-4.0, 4.0), either_way=True, on_readings=True, farthest=-10.0),
    ),
    readings=(
        Reading("speed_rad_s", "omega_rad_s", key="w", says="shaft speed", reads="shaft speed"),
        Reading("amps_A", "current_A", bias="amps_bias_A", key="i", says="armature current", reads="armature current"),
        Reading(
            "T_wind_K",
            "T_probe_K",
            key="T",
            says="winding temperature in degC",
            reads="thermistor temperature in degC",
            zero=273.15,
        ),
    ),
    noise=(
        Noise("voltage_V", 0.05),
        Noise("load_Nm", 0.2),
        Noise("speed_rad_s", 0.4, 0.25, 0.3),
        Noise("amps_A", 0.3, 0.2, 0.5),
        Noise("T_wind_K", 0.3, 0.2, 4.0),
    ),
    loads=loads,
    leans=2,
    lags=(Lag("T_probe_K", "T_winding_K", "tau_probe_s"),),
    drift=Drift(("amps_A",), 0.001, 300.0),
    recalibrated=("K_Nm_A", "R_ohm", "b_Nms", "G_W_K"),
)
