"""The concealed compressor: its own equations, in pascals, every effect in another form than the catalogue's.

The twin is ``physics.compressor:PLANT`` with its finer effects left out; each effect here puts one back.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from twinbench.physics.places import places
from twinbench.physics.simulator import Array
from twinbench.physics.steady import valve_for
from twinbench.proof.concealed.integrate import LAW
from twinbench.proof.concealed.machine import Effect, Machine, Noise, clock, levels

_R, _CP, _M0 = 287.05, 1004.675, 0.12
LEFT_OUT = {
    "K_s": 0.012, "K_d": 0.015, "eps_0": 0.15, "eps_x": 0.0, "lam_L": 0.0, "UA_x": 0.0, "eta_2": 0.0, "eta_N": 0.0,
    "UA_h_W_K": 0.0, "tau_T_x": 0.0, "iso": 0.0, "leakage": 0.03,
}  # fmt: skip
"""What the twin sets the plant's parameters to."""
_OWN = {
    "capacity": 1.0, "efficiency": 1.0, "leakage": 0.03, "heat_transfer": 1.0, "T_bias_K": 0.0, "C_w_J_K": 27600.0,
    "V_exh_m3": 0.06, "tau_v_s": 0.8,
}  # fmt: skip
"""The machine's own constants, which the twin may calibrate."""
_PARAMETERS = _OWN | dict.fromkeys((
    "ripple", "ripple_phase", "ambient", "ambient_phase", "exponent",
    "suction_loss", "discharge_loss", "preheat", "preheat_fall", "reheat", "conductance", "off_design", "speed_loss",
    "head", "fast_probe", "isothermal", "clearance", "re_expansion", "flutter", "leak_speed", "escape", "recycle",
    "erosion", "fouling", "line_loss", "coolant", "friction", "slow_probe", "stem", "flow_gain", "pulsation",
    "moisture", "slip", "resonance", "soak",
), 0.0)  # fmt: skip
_INPUTS = ("p_suc_bar", "T_suc_K", "N_rpm", "valve")
_OUTPUTS = ("p_dis_bar", "T_dis_K", "m_flow_kg_s")
_STATES = ("p_int_Pa", "p_exh_Pa", "T_gas", "T_wall", "mu", "T_probe", "valve", "T_head", "soak")
P, X, U, Y = (places(names) for names in (_PARAMETERS, _STATES, _INPUTS, _OUTPUTS))


@njit(cache=True, error_model="numpy", inline="always")
def _filter_flow(dp, mu, p):  # type: ignore[no-untyped-def]
    """Flow through the filter: quadratic loss; fouling adds one that grows a little slower."""
    b = 1.5e5 * (1.0 + p[P.fouling] * mu**-0.1)
    root = math.sqrt(1e8 + 4.0 * b * abs(dp))
    m_in = 2.0 * abs(dp) / (1e4 + root)
    return -m_in if dp < 0.0 else m_in


@njit(cache=True, error_model="numpy", inline="always")
def _filled(ratio, N, p):  # type: ignore[no-untyped-def]
    """Share of the swept volume that is filled at a pressure ratio and a speed in rpm."""
    late = p[P.flutter] * 0.03 * math.log1p(math.exp((N / 1400.0 - 1.0) / 0.03))
    bump = p[P.resonance] * math.exp(-(((N - 1290.0) / 70.0) ** 2))
    expanded = 0.055 * (ratio ** (1.0 / (1.25 + p[P.re_expansion])) - 1.0)
    return 1.0 - expanded - p[P.clearance] * (ratio**0.79 - 1.0) - late - bump


@njit(cache=True, error_model="numpy", inline="always")
def _efficiency(ratio, rel, p):  # type: ignore[no-untyped-def]
    """Of the compression, at a pressure ratio and at speed over 1350 rpm."""
    n = p[P.exponent]
    away = math.sqrt((ratio - 2.8) ** 2 + 0.01) ** (n - 0.05)
    return p[P.efficiency] * (0.925 - p[P.off_design] * away - p[P.speed_loss] * 0.5625 * rel**n)


