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
from numba.extending import register_jitable

from twinbench.physics.places import places
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
    Variable("iso", "1", 0.0, 1.0, 0.0, 1.0, "exhaust volume: 0 if it is adiabatic, 1 if it is isothermal"),
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
P, X, U, Y, F = (places(v.name for v in group) for group in (PARAMETERS, STATES, INPUTS, OUTPUTS, FLUXES))
"""Where parameters, states, inputs, outputs and fluxes stand in their vectors, by name."""


# Helpers stay callable in plain Python, where ``bench.latency.peers`` takes the equations as they are written.
@register_jitable(error_model="numpy", inline="always")
def _filter_flow(dp, theta):  # type: ignore[no-untyped-def]
    """Mass flow through inlet filter and pipe under a pressure difference in Pa: dp = a m + b m |m|."""
    a, b = theta[P.a_in], theta[P.b_in]
    return math.copysign((math.sqrt(a * a + 4.0 * b * abs(dp)) - a) / (2.0 * b), dp)


@register_jitable(error_model="numpy", inline="always")
def _mixed_K(m_in, m, T_s, m_rec, T_g):  # type: ignore[no-untyped-def]
    """Temperature of the intake volume: fresh gas, and what the recycle valve lets back.

    The fresh gas is at least half of what the machine draws besides: the intake is quick, and an integrator that steps
    over it may let it flow backwards for an instant.
    """
    if m_rec > 0.0:
        inflow = max(m_in, 0.5 * (m - m_rec), 0.0)
        return (inflow * T_s + m_rec * T_g) / (inflow + m_rec)
    return T_s


@register_jitable(error_model="numpy", inline="always")
def _outflow_factor(r):  # type: ignore[no-untyped-def]
    """Flow function of the throttle at header pressure over exhaust pressure: choked, subsonic, none."""
    if r < 0.5283:
        return 0.6847
    if r < 1.0:
        return math.sqrt(2.0 * GAMMA / (GAMMA - 1.0) * (r ** (2.0 / GAMMA) - r ** ((GAMMA + 1.0) / GAMMA)))
    return 0.0


@njit(cache=True, error_model="numpy")
def flux(x, u, theta):  # type: ignore[no-untyped-def]
    """Mass and energy flows (14,), order FLUXES; pressures in bar outside, in Pa inside."""
    p_i, p_e = x[X.p_int_bar] * BAR, x[X.p_exh_bar] * BAR
    T_g, T_w, T_h = x[X.T_gas_K], x[X.T_wall_K], x[X.T_head_K]
    mu = max(x[X.flow_memory], MU_MIN)
    R = R_DRY * (1.0 + theta[P.humidity])
    N = u[U.N_rpm] * (1.0 - theta[P.slip] * (mu - 1.0))
    speed_2 = (N / 1800.0) ** 2
    m = M_REF_KG_S * mu
    log_mu = math.log(mu)
    m_in = _filter_flow(u[U.p_suc_bar] * BAR - p_i, theta)

    # Leaks out of the exhaust volume, choked.
    choked = 0.6847 * p_e / math.sqrt(R * T_g) * 1e-6
    m_ext, m_rec = theta[P.A_ext_mm2] * choked, theta[P.A_rec_mm2] * choked
    T_im = _mixed_K(m_in, m, u[U.T_suc_K], m_rec, T_g)

    # Suction gas: preheated by the wall, re-heated by the internal leak.
    T_pre = T_im + theta[P.eps_0] * math.exp(-theta[P.eps_x] * log_mu) * (T_w - T_im)
    m_L = theta[P.leakage] * theta[P.V_d_m3] * N_REF_REV_S * (p_e - p_i) / (R * T_g)
    m_L *= 1.0 + theta[P.leak_N] * (N / 1350.0 - 1.0)
    T_1 = T_pre + theta[P.lam_L] * m_L / (m + m_L) * (T_g - T_pre)

    # Valve losses, volumetric efficiency, demanded flow.
    psi_s = min(theta[P.K_s] * speed_2 * 300.0 / T_1, 0.4)
    psi_d = theta[P.K_d] * speed_2 * 450.0 / T_g
    ratio = p_e * (1.0 + psi_d) / (p_i * (1.0 - psi_s))
    log_ratio = math.log(max(ratio, 1e-3))
    late = theta[P.flutter] * max(0.0, N / 1400.0 - 1.0)
    eta_v = 1.0 - theta[P.clearance] * (math.exp(log_ratio / theta[P.n_exp]) - 1.0) - late
    drawn = theta[P.capacity] * p_i * (1.0 - psi_s) / (R * T_1) * theta[P.V_d_m3] * N / 60.0 * max(eta_v, 0.05)

    # Compression and heat given to the wall.
    eta = theta[P.eta_0] - theta[P.eta_2] * (ratio - 2.8) ** 2 - theta[P.eta_N] * speed_2
    T_d = T_1 * (1.0 + (math.exp(log_ratio * (GAMMA - 1.0) / GAMMA) - 1.0) / max(theta[P.efficiency] * eta, 0.3))
    UA_gw = theta[P.heat_transfer] * theta[P.UA_gw_W_K] * math.exp(theta[P.UA_x] * log_mu)

    CdA = theta[P.CdA_max_m2] * theta[P.R_v] ** (x[X.valve_pos] - 1.0)
    f = np.empty(len(F))
    f[F.m_in_kg_s] = m_in
    f[F.m_demand_kg_s] = max(drawn - m_L, 1e-3)
    f[F.m_out_kg_s] = CdA * p_e / math.sqrt(R * T_g) * _outflow_factor(theta[P.p_head_Pa] / p_e)
    f[F.m_ext_kg_s] = m_ext
    f[F.m_rec_kg_s] = m_rec
    f[F.T_im_K] = T_im
    f[F.W_W] = m * CP * (T_d - T_pre)
    f[F.Q_gw_W] = m * CP * (T_d - T_w) * (1.0 - math.exp(-UA_gw / (m * CP)))
    f[F.Q_pre_W] = m * CP * (T_pre - T_im)
    f[F.Q_f_W] = theta[P.P_f_W] * speed_2**0.75
    f[F.Q_c_W] = theta[P.UA_c_W_K] * (T_w - theta[P.T_c_K])
    f[F.Q_h_W] = theta[P.UA_h_W_K] * (T_g - T_h)
    f[F.Q_ha_W] = theta[P.UA_ha_W_K] * (T_h - theta[P.T_amb_K])
    f[F.Q_amb_W] = theta[P.UA_amb_W_K] * (T_g - theta[P.T_amb_K])
    return f


