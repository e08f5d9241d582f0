"""An oil cooler: oil and water flow past each other on two sides of a metal wall, each in two well-mixed halves."""

import numpy as np

from twinbench import Simulator, Variable

CP_OIL_J_KG_K, CP_WATER_J_KG_K = 2000.0, 4180.0
OIL_KG_S, WATER_KG_S = 0.8, 0.4  # flows at which the conductances are what the parameters say


def flux(x, u, theta):
    oil_1, oil_2, wall_1, wall_2, water_1, water_2 = x
    UA_oil_W_K, UA_water_W_K = theta[0], theta[1]
    UA_oil = UA_oil_W_K * (max(u[0], 0.0) / OIL_KG_S) ** 0.6
    UA_water = UA_water_W_K * (max(u[1], 0.0) / WATER_KG_S) ** 0.8
    return np.array(
        [
            UA_oil * (oil_1 - wall_1),
            UA_oil * (oil_2 - wall_2),
            UA_water * (wall_2 - water_1),
            UA_water * (wall_1 - water_2),
        ]
    )


def balance(x, u, theta, f):
    oil_1, oil_2, _, _, water_1, water_2 = x
    oil_kg_s, water_kg_s, T_oil_in, T_water_in = u
    _, _, M_oil_kg, M_water_kg, C_wall_J_K = theta
    C_oil, C_water = CP_OIL_J_KG_K * M_oil_kg, CP_WATER_J_KG_K * M_water_kg
    return np.array(
        [
            oil_kg_s * (T_oil_in - oil_1) / M_oil_kg - f[0] / C_oil,
            oil_kg_s * (oil_1 - oil_2) / M_oil_kg - f[1] / C_oil,
            (f[0] - f[3]) / C_wall_J_K,
            (f[1] - f[2]) / C_wall_J_K,
            water_kg_s * (T_water_in - water_1) / M_water_kg + f[2] / C_water,
            water_kg_s * (water_1 - water_2) / M_water_kg + f[3] / C_water,
        ]
    )


def output(x, u, theta):
    return np.array([x[1], x[5], x[2]])


def initial(u0, y0, theta):
    oil_out, water_out, wall = y0
    return np.array(
        [0.5 * (u0[2] + oil_out), oil_out, wall, 0.5 * (oil_out + u0[3]), 0.5 * (u0[3] + water_out), water_out]
    )


COOLER = Simulator(
    name="heat_exchanger",
    says="counterflow oil cooler, two halves a side",
    states=(
        Variable("oil_1_K", "K", 250.0, 420.0, 335.0, 8.0, "oil in the half where it enters"),
        Variable("oil_2_K", "K", 250.0, 420.0, 325.0, 8.0, "oil in the half where it leaves"),
        Variable("wall_1_K", "K", 250.0, 420.0, 322.0, 8.0, "wall where the oil enters"),
        Variable("wall_2_K", "K", 250.0, 420.0, 312.0, 8.0, "wall where the oil leaves"),
        Variable("water_1_K", "K", 250.0, 420.0, 303.0, 6.0, "water in the half where it enters"),
        Variable("water_2_K", "K", 250.0, 420.0, 313.0, 8.0, "water in the half where it leaves"),
    ),
    inputs=(
        Variable("oil_kg_s", "kg/s", 0.0, 3.0, 0.8, 0.25, "flow of the oil"),
        Variable("water_kg_s", "kg/s", 0.0, 2.0, 0.4, 0.12, "flow of the water"),
        Variable("T_oil_in_K", "K", 250.0, 420.0, 350.0, 6.0, "oil at the inlet"),
        Variable("T_water_in_K", "K", 270.0, 350.0, 290.0, 3.0, "water at the inlet"),
    ),
    outputs=(
        Variable("T_oil_out_K", "K", 250.0, 420.0, 325.0, 8.0, "oil at the outlet"),
        Variable("T_water_out_K", "K", 250.0, 420.0, 313.0, 8.0, "water at the outlet"),
        Variable("T_metal_K", "K", 250.0, 420.0, 322.0, 8.0, "thermocouple on the wall where the oil enters"),
    ),
    parameters=(
        Variable("UA_oil_W_K", "W/K", 300.0, 6000.0, 1600.0, 160.0, "conductance from oil to wall, per half"),
        Variable("UA_water_W_K", "W/K", 500.0, 10000.0, 2600.0, 260.0, "conductance from wall to water, per half"),
        Variable("M_oil_kg", "kg", 2.0, 40.0, 10.0, 1.0, "oil in one half"),
        Variable("M_water_kg", "kg", 1.0, 20.0, 5.0, 0.5, "water in one half"),
        Variable("C_wall_J_K", "J/K", 5000.0, 150000.0, 35000.0, 3500.0, "heat capacity of half the wall"),
    ),
    fluxes=(
        Variable("oil_wall_1_W", "W", -3e5, 3e5, 2e4, 1e4, "heat from oil to wall where the oil enters"),
        Variable("oil_wall_2_W", "W", -3e5, 3e5, 2e4, 1e4, "heat from oil to wall where the oil leaves"),
        Variable("wall_water_1_W", "W", -3e5, 3e5, 2e4, 1e4, "heat from wall to water where the water enters"),
        Variable("wall_water_2_W", "W", -3e5, 3e5, 2e4, 1e4, "heat from wall to water where the water leaves"),
    ),
    flux=flux,
    balance=balance,
    output=output,
    initial=initial,
)