@njit(cache=True, error_model="numpy", inline="always")
def _outflow_factor(r):  # type: ignore[no-untyped-def]
    """Flow function of the throttle at header pressure over exhaust pressure."""
    if r >= 0.5283:
        return math.sqrt(7.0 * max(r**1.4285714 - r**1.7142857, 0.0))
    return 0.6847


@njit(cache=True, error_model="numpy", inline="always")
def _exhaust_rates(T_g, p_e, R, kept, net, p, dx):  # type: ignore[no-untyped-def]
    """The exhaust volume's part of ``dx``, from the flow (kg/s) and the energy (W) that stay in it."""
    cv, V = _CP - _R, p[P.V_exh_m3]
    exact = net * R / (V * cv)
    dx[X.p_exh_Pa] = exact + p[P.isothermal] * (R * T_g / V * kept - exact)
    dx[X.T_gas] = R * T_g / (p_e * V * cv) * (net - kept * cv * T_g)


@njit(LAW, cache=True, error_model="numpy")
def law(t, x, u, p, dx):  # type: ignore[no-untyped-def]
    """Rates of change of the states, SI units."""
    p_i, p_e, T_g, T_w, T_h = x[X.p_int_Pa], x[X.p_exh_Pa], x[X.T_gas], x[X.T_wall], x[X.T_head]
    mu = max(x[X.mu], 0.02)
    ambient = p[P.ambient] * math.sin(2.0 * math.pi * t / 2500.0 + p[P.ambient_phase])
    R = _R * (1.0 + p[P.moisture])
    m = _M0 * mu
    N = u[U.N_rpm] - u[U.N_rpm] * p[P.slip] * (mu - 1.0)
    rel = N / 1350.0
    flow_at_design = N / 1800.0
    n = p[P.exponent]  # off the catalogue's; the laws agree at 1350 rpm
    m_in = _filter_flow(u[U.p_suc_bar] * 1e5 - p_i, mu, p)

    # Escapes to the outside and back to the intake.
    per_mm2 = 0.6847 * p_e / math.sqrt(R * T_g) * 1e-6
    m_esc, m_rec = p[P.escape] * per_mm2, p[P.recycle] * per_mm2
    T_i = u[U.T_suc_K]
    if m_rec > 0.0:
        T_i = (max(m_in, 0.0) * u[U.T_suc_K] + m_rec * T_g) / (max(m_in, 0.0) + m_rec)

    # Suction: preheat, leak, losses.
    fall = p[P.preheat_fall] * math.log(mu)
    T_pre = T_i + (0.15 * (1.0 - fall + 0.4 * fall**2) + p[P.preheat] * mu**-0.06) * (T_w - T_i)
    m_L = p[P.leakage] * 6.03e-3 * 22.5 * (p_e - p_i) / (R * T_g) * rel ** p[P.leak_speed]
    T_1 = T_pre + p[P.reheat] * m_L / (m + 0.9 * m_L) * (T_g - T_pre)
    loss_s = (0.012 * flow_at_design**2 + p[P.suction_loss] * 0.5625 * rel**n) * 300.0 / T_1
    loss_d = (0.015 * flow_at_design**2 + p[P.discharge_loss] * 0.5625 * rel**n) * 450.0 / T_g
    ratio = p_e * (1.0 + loss_d) / (p_i * (1.0 - loss_s))
    wave = math.sin(7.0 * flow_at_design + 2.2 * ratio + p[P.ripple_phase])
    wave *= math.sin(3.1 * ratio - 4.0 * flow_at_design)
    drawn = p[P.capacity] * p_i * (1.0 - loss_s) / (R * T_1) * 6.03e-3 * N / 60.0 * _filled(ratio, N, p)
    drawn *= 1.0 + p[P.ripple] * wave
    drawn *= 1.0 - p[P.soak] * x[X.soak]

    # Compression and heat.
    T_d = T_1 * (1.0 + (ratio**0.285714285714 - 1.0) / _efficiency(ratio, rel, p))
    UA = p[P.heat_transfer] * 40.0 * (1.0 + p[P.conductance] * (mu**0.8 - 1.0) / 0.8)
    Q_gw = m * _CP * (T_d - T_w) * (1.0 - math.exp(-UA / (m * _CP)))
    Q_pre = m * _CP * (T_pre - T_i)
    Q_h = p[P.head] * (T_g - T_h)
    Q_line = p[P.line_loss] * (T_g - 298.0 - ambient) * (1.0 + 2e-4 * (T_g - 430.0))
    heat = 900.0 * flow_at_design**1.5 + p[P.friction] * 0.64952 * rel ** (n - 0.5)
    Q_c = 48.0 * (T_w - 303.0 - p[P.coolant] - 0.1 * ambient)

    m_out = (4.2e-4 * (1.0 + p[P.erosion])) * 9.0 ** (x[X.valve] - 1.0) * p_e / math.sqrt(R * T_g)
    off = m_out * _outflow_factor(1.013e5 / p_e) + m_esc + m_rec
    net = m * _CP * T_i + Q_pre + m * _CP * (T_d - T_pre) - Q_gw - off * _CP * T_g - Q_h - Q_line
    _exhaust_rates(T_g, p_e, R, m - off, net, p, dx)
    dx[X.p_int_Pa] = R * T_i / 0.12 * (m_in - m + m_rec)
    dx[X.T_wall] = (Q_gw + heat - Q_pre - Q_c) / p[P.C_w_J_K]
    dx[X.mu] = (max(drawn - m_L, 1e-3) / _M0 - mu) / 0.4
    dx[X.T_probe] = (T_g - x[X.T_probe]) * (1.0 + p[P.fast_probe] * (mu - 1.0)) / (5.0 + p[P.slow_probe])
    dx[X.valve] = (u[U.valve] - x[X.valve]) / p[P.tau_v_s]
    dx[X.T_head] = (Q_h - 6.0 * (T_h - 298.0 - ambient)) / 5000.0
    dx[X.soak] = (ratio / 3.3 - 1.0 - x[X.soak]) / 40.0
    return 0.0


