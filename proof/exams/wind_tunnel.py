"""The wind tunnel's models, rung by rung, with the values that their authors publish (``causalchamber``, MIT).

Speeds are in rad/s, as in the models. Sensors tell them in rpm, as in the recordings.
"""

from __future__ import annotations

import numpy as np

from twinbench.physics.simulator import Array, Port, Simulator, Term, Variable

TORQUE_NM = 0.05 * (0.27 - 0.166)
"""Of a fan at full load: 0.05 N m/A by the current at full load less that without."""
LOAD_MIN = 0.1
"""Below it a fan does what it does at this load."""
OMEGA_MAX_RAD_S = 3000.0 * np.pi / 30.0
INERTIA_KG_M2, DRAG_NMS2 = 3.481e-05, 5.268701549401565e-08
S_MAX_PA = 74.82473949999999
"""Static pressure of a fan at full speed with no flow, by its data sheet."""
RATIO, BETA = 0.75, 0.15
"""Share of the free air flow with the hatch closed, and what the open hatch adds to it."""
HATCH_DEG = 45.0
"""The hatch, wide open."""
BAROMETER_PA = 0.2
"""Standard deviation of the barometer's noise, as published."""
TACHOMETER_RPM = 5.0
"""Of the tachometers'. The published models have none; this is ours."""
AT_ONCE_S = 0.05
"""A steady fan follows its load in this time: a simulator needs a state, and no sample shows it."""
RPM = 30.0 / np.pi
DRAG = "quadratic_friction@omega_in_rad_s"
"""What our catalogue calls a drag with the square of the speed."""


def _variables(*names: str) -> tuple[Variable, ...]:
    known = {
        "omega_in_rad_s": ("rad/s", 0.0, 400.0, 160.0, 60.0, "speed of the intake fan"),
        "omega_out_rad_s": ("rad/s", 0.0, 400.0, 160.0, 60.0, "speed of the exhaust fan"),
        "load_in": ("1", 0.0, 1.0, 0.6, 0.25, "load of the intake fan"),
        "load_out": ("1", 0.0, 1.0, 0.6, 0.25, "load of the exhaust fan"),
        "hatch": ("deg", 0.0, HATCH_DEG, 20.0, 12.0, "position of the hatch"),
        "rpm_in": ("rpm", 0.0, 4000.0, 1500.0, 600.0, "intake fan by its tachometer"),
        "rpm_out": ("rpm", 0.0, 4000.0, 1500.0, 600.0, "exhaust fan by its tachometer"),
        "rise_Pa": ("Pa", -100.0, 100.0, 0.0, 10.0, "downwind pressure less the ambient one"),
        "omega_max_rad_s": ("rad/s", 100.0, 600.0, OMEGA_MAX_RAD_S, 15.0, "speed at full load"),
        "J_kg_m2": ("kg m^2", 1e-5, 1e-4, INERTIA_KG_M2, 3e-6, "inertia of a fan"),
        "c_Nms2": ("N m s^2", 1e-8, 2e-7, DRAG_NMS2, 3e-9, "drag with the square of the speed"),
        "b_Nms": ("N m s", 0.0, 1e-4, 1.6e-5, 2e-6, "drag in proportion to the speed"),
        "r": ("1", 0.0, 1.0, RATIO, 0.05, "share of the free air flow"),
        "beta": ("1", 0.0, 0.25, BETA, 0.02, "what the open hatch adds to that share"),
    }
    return tuple(Variable(name, *known[name]) for name in names)


def _fan_start(u0: Array, y0: Array, theta: Array) -> Array:
    return np.array([y0[0] / RPM])


def _fan_read(x: Array, u: Array, theta: Array) -> Array:
    return np.array([x[0] * RPM])


def _steady(x: Array, u: Array, theta: Array) -> Array:
    return np.array([(max(u[0], LOAD_MIN) * theta[0] - x[0]) / AT_ONCE_S])


def _linear(x: Array, u: Array, theta: Array) -> Array:
    return np.array([(TORQUE_NM * max(u[0], LOAD_MIN) ** 3 - theta[1] * x[0]) / theta[0]])


def _inert(x: Array, u: Array, theta: Array) -> Array:
    return np.array([(TORQUE_NM * max(u[0], LOAD_MIN) ** 3 - theta[1] * x[0] * abs(x[0])) / theta[0]])


_FAN = {
    "states": _variables("omega_in_rad_s"),
    "inputs": _variables("load_in"),
    "outputs": _variables("rpm_in"),
    "output": _fan_read,
    "initial": _fan_start,
}
FAN_A1 = Simulator(
    name="fan_a1",
    says="a fan whose speed is in proportion to its load, at once",
    parameters=_variables("omega_max_rad_s"),
    rhs=_steady,
    **_FAN,  # type: ignore[arg-type]
)
FAN_LINEAR = Simulator(
    name="fan_linear",
    says="a fan with inertia and a drag in proportion to its speed",
    parameters=_variables("J_kg_m2", "b_Nms"),
    rhs=_linear,
    **_FAN,  # type: ignore[arg-type]
)
FAN_A2 = Simulator(
    name="fan_a2",
    says="a fan with inertia and a drag with the square of its speed",
    parameters=_variables("J_kg_m2", "c_Nms2"),
    rhs=_inert,
    **_FAN,  # type: ignore[arg-type]
)


