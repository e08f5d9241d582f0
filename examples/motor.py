"""A DC motor with a fan-cooled frame, driving a load through viscous friction."""

import numpy as np

from twinbench import Simulator, Variable

COPPER_1_K = 0.0039  # rise of the winding's resistance


def rhs(x, u, theta):
    current, omega, winding = x
    voltage, load = u
    R_ohm, L_H, K_Nm_A, J_kg_m2, b_Nms, C_J_K, G_W_K, T_amb_K = theta
    R = R_ohm * (1.0 + COPPER_1_K * (winding - 293.0))
    return np.array(
        [
            (voltage - R * current - K_Nm_A * omega) / L_H,
            (K_Nm_A * current - b_Nms * omega - load) / J_kg_m2,
            (R * current**2 - G_W_K * (winding - T_amb_K)) / C_J_K,
        ]
    )


def output(x, u, theta):
    return np.array([x[1], x[0], x[2]])


def initial(u0, y0, theta):
    return np.array([y0[1], y0[0], y0[2]])


MOTOR = Simulator(
    name="motor",
    says="DC motor driving a load through viscous friction",
    states=(
        Variable("current_A", "A", -200.0, 200.0, 40.0, 20.0, "armature current"),
        Variable("omega_rad_s", "rad/s", -300.0, 300.0, 120.0, 40.0, "shaft speed"),
        Variable("T_winding_K", "K", 230.0, 450.0, 330.0, 20.0, "winding temperature"),
    ),
    inputs=(
        Variable("voltage_V", "V", -300.0, 300.0, 150.0, 50.0, "armature voltage"),
        Variable("load_Nm", "N m", -100.0, 200.0, 30.0, 15.0, "torque of the load"),
    ),
    outputs=(
        Variable("speed_rad_s", "rad/s", -300.0, 300.0, 120.0, 40.0, "shaft speed by the encoder"),
        Variable("amps_A", "A", -200.0, 200.0, 40.0, 20.0, "armature current by the shunt"),
        Variable("T_probe_K", "K", 230.0, 450.0, 330.0, 20.0, "winding temperature by its thermistor"),
    ),
    parameters=(
        Variable("R_ohm", "ohm", 0.2, 2.0, 0.6, 0.06, "armature resistance at 293 K"),
        Variable("L_H", "H", 0.02, 0.3, 0.08, 0.01, "armature inductance"),
        Variable("K_Nm_A", "N m/A", 0.4, 2.5, 1.0, 0.05, "motor constant"),
        Variable("J_kg_m2", "kg m^2", 0.3, 6.0, 1.5, 0.2, "inertia of rotor and load"),
        Variable("b_Nms", "N m s", 0.0, 0.5, 0.05, 0.02, "viscous friction"),
        Variable("C_J_K", "J/K", 1000.0, 20000.0, 4000.0, 600.0, "heat capacity of the winding"),
        Variable("G_W_K", "W/K", 5.0, 100.0, 25.0, 4.0, "cooling of the winding"),
        Variable("T_amb_K", "K", 250.0, 320.0, 295.0, 5.0, "temperature of the surroundings"),
    ),
    rhs=rhs,
    output=output,
    initial=initial,
)