@njit(LAW, cache=True, error_model="numpy")
def reading(t, x, u, p, y):  # type: ignore[no-untyped-def]
    """What the sensors read, before noise."""
    cell = x[X.mu]
    y[Y.p_dis_bar] = x[X.p_exh_Pa] * 1e-5
    y[Y.T_dis_K] = x[X.T_probe] - p[P.stem] * (x[X.T_probe] - x[X.T_wall]) + p[P.T_bias_K]
    y[Y.m_flow_kg_s] = _M0 * cell * (1.0 + p[P.flow_gain]) * math.sqrt(1.0 + 2.0 * p[P.pulsation] / max(cell, 0.05))
    return 0.0


def ripple_arguments(x: Array, u: Array) -> Array:
    """Of the capacity's ripple, (N, 2): speed and pressure ratio, scaled.

    Args:
        x: (N, nx) each state in its unit.
        u: (N, nu) inputs in their units.
    """
    return np.stack([6.0 / 1800.0 * u[:, U.N_rpm], 2.7 * x[:, X.p_exh_Pa] / x[:, X.p_int_Pa]], axis=-1)


def operate(rng: np.random.Generator, seconds: float, regime: str) -> Array:
    """Inputs (N, 4): speed, pressure ratio and suction in held pieces; fast and slow pieces in one recording."""
    speed, ratio, suction, T_mean = {
        "train": ((900.0, 1650.0), (2.2, 4.4), (0.86, 1.08), (288.0, 300.0)),
        "held": ((1150.0, 1800.0), (2.8, 4.85), (0.82, 1.0), (298.0, 308.0)),
        "poor": ((1340.0, 1345.0), (3.2, 3.22), (0.95, 0.952), (297.0, 299.0)),
    }[regime]
    t = clock(seconds, 0.05)
    N = levels(rng, t, speed, (8.0, 70.0), (2.0, 10.0))
    target = levels(rng, t, ratio, (8.0, 70.0), (2.0, 12.0))
    p_suc = levels(rng, t, suction, (40.0, 150.0), (0.3, 1.0))
    swing = 0.3 if regime == "poor" else 3.0
    T = rng.uniform(*T_mean) + swing * np.sin(2 * np.pi * t / rng.uniform(200.0, 600.0) + rng.uniform(0, 6.3))
    return np.stack([p_suc, T, N, valve_for(N, target)], axis=-1)