def _both(x: Array, u: Array, theta: Array) -> Array:
    inertia, drag = theta[0], theta[1]
    return np.array(
        [
            (TORQUE_NM * max(u[0], LOAD_MIN) ** 3 - drag * x[0] * abs(x[0])) / inertia,
            (TORQUE_NM * max(u[1], LOAD_MIN) ** 3 - drag * x[1] * abs(x[1])) / inertia,
        ]
    )


def _start(u0: Array, y0: Array, theta: Array) -> Array:
    return np.array([y0[0] / RPM, y0[1] / RPM])


def _law(x: Array, u: Array, theta: Array) -> Array:
    rise = S_MAX_PA * (x[0] * abs(x[0]) - x[1] * abs(x[1])) / OMEGA_MAX_RAD_S**2
    return np.array([x[0] * RPM, x[1] * RPM, rise])


def _impeded(x: Array, u: Array, theta: Array) -> Array:
    # The impedance meets the fan's straight characteristic where the flow is r times the free one.
    rise = S_MAX_PA * (x[0] * abs(x[0]) - x[1] * abs(x[1])) / OMEGA_MAX_RAD_S**2
    return np.array([x[0] * RPM, x[1] * RPM, (1.0 - theta[2]) * rise])


def _hatched(x: Array, u: Array, theta: Array) -> Array:
    rise = S_MAX_PA * (x[0] * abs(x[0]) - x[1] * abs(x[1])) / OMEGA_MAX_RAD_S**2
    share = min(1.0, theta[2] + theta[3] * u[2] / HATCH_DEG)
    return np.array([x[0] * RPM, x[1] * RPM, (1.0 - share) * rise])


_TUNNEL = {
    "states": _variables("omega_in_rad_s", "omega_out_rad_s"),
    "inputs": _variables("load_in", "load_out", "hatch"),
    "outputs": _variables("rpm_in", "rpm_out", "rise_Pa"),
    "rhs": _both,
    "initial": _start,
}
TUNNEL_C1 = Simulator(
    name="tunnel_c1",
    says="a tunnel whose pressure the fans' speeds alone make",
    parameters=_variables("J_kg_m2", "c_Nms2"),
    output=_law,
    **_TUNNEL,  # type: ignore[arg-type]
)
TUNNEL_C2 = Simulator(
    name="tunnel_c2",
    says="a tunnel with an impedance",
    parameters=_variables("J_kg_m2", "c_Nms2", "r"),
    output=_impeded,
    **_TUNNEL,  # type: ignore[arg-type]
)
TUNNEL_C3 = Simulator(
    name="tunnel_c3",
    says="a tunnel with an impedance that the hatch changes",
    parameters=_variables("J_kg_m2", "c_Nms2", "r", "beta"),
    output=_hatched,
    **_TUNNEL,  # type: ignore[arg-type]
)


def _moves_as_a2(x: Array, u: Array, theta: Array, own: float) -> float:
    share, inertia, drag = theta[-3], theta[-2], theta[-1]
    rate: float = (TORQUE_NM * max(u[0], LOAD_MIN) ** 3 - drag * x[0] * abs(x[0])) / inertia
    return share * (rate - own)


def _impedes(x: Array, u: Array, theta: Array, own: float) -> float:
    share: float = theta[-1]
    return -share * own


def _opens(x: Array, u: Array, theta: Array) -> float:
    rise: float = S_MAX_PA * (x[0] * abs(x[0]) - x[1] * abs(x[1])) / OMEGA_MAX_RAD_S**2
    return -theta[-1] * u[2] / HATCH_DEG * rise


INERTIA_AND_DRAG = Term(
    "inertia_and_drag@omega_in_rad_s",
    "the fan has inertia, and a drag with the square of its speed",
    Port("balance", "omega_in_rad_s"),
    (
        Variable("inertia_and_drag", "1", 0.0, 1.0, 1.0, 0.3, "share of this law in the rate"),
        Variable("inertia_and_drag_J", "kg m^2", 1e-5, 1e-4, 3e-5, 1e-5, "inertia"),
        Variable("inertia_and_drag_c", "N m s^2", 1e-8, 2e-7, 5e-8, 1e-8, "drag"),
    ),
    term=_moves_as_a2,
    sees_own=True,
    formula="{inertia_and_drag} ((torque - {inertia_and_drag_c} omega^2)/{inertia_and_drag_J} - own rate)",
)
IMPEDANCE = Term(
    "impedance@rise_Pa",
    "an impedance lets a share of the air through, which raises no pressure",
    Port("output", "rise_Pa"),
    (Variable("impedance_share", "1", 0.0, 1.0, 0.5, 0.2, "share of the free air flow"),),
    term=_impedes,
    sees_own=True,
    formula="-{impedance_share} rise",
)
HATCH = Term(
    "hatch@rise_Pa",
    "the open hatch lets more of the air through",
    Port("output", "rise_Pa"),
    (Variable("hatch_share", "1", 0.0, 0.5, 0.1, 0.05, "share of the free air flow that the open hatch adds"),),
    term=_opens,
    formula="-{hatch_share} hatch/45 rise without flow",
)