@njit(cache=True, error_model="numpy")
def balance(x, u, theta, f):  # type: ignore[no-untyped-def]
    """Rates of change (8,) from the flows: exact open-system balances of the exhaust volume."""
    p_e, T_g = x[X.p_exh_bar] * BAR, x[X.T_gas_K]
    mu = max(x[X.flow_memory], MU_MIN)
    V_e = theta[P.V_exh_m3]
    R = R_DRY * (1.0 + theta[P.humidity])
    m = M_REF_KG_S * mu
    # All is read before anything is written: compiled code is a tenth faster so.
    m_in, m_demand, m_rec, T_im = f[F.m_in_kg_s], f[F.m_demand_kg_s], f[F.m_rec_kg_s], f[F.T_im_K]
    Q_gw, Q_pre, Q_f, Q_c, Q_h, Q_ha = f[F.Q_gw_W], f[F.Q_pre_W], f[F.Q_f_W], f[F.Q_c_W], f[F.Q_h_W], f[F.Q_ha_W]
    T_probe, valve, command = x[X.T_probe_K], x[X.valve_pos], u[U.valve]
    V_i, C_w, C_h, iso = theta[P.V_int_m3], theta[P.C_w_J_K], theta[P.C_h_J_K], theta[P.iso]
    tau_m, tau_v = theta[P.tau_m_s], theta[P.tau_v_s]
    m_off = f[F.m_out_kg_s] + f[F.m_ext_kg_s] + m_rec
    enthalpy_in = m * CP * T_im + Q_pre + f[F.W_W] - Q_gw
    net = enthalpy_in - m_off * CP * T_g - Q_h - f[F.Q_amb_W]
    dp_exact = net * R / (V_e * CV)
    dp_isothermal = R * T_g / V_e * (m - m_off)
    tau_T = theta[P.tau_T_s] * math.exp(-theta[P.tau_T_x] * math.log(mu))

    dx = np.empty(len(X))
    dx[X.p_int_bar] = R * T_im / V_i * (m_in - m + m_rec) / BAR
    dx[X.p_exh_bar] = (dp_exact + iso * (dp_isothermal - dp_exact)) / BAR
    dx[X.T_gas_K] = R * T_g / (p_e * V_e * CV) * (net - (m - m_off) * CV * T_g)
    dx[X.T_wall_K] = (Q_gw + Q_f - Q_pre - Q_c) / C_w
    dx[X.flow_memory] = (m_demand / M_REF_KG_S - mu) / tau_m
    dx[X.T_probe_K] = (T_g - T_probe) / tau_T
    dx[X.valve_pos] = (command - valve) / tau_v
    dx[X.T_head_K] = (Q_h - Q_ha) / C_h
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
        theta: (n_parameters,) in the parameters' units, order PARAMETERS.
    """
    mu = max(x[X.flow_memory], MU_MIN)
    probe = x[X.T_probe_K]
    y = np.empty(len(Y))
    y[Y.p_dis_bar] = x[X.p_exh_bar]
    y[Y.T_dis_K] = probe - theta[P.stem] * (probe - x[X.T_wall_K]) + theta[P.T_bias_K]
    y[Y.m_flow_kg_s] = M_REF_KG_S * mu * (1.0 + theta[P.flow_gain]) * (1.0 + theta[P.pulsation] / mu)
    return y


def initial(u0: Array, y0: Array, theta: Array) -> Array:
    """A warm machine at the first reading.

    Args:
        u0: (4,) first inputs in their units, order INPUTS.
        y0: (3,) first readings in their units, order OUTPUTS.
        theta: (n_parameters,) in the parameters' units, order PARAMETERS.
    """
    T_g = y0[Y.T_dis_K] - theta[P.T_bias_K]
    x = np.empty(len(X))
    x[X.p_int_bar] = 0.985 * u0[U.p_suc_bar]
    x[X.p_exh_bar] = y0[Y.p_dis_bar]
    x[X.T_gas_K] = x[X.T_probe_K] = T_g
    x[X.T_wall_K] = theta[P.T_c_K] + 0.35 * (T_g - theta[P.T_c_K])
    x[X.flow_memory] = max(y0[Y.m_flow_kg_s] / M_REF_KG_S, 0.05)
    x[X.valve_pos] = u0[U.valve]
    x[X.T_head_K] = theta[P.T_amb_K] + 0.6 * (T_g - theta[P.T_amb_K])
    return x


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