def start(u: Array, p: Array) -> Array:
    """A guess of the state under inputs u (4,).

    Args:
        u: (4,) inputs in their units.
        p: (n_parameters,) the law's own, each in its unit.
    """
    x = np.zeros(len(X))
    x[X.p_int_Pa] = 0.98e5 * u[U.p_suc_bar]
    x[X.p_exh_Pa] = 3.0e5
    x[X.T_gas] = x[X.T_probe] = 430.0
    x[X.T_wall], x[X.T_head] = 355.0, 370.0
    x[X.mu] = 1.0
    x[X.valve] = u[U.valve]
    return x


def _effect(
    name: str,
    slot: str,
    typical: float,
    most: float,
    port: str,
    size: str = "",
    absent: float = 0.0,
    scale: float = 1.0,
    ports: tuple[str, ...] = (),
) -> Effect:
    return Effect(name, slot, typical, most, (port, *ports), size, absent, scale)


_DEMAND, _GAS, _WALL, _EXH = "flux:m_demand_kg_s", "balance:T_gas_K", "balance:T_wall_K", "balance:p_exh_bar"
_T, _M = "output:T_dis_K", "output:m_flow_kg_s"
_MEMORY = "balance:flow_memory"
EFFECTS = (
    _effect("suction_valve_loss", "suction_loss", 0.04, 0.25, _DEMAND, "K_s", 0.012, ports=(_MEMORY,)),
    _effect("discharge_valve_loss", "discharge_loss", 0.05, 0.25, _GAS, "K_d", 0.015, ports=("flux:W_W", _EXH)),
    _effect("suction_preheat", "preheat", 0.12, 0.6, _DEMAND, "eps_0", 0.15,
            ports=(_MEMORY, "flux:Q_pre_W", _WALL, _GAS)),
    _effect("preheat_falls_with_flow", "preheat_fall", 0.3, 0.9, _DEMAND, ports=(_MEMORY, "flux:Q_pre_W", _WALL, _GAS)),
    _effect("leak_reheating", "reheat", 0.6, 1.0, _DEMAND, "lam_L", ports=(_MEMORY, _GAS, "flux:W_W")),
    _effect("wall_conductance_with_flow", "conductance", 0.5, 1.2, _WALL, ports=("flux:Q_gw_W", _GAS)),
    _effect("efficiency_off_design", "off_design", 0.008, 0.05, _GAS, "eta_2", ports=("flux:W_W", _EXH)),
    _effect("efficiency_with_speed", "speed_loss", 0.03, 0.1, _GAS, "eta_N", ports=("flux:W_W", _EXH)),
    _effect("discharge_head_metal", "head", 9.0, 40.0, _GAS, "UA_h_W_K",
            ports=("flux:Q_h_W", "flux:Q_amb_W")),
    _effect("probe_lag_with_flow", "fast_probe", 0.5, 1.4, _T, ports=("balance:T_probe_K",)),
    _effect("isothermal_manifold", "isothermal", 0.5, 1.0, _EXH, "iso"),
    _effect("larger_clearance", "clearance", 0.012, 0.12, _DEMAND, "clearance", 0.055, ports=(_MEMORY,)),
    _effect("re_expansion_exponent", "re_expansion", 0.05, 0.5, _DEMAND, "n_exp", 1.25, ports=(_MEMORY,)),
    _effect("valve_flutter", "flutter", 0.1, 0.5, _DEMAND, "flutter", ports=(_MEMORY,)),
    _effect("leakage_with_speed", "leak_speed", 0.6, 1.4, _DEMAND, "leak_N", ports=(_MEMORY,)),
    _effect("external_leak", "escape", 5.0, 50.0, _EXH, "A_ext_mm2",
            ports=("flux:m_ext_kg_s", "flux:m_out_kg_s")),
    _effect("recycle_leak", "recycle", 6.0, 50.0, _EXH, "A_rec_mm2",
            ports=("flux:m_rec_kg_s", "flux:m_out_kg_s", "balance:p_int_bar", "flux:T_im_K")),
    _effect("throttle_erosion", "erosion", 0.06, 0.8, _EXH, "CdA_max_m2", 4.2e-4, 4.2e-4, ports=("flux:m_out_kg_s",)),
    _effect("filter_fouling", "fouling", 1.0, 3.8, "balance:p_int_bar", "b_in", 1.5e5, 1.5e5,
            ports=("flux:m_in_kg_s",)),
    _effect("discharge_heat_loss", "line_loss", 8.0, 50.0, _GAS, "UA_amb_W_K",
            ports=("flux:Q_amb_W", "flux:Q_h_W")),
    _effect("warm_coolant", "coolant", 12.0, 50.0, _WALL, "T_c_K", 303.0,
            ports=("flux:Q_c_W", "flux:Q_f_W")),
    _effect("friction_heat", "friction", 600.0, 3400.0, _WALL, "P_f_W", 900.0, ports=("flux:Q_c_W", "flux:Q_f_W")),
    _effect("probe_lag", "slow_probe", 3.0, 20.0, _T, "tau_T_s", 5.0,
            ports=("balance:T_probe_K",)),
    _effect("stem_conduction", "stem", 0.05, 0.45, _T, "stem"),
    _effect("flow_meter_gain", "flow_gain", 0.02, 0.19, _M, "flow_gain"),
    _effect("flow_meter_pulsation", "pulsation", 0.012, 0.1, _M, "pulsation"),
    _effect("humidity", "moisture", 0.012, 0.1, _DEMAND, "humidity", ports=(_MEMORY, _EXH, "flux:m_out_kg_s")),
    _effect("motor_slip", "slip", 0.02, 0.2, "input:N_rpm", "slip", ports=(_DEMAND, _MEMORY)),
)  # fmt: skip
FOREIGN = (
    Effect("suction_resonance", "resonance", 0.02, 0.3, (_DEMAND, _MEMORY)),
    Effect("thermal_soak_of_capacity", "soak", 0.04, 0.8, (_DEMAND, _MEMORY)),
)

