"""The plant: a variable-speed single-stage reciprocating air compressor, lumped.

Three single-acting cylinders (bore 160 mm, stroke 100 mm) between an intake volume behind a filter
and an exhaust volume behind a throttle. Five states of the paper (intake and exhaust pressure, gas
temperature, wall temperature, flow memory) and three that a twin does not see: temperature probe,
valve position, discharge-head metal. One function serves plant, nominal model and every mechanism
of the catalogue: an amplitude that is absent is a parameter at its neutral value.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from twinbench.physics.simulator import Array, Simulator, Variable

R_DRY = 287.05  # J/(kg K), air
GAMMA = 1.4
CP = GAMMA * R_DRY / (GAMMA - 1.0)
M_REF_KG_S = 0.12  # flow memory is delivered flow over this
N_REF_REV_S = 22.5
CV = CP - R_DRY
BAR = 1.0e5
MU_MIN = 0.02  # keeps powers of the flow finite when the machine stands still


def _constant(name: str, unit: str, value: float, scale: float, says: str) -> Variable:
    return Variable(name, unit, min(0.2 * value, value), 5.0 * value, value, scale, says)


STATES = (
    Variable("p_int_bar", "bar", 0.3, 2.0, 0.93, 0.05, "intake manifold pressure"),
    Variable("p_exh_bar", "bar", 0.8, 10.0, 3.1, 0.5, "exhaust manifold pressure"),
    Variable("T_gas_K", "K", 250.0, 700.0, 430.0, 30.0, "discharge gas temperature"),
    Variable("T_wall_K", "K", 250.0, 600.0, 355.0, 15.0, "cylinder wall temperature"),
    Variable("flow_memory", "1", 0.0, 3.0, 1.0, 0.2, "delivered flow over 0.12 kg/s"),
    Variable("T_probe_K", "K", 250.0, 700.0, 430.0, 30.0, "temperature of the discharge probe"),
    Variable("valve_pos", "1", 0.0, 1.2, 0.6, 0.2, "throttle valve position"),
    Variable("T_head_K", "K", 250.0, 700.0, 375.0, 15.0, "discharge head and line metal"),
)
INPUTS = (
    Variable("p_suc_bar", "bar", 0.5, 1.5, 0.95, 0.05, "suction pressure upstream of the filter"),
    Variable("T_suc_K", "K", 250.0, 340.0, 298.0, 5.0, "suction temperature"),
    Variable("N_rpm", "rpm", 300.0, 2400.0, 1350.0, 250.0, "shaft speed"),
    Variable("valve", "1", 0.0, 1.2, 0.64, 0.2, "throttle valve command"),
)
OUTPUTS = (
    Variable("p_dis_bar", "bar", 0.5, 10.0, 3.1, 0.01, "discharge pressure"),
    Variable("T_dis_K", "K", 250.0, 700.0, 430.0, 0.7, "discharge temperature, as the probe reads it"),
    Variable("m_flow_kg_s", "kg/s", 0.0, 0.5, 0.12, 0.001, "delivered mass flow"),
)
HEALTH = (
    Variable("capacity", "1", 0.70, 1.10, 1.0, 0.02, "flow-capacity multiplier"),
    Variable("efficiency", "1", 0.70, 1.10, 1.0, 0.02, "isentropic-efficiency multiplier"),
    Variable("leakage", "1", 1e-4, 0.15, 0.015, 0.004, "leakage coefficient of rings and valves"),
    Variable("heat_transfer", "1", 0.20, 1.50, 1.0, 0.05, "gas-to-wall heat-transfer multiplier"),
    Variable("T_bias_K", "K", -12.0, 12.0, 0.0, 0.5, "bias of the discharge-temperature sensor"),
)
CONSTANTS = (
    _constant("V_d_m3", "m3/rev", 6.03e-3, 3e-4, "swept volume"),
    _constant("clearance", "1", 0.055, 0.012, "clearance ratio"),
    _constant("n_exp", "1", 1.25, 0.03, "re-expansion exponent"),
    _constant("eta_0", "1", 0.925, 0.02, "isentropic efficiency at the design point"),
    _constant("UA_gw_W_K", "W/K", 40.0, 6.0, "gas-to-wall conductance at reference flow"),
    _constant("UA_c_W_K", "W/K", 48.0, 8.0, "wall-to-coolant conductance"),
    _constant("C_w_J_K", "J/K", 27600.0, 3000.0, "heat capacity of the cylinder wall"),
    Variable("T_c_K", "K", 270.0, 360.0, 303.0, 12.0, "coolant temperature"),
    _constant("P_f_W", "W", 900.0, 600.0, "friction heat into the wall at 1800 rpm"),
    _constant("V_int_m3", "m3", 0.12, 0.02, "intake volume"),
    _constant("a_in", "Pa s/kg", 1.0e4, 3e3, "linear loss of inlet filter and pipe"),
    _constant("b_in", "Pa s2/kg2", 1.5e5, 1.5e5, "quadratic loss of inlet filter and pipe"),
    _constant("V_exh_m3", "m3", 0.060, 0.01, "exhaust volume"),
    _constant("CdA_max_m2", "m2", 4.2e-4, 2.5e-5, "throttle area when open"),
    _constant("R_v", "1", 9.0, 1.0, "rangeability of the equal-percentage throttle"),
    _constant("tau_v_s", "s", 0.8, 0.2, "lag of the valve actuator"),
    _constant("p_head_Pa", "Pa", 1.013e5, 2e3, "pressure of the header downstream"),
    _constant("tau_m_s", "s", 0.40, 0.1, "flow memory"),
    _constant("tau_T_s", "s", 5.0, 1.0, "lag of the temperature probe at reference flow"),
    _constant("UA_ha_W_K", "W/K", 6.0, 2.0, "discharge head to ambient"),
    _constant("C_h_J_K", "J/K", 5000.0, 2000.0, "heat capacity of the discharge head"),
    Variable("T_amb_K", "K", 240.0, 330.0, 298.0, 5.0, "ambient temperature"),
)
AMPLITUDES = (
    Variable("K_s", "1", 0.0, 0.3, 0.050, 0.04, "suction-valve loss at 1800 rpm"),
    Variable("K_d", "1", 0.0, 0.3, 0.060, 0.05, "discharge-valve loss at 1800 rpm"),
    Variable("eps_0", "1", 0.0, 0.8, 0.26, 0.12, "suction preheat effectiveness"),
    Variable("eps_x", "1", 0.0, 1.0, 0.15, 0.15, "fall of the preheat with flow, exponent"),
    Variable("lam_L", "1", 0.0, 1.0, 0.6, 0.6, "share of the leak's heat that re-heats the suction gas"),
    Variable("UA_x", "1", 0.0, 1.5, 0.7, 0.7, "rise of the gas-to-wall conductance with flow, exponent"),
    Variable("eta_2", "1", 0.0, 0.05, 0.008, 0.008, "efficiency loss away from pressure ratio 2.8"),
    Variable("eta_N", "1", 0.0, 0.1, 0.02, 0.02, "efficiency loss with speed squared"),
    Variable("UA_h_W_K", "W/K", 0.0, 40.0, 9.0, 9.0, "gas to discharge-head metal"),
    Variable("tau_T_x", "1", 0.0, 1.5, 0.5, 0.5, "fall of the probe lag with flow, exponent"),
    Variable("iso", "1", 0.0, 1.0, 0.0, 1.0, "1: the exhaust volume is taken as isothermal"),
    Variable("flutter", "1", 0.0, 0.5, 0.0, 0.10, "late valve closing above 1400 rpm"),
    Variable("leak_N", "1", -1.5, 1.5, 0.0, 0.8, "leakage that depends on speed"),
    Variable("A_ext_mm2", "mm2", 0.0, 60.0, 0.0, 5.0, "external leak, packing or relief valve"),
    Variable("A_rec_mm2", "mm2", 0.0, 60.0, 0.0, 6.0, "recycle valve leaking back to the intake"),
    Variable("UA_amb_W_K", "W/K", 0.0, 60.0, 0.0, 8.0, "heat loss of the discharge line to ambient"),
    Variable("stem", "1", 0.0, 0.5, 0.0, 0.05, "stem conduction from the probe to the wall"),
    Variable("flow_gain", "1", -0.2, 0.2, 0.0, 0.02, "gain error of the flow meter"),
    Variable("pulsation", "1", 0.0, 0.1, 0.0, 0.012, "square-root error of the flow meter"),
    Variable("humidity", "1", 0.0, 0.1, 0.0, 0.012, "relative rise of the gas constant by moisture"),
    Variable("slip", "1", 0.0, 0.2, 0.0, 0.02, "motor slip at reference flow"),
)
PARAMETERS = HEALTH + CONSTANTS + AMPLITUDES


FLUXES = (
    Variable("m_in_kg_s", "kg/s", -1.0, 1.0, 0.117, 0.02, "mass flow into the intake volume"),
    Variable("m_demand_kg_s", "kg/s", 0.0, 1.0, 0.117, 0.02, "mass flow the cylinders would deliver settled"),
    Variable("m_out_kg_s", "kg/s", 0.0, 1.0, 0.117, 0.02, "mass flow through the throttle"),
    Variable("m_ext_kg_s", "kg/s", 0.0, 1.0, 0.0, 0.005, "mass flow lost to the outside"),
    Variable("m_rec_kg_s", "kg/s", 0.0, 1.0, 0.0, 0.005, "mass flow through the recycle valve"),
    Variable("T_im_K", "K", 250.0, 700.0, 298.0, 5.0, "temperature of the intake volume"),
    Variable("W_W", "W", 0.0, 1e5, 18400.0, 3000.0, "indicated shaft power"),
    Variable("Q_gw_W", "W", -1e5, 1e5, 3800.0, 800.0, "heat from the gas to the wall"),
    Variable("Q_pre_W", "W", -1e5, 1e5, 1000.0, 300.0, "heat from the wall to the suction gas"),
    Variable("Q_f_W", "W", 0.0, 1e5, 600.0, 200.0, "friction heat into the wall"),
    Variable("Q_c_W", "W", -1e5, 1e5, 2500.0, 500.0, "heat from the wall to the coolant"),
    Variable("Q_h_W", "W", -1e5, 1e5, 480.0, 200.0, "heat from the gas to the discharge head"),
    Variable("Q_ha_W", "W", -1e5, 1e5, 480.0, 100.0, "heat from the discharge head to ambient"),
    Variable("Q_amb_W", "W", -1e5, 1e5, 0.0, 500.0, "heat from the discharge line to ambient"),
)
"""What flows between the balances; a mechanism can act on any of them."""


@njit(cache=True, error_model="numpy")
def flux(x, u, theta):  # type: ignore[no-untyped-def]
    """Mass and energy flows (14,), order FLUXES; pressures in bar outside, in Pa inside."""
    p_i, p_e, T_g, T_w, v_a, T_h = x[0] * BAR, x[1] * BAR, x[2], x[3], x[6], x[7]
    mu = max(x[4], MU_MIN)
    p_s, T_s = u[0] * BAR, u[1]
    capacity, efficiency, leakage, heat_transfer = theta[0], theta[1], theta[2], theta[3]
    V_d, clearance, n_exp, eta_0, UA_gw, UA_c = theta[5], theta[6], theta[7], theta[8], theta[9], theta[10]
    T_c, P_f, a_in, b_in = theta[12], theta[13], theta[15], theta[16]
    CdA_max, R_v, p_h, UA_ha, T_amb = theta[18], theta[19], theta[21], theta[24], theta[26]
    K_s, K_d, eps_0, eps_x, lam_L, UA_x = theta[27], theta[28], theta[29], theta[30], theta[31], theta[32]
    eta_2, eta_N, UA_h, flutter, leak_N = theta[33], theta[34], theta[35], theta[38], theta[39]
    A_ext, A_rec, UA_amb, humidity, slip = theta[40], theta[41], theta[42], theta[46], theta[47]
    R = R_DRY * (1.0 + humidity)
    N = u[2] * (1.0 - slip * (mu - 1.0))
    speed_2 = (N / 1800.0) ** 2
    m = M_REF_KG_S * mu
    log_mu = math.log(mu)

    # Inlet filter and pipe: dp = a m + b m |m|.
    dp = p_s - p_i
    m_in = math.copysign((math.sqrt(a_in * a_in + 4.0 * b_in * abs(dp)) - a_in) / (2.0 * b_in), dp)

    # Leaks out of the exhaust volume, choked.
    choked = 0.6847 * p_e / math.sqrt(R * T_g) * 1e-6
    m_ext, m_rec = A_ext * choked, A_rec * choked
    T_im = T_s
    if m_rec > 0.0:
        inflow = max(m_in, 0.0)
        T_im = (inflow * T_s + m_rec * T_g) / (inflow + m_rec)

    # Suction gas: preheated by the wall, re-heated by the internal leak.
    T_pre = T_im + eps_0 * math.exp(-eps_x * log_mu) * (T_w - T_im)
    m_L = leakage * V_d * N_REF_REV_S * (p_e - p_i) / (R * T_g) * (1.0 + leak_N * (N / 1350.0 - 1.0))
    T_1 = T_pre + lam_L * m_L / (m + m_L) * (T_g - T_pre)

    # Valve losses, volumetric efficiency, demanded flow.
    psi_s = min(K_s * speed_2 * 300.0 / T_1, 0.4)
    psi_d = K_d * speed_2 * 450.0 / T_g
    ratio = p_e * (1.0 + psi_d) / (p_i * (1.0 - psi_s))
    log_ratio = math.log(max(ratio, 1e-3))
    eta_v = 1.0 - clearance * (math.exp(log_ratio / n_exp) - 1.0) - flutter * max(0.0, N / 1400.0 - 1.0)
    drawn = capacity * p_i * (1.0 - psi_s) / (R * T_1) * V_d * N / 60.0 * max(eta_v, 0.05)

    # Compression and heat given to the wall.
    eta = max(efficiency * (eta_0 - eta_2 * (ratio - 2.8) ** 2 - eta_N * speed_2), 0.3)
    T_d = T_1 * (1.0 + (math.exp(log_ratio * (GAMMA - 1.0) / GAMMA) - 1.0) / eta)
    kept = math.exp(-heat_transfer * UA_gw * math.exp(UA_x * log_mu) / (m * CP))

    # Throttle to the header.
    r = p_h / p_e
    if r < 0.5283:
        phi = 0.6847
    elif r < 1.0:
        phi = math.sqrt(2.0 * GAMMA / (GAMMA - 1.0) * (r ** (2.0 / GAMMA) - r ** ((GAMMA + 1.0) / GAMMA)))
    else:
        phi = 0.0

    f = np.empty(14)
    f[0] = m_in
    f[1] = max(drawn - m_L, 1e-3)
    f[2] = CdA_max * R_v ** (v_a - 1.0) * p_e / math.sqrt(R * T_g) * phi
    f[3] = m_ext
    f[4] = m_rec
    f[5] = T_im
    f[6] = m * CP * (T_d - T_pre)
    f[7] = m * CP * (T_d - T_w) * (1.0 - kept)
    f[8] = m * CP * (T_pre - T_im)
    f[9] = P_f * speed_2**0.75
    f[10] = UA_c * (T_w - T_c)
    f[11] = UA_h * (T_g - T_h)
    f[12] = UA_ha * (T_h - T_amb)
    f[13] = UA_amb * (T_g - T_amb)
    return f


@njit(cache=True, error_model="numpy")
def balance(x, u, theta, f):  # type: ignore[no-untyped-def]
    """Rates of change (8,) from the flows: exact open-system balances of the exhaust volume."""
    p_e, T_g, v = x[1] * BAR, x[2], u[3]
    mu = max(x[4], MU_MIN)
    C_w, V_i, V_e, tau_v, tau_m = theta[11], theta[14], theta[17], theta[20], theta[22]
    tau_T, C_h, tau_T_x, iso = theta[23], theta[25], theta[36], theta[37]
    R = R_DRY * (1.0 + theta[46])
    m = M_REF_KG_S * mu
    m_in, m_demand, m_out, m_ext, m_rec, T_im, W = f[0], f[1], f[2], f[3], f[4], f[5], f[6]
    Q_gw, Q_pre, Q_f, Q_c, Q_h, Q_ha, Q_amb = f[7], f[8], f[9], f[10], f[11], f[12], f[13]
    m_off = m_out + m_ext + m_rec
    enthalpy_in = m * CP * T_im + Q_pre + W - Q_gw
    net = enthalpy_in - m_off * CP * T_g - Q_h - Q_amb
    dp_exact = net * R / (V_e * CV)
    dp_isothermal = R * T_g / V_e * (m - m_off)

    dx = np.empty(8)
    dx[0] = R * T_im / V_i * (m_in - m + m_rec) / BAR
    dx[1] = (dp_exact + iso * (dp_isothermal - dp_exact)) / BAR
    dx[2] = R * T_g / (p_e * V_e * CV) * (net - (m - m_off) * CV * T_g)
    dx[3] = (Q_gw + Q_f - Q_pre - Q_c) / C_w
    dx[4] = (m_demand / M_REF_KG_S - mu) / tau_m
    dx[5] = (T_g - x[5]) / (tau_T * math.exp(-tau_T_x * math.log(mu)))
    dx[6] = (v - x[6]) / tau_v
    dx[7] = (Q_h - Q_ha) / C_h
    return dx


def rhs(x: Array, u: Array, theta: Array) -> Array:
    """Mass and energy balances of the lumped machine.

    Args:
        x: (8,) in the states' units, order STATES.
        u: (4,) in the inputs' units, order INPUTS.
        theta: (48,) in the parameters' units, order PARAMETERS.
    """
    return balance(x, u, theta, flux(x, u, theta))


def output(x: Array, u: Array, theta: Array) -> Array:
    """What the sensors read, before noise.

    Args:
        x: (8,) in the states' units, order STATES.
        u: (4,) in the inputs' units, order INPUTS.
        theta: (48,) in the parameters' units, order PARAMETERS.
    """
    stem, gain, pulsation = theta[43], theta[44], theta[45]
    mu = max(x[4], MU_MIN)
    y = np.empty(3)
    y[0] = x[1]
    y[1] = x[5] - stem * (x[5] - x[3]) + theta[4]
    y[2] = M_REF_KG_S * mu * (1.0 + gain) * (1.0 + pulsation / mu)
    return y


def initial(u0: Array, y0: Array, theta: Array) -> Array:
    """A warm machine at the first reading.

    Args:
        u0: (4,) first inputs in their units, order INPUTS.
        y0: (3,) first readings in their units, order OUTPUTS.
        theta: (48,) in the parameters' units, order PARAMETERS.
    """
    T_g = y0[1] - theta[4]
    mu = max(y0[2] / M_REF_KG_S, 0.05)
    T_w = theta[12] + 0.35 * (T_g - theta[12])
    T_h = theta[26] + 0.6 * (T_g - theta[26])
    return np.array([0.985 * u0[0], y0[0], T_g, T_w, mu, T_g, u0[3], T_h])


PLANT = Simulator(
    name="compressor",
    states=STATES,
    inputs=INPUTS,
    outputs=OUTPUTS,
    parameters=PARAMETERS,
    rhs=rhs,
    output=output,
    initial=initial,
    fluxes=FLUXES,
    flux=flux,
    balance=balance,
    calibrate=("V_d_m3", "eta_0", "UA_gw_W_K"),
    drifts=tuple(v.name for v in HEALTH),
    says="variable-speed single-stage reciprocating air compressor: the benchmark's plant",
)
