"""The compressor's catalogue: what a model of it can leave out, as amplitudes of one set of equations."""

from __future__ import annotations

from twinbench.physics.compressor import AMPLITUDES, CONSTANTS
from twinbench.physics.simulator import Amplitude, Port, Variable

_VARIABLES = {v.name: v for v in CONSTANTS + AMPLITUDES}


def _amplitude(name: str, port: str, parameter: str, absent: float, present: float, says: str) -> Amplitude:
    v = _VARIABLES[parameter]
    present_variable = Variable(v.name, v.unit, min(v.low, present), max(v.high, present), present, v.scale, v.says)
    return Amplitude(name, says, Port.parse(port), (present_variable,), (absent,))


CATALOGUE = (
    _amplitude("suction_valve_loss", "flux:m_demand_kg_s", "K_s", 0.0, 0.05,
               "the suction valves cost pressure that grows with speed squared"),
    _amplitude("discharge_valve_loss", "balance:T_gas_K", "K_d", 0.0, 0.06,
               "the discharge valves cost pressure that grows with speed squared, so the gas leaves hotter"),
    _amplitude("suction_preheat", "flux:m_demand_kg_s", "eps_0", 0.0, 0.26,
               "the hot wall warms the suction gas, so less mass is drawn in"),
    _amplitude("preheat_falls_with_flow", "flux:m_demand_kg_s", "eps_x", 0.0, 0.15,
               "the suction gas is preheated less at high flow"),
    _amplitude("leak_reheating", "flux:m_demand_kg_s", "lam_L", 0.0, 0.6,
               "the internal leak carries hot gas back and warms the suction gas"),
    _amplitude("wall_conductance_with_flow", "balance:T_wall_K", "UA_x", 0.0, 0.7,
               "gas-to-wall heat transfer rises with flow"),
    _amplitude("efficiency_off_design", "balance:T_gas_K", "eta_2", 0.0, 0.008,
               "compression efficiency falls away from its best pressure ratio"),
    _amplitude("efficiency_with_speed", "balance:T_gas_K", "eta_N", 0.0, 0.02,
               "compression efficiency falls with speed squared"),
    _amplitude("discharge_head_metal", "balance:T_gas_K", "UA_h_W_K", 0.0, 9.0,
               "the metal of the discharge head stores heat, so the gas follows load changes minutes late"),
    _amplitude("probe_lag_with_flow", "output:T_dis_K", "tau_T_x", 0.0, 0.5,
               "the temperature probe answers faster at high flow"),
    _amplitude("isothermal_manifold", "balance:p_exh_bar", "iso", 0.0, 1.0,
               "the exhaust volume is taken as isothermal: pressure follows mass, not energy"),
    _amplitude("larger_clearance", "flux:m_demand_kg_s", "clearance", 0.055, 0.067,
               "a larger clearance volume re-expands and costs flow at high pressure ratio"),
    _amplitude("re_expansion_exponent", "flux:m_demand_kg_s", "n_exp", 1.25, 1.32,
               "the clearance gas re-expands with another exponent"),
    _amplitude("valve_flutter", "flux:m_demand_kg_s", "flutter", 0.0, 0.10,
               "the valves close late above 1400 rpm and gas flows back"),
    _amplitude("leakage_with_speed", "flux:m_demand_kg_s", "leak_N", 0.0, 0.8,
               "the internal leak changes with speed"),
    _amplitude("external_leak", "balance:p_exh_bar", "A_ext_mm2", 0.0, 5.0,
               "gas is lost from the discharge side to the outside"),
    _amplitude("recycle_leak", "balance:p_exh_bar", "A_rec_mm2", 0.0, 6.0,
               "the recycle valve leaks hot gas back to the intake"),
    _amplitude("throttle_erosion", "balance:p_exh_bar", "CdA_max_m2", 4.2e-4, 4.45e-4,
               "the throttle passes more than its drawing says"),
    _amplitude("filter_fouling", "balance:p_int_bar", "b_in", 1.5e5, 3.0e5,
               "the inlet filter is fouled and costs suction pressure with flow squared"),
    _amplitude("discharge_heat_loss", "balance:T_gas_K", "UA_amb_W_K", 0.0, 8.0,
               "the discharge line loses heat to the surroundings"),
    _amplitude("warm_coolant", "balance:T_wall_K", "T_c_K", 303.0, 315.0,
               "the coolant is warmer than assumed"),
    _amplitude("friction_heat", "balance:T_wall_K", "P_f_W", 900.0, 1500.0,
               "friction heats the cylinder wall more than assumed"),
    _amplitude("probe_lag", "output:T_dis_K", "tau_T_s", 5.0, 8.0,
               "the temperature probe is slower than assumed"),
    _amplitude("stem_conduction", "output:T_dis_K", "stem", 0.0, 0.05,
               "the probe's stem conducts heat to the wall, so it reads low"),
    _amplitude("flow_meter_gain", "output:m_flow_kg_s", "flow_gain", 0.0, 0.02,
               "the flow meter reads too high in proportion"),
    _amplitude("flow_meter_pulsation", "output:m_flow_kg_s", "pulsation", 0.0, 0.012,
               "pulsation makes the flow meter read high, most at low flow"),
    _amplitude("humidity", "flux:m_demand_kg_s", "humidity", 0.0, 0.012,
               "moist air is lighter than the dry air assumed"),
    _amplitude("motor_slip", "input:N_rpm", "slip", 0.0, 0.02,
               "the shaft turns slower under load than the speed signal says"),
)  # fmt: skip
"""Every mechanism this plant can show; plant and nominal model differ in the first eleven."""