MACHINE = Machine(
    name="compressor",
    simulator="twinbench.physics.compressor:PLANT",
    values=LEFT_OUT,
    calibrate=tuple(_OWN),
    inputs=_INPUTS,
    outputs=_OUTPUTS,
    parameters=_PARAMETERS,
    spread={
        "capacity": 0.15, "efficiency": 0.10, "leakage": 0.15, "heat_transfer": 0.15, "C_w_J_K": 0.15,
        "V_exh_m3": 0.15, "tau_v_s": 0.15,
    },
    offsets={"T_bias_K": 2.0},
    high={"capacity": 1.08, "efficiency": 1.02},
    exponent=(1.85, 2.15),
    ambient=2.0,
    law=law,
    reading=reading,
    start=start,
    slow={X.T_wall: 1.0, X.T_probe: 1.0, X.T_head: 1.0},
    operate=operate,
    settle_s=300.0,
    period_s=0.05,
    fine=20,
    coarse=2,
    seconds={"train": (300.0, 300.0, 300.0), "held": (300.0, 300.0)},
    noise={
        "p_suc_bar": Noise(0.0005, 0.0, 1.0), "T_suc_K": Noise(0.05, 0.0, 1.0), "N_rpm": Noise(0.5, 0.0, 1.0),
        "valve": Noise(0.0, 0.0, 1.0), "p_dis_bar": Noise(0.012, 0.0075, 0.4), "T_dis_K": Noise(0.6, 0.4, 3.0),
        "m_flow_kg_s": Noise(0.0009, 0.0006, 0.6),
    },
    lsb={"p_dis_bar": 0.002, "T_dis_K": 0.1, "m_flow_kg_s": 0.0002, "p_suc_bar": 0.0005, "T_suc_K": 0.05, "N_rpm": 0.5,
         "valve": 0.0001},
    effects=EFFECTS,
    foreign=FOREIGN,
    rippled="capacity",
    ripple_arguments=ripple_arguments,
)  # fmt: skip
