"""The concealed motor: armature, shaft and winding with what ``examples/motor.py`` leaves out."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from twinbench.physics.places import places
from twinbench.physics.simulator import Array
from twinbench.proof.concealed.integrate import LAW
from twinbench.proof.concealed.machine import Effect, Machine, Noise, clock, levels

_OWN = {
    "R_ohm": 0.6, "L_H": 0.08, "K_Nm_A": 1.0, "J_kg_m2": 1.5, "b_Nms": 0.05, "C_J_K": 4000.0, "G_W_K": 25.0,
    "T_amb_K": 295.0,
}  # fmt: skip
"""The machine's own constants, which the twin may calibrate."""
_PARAMETERS = _OWN | dict.fromkeys((
    "ripple", "ripple_phase", "ambient", "ambient_phase", "exponent",
    "dry", "dry_forward", "windage", "cubic", "bristles", "brushes", "arc", "shaker", "steady", "frame", "gap", "play",
    "saturation", "weakening",
), 0.0)  # fmt: skip
_INPUTS = ("voltage_V", "load_Nm")
_OUTPUTS = ("speed_rad_s", "amps_A", "T_probe_K")
_STATES = ("current", "speed", "T_winding", "T_frame", "bristle")
P, X, U, Y = (places(names) for names in (_PARAMETERS, _STATES, _INPUTS, _OUTPUTS))


@njit(LAW, cache=True, error_model="numpy")
def law(t, x, u, p, dx):  # type: ignore[no-untyped-def]
    """Rates of change of the states, SI units."""
    i, w, T, z = x[X.current], x[X.speed], x[X.T_winding], x[X.bristle]
    ambient = p[P.T_amb_K] + p[P.ambient] * math.sin(2.0 * math.pi * t / 1800.0 + p[P.ambient_phase])
    R = p[P.R_ohm] + p[P.R_ohm] * 0.0039 * (T - 293.0)
    K = p[P.K_Nm_A] * (1.0 + p[P.ripple] * math.sin(0.045 * w + p[P.ripple_phase]) * math.cos(0.09 * i))
    K *= 1.0 - p[P.saturation] * (i / 60.0) ** 2 / (1.0 + (i / 120.0) ** 2) - p[P.weakening] * (T - 330.0) / 30.0
    n = p[P.exponent]

    V = u[U.voltage_V]
    if p[P.gap] > 0.0:
        V -= p[P.gap] * math.tanh(u[U.voltage_V] / p[P.gap])  # a dead zone with a soft knee

    # Drops of current and speed per second: brushes, arcing; friction (Coulomb's falls a little from standstill on).
    drop = p[P.brushes] * i / math.sqrt(i * i + 0.5) + p[P.arc] * math.copysign(abs(i) ** n, i) * 40.0 ** (2.0 - n)
    sense = w / math.sqrt(w * w + 2.0)
    slow = p[P.dry] * sense * (1.0 + 0.05 * math.exp(-((w / 12.0) ** 2))) + p[P.bristles] * z
    if w > 0.0:
        slow += p[P.dry_forward] * sense
    slow += p[P.windage] * math.copysign(abs(w) ** n, w) * 120.0 ** (2.0 - n)
    slow += p[P.cubic] * math.copysign(abs(w) ** (n + 1.0), w) * 120.0 ** (2.0 - n)
    slow += p[P.steady] - p[P.shaker] * math.sin(2.0 * math.pi * t / 7.3 + 0.4)

    dx[X.current] = (V - R * i - K * w) / p[P.L_H] - drop
    dx[X.speed] = (K * i - p[P.b_Nms] * w - u[U.load_Nm]) / p[P.J_kg_m2] - slow
    dx[X.T_winding] = (R * i * i - p[P.G_W_K] * (T - ambient)) / p[P.C_J_K] - p[P.frame] * (T - x[X.T_frame])
    dx[X.T_frame] = (T - x[X.T_frame]) / 260.0
    toward = 1.0 - z if w > 0.0 else 1.0 + z
    dx[X.bristle] = w / 12.0 * max(toward, 0.0) ** 1.1
    return 0.0


@njit(LAW, cache=True, error_model="numpy")
def reading(t, x, u, p, y):  # type: ignore[no-untyped-def]
    """speed_rad_s, amps_A, T_probe_K."""
    y[Y.speed_rad_s], y[Y.amps_A], y[Y.T_probe_K] = x[X.speed], x[X.current], x[X.T_winding]
    return 0.0


def ripple_arguments(x: Array, u: Array) -> Array:
    """Of the motor constant's ripple, (N, 2): speed and current, scaled.

    Args:
        x: (N, nx) each state in its unit.
        u: (N, nu) inputs in their units.
    """
    return np.stack([0.045 * x[:, X.speed], 0.09 * x[:, X.current]], axis=-1)


def operate(rng: np.random.Generator, seconds: float, regime: str) -> Array:
    """Inputs (N, 2): voltage through both directions, load in held pieces."""
    voltage, load = {
        "train": ((-120.0, 170.0), (-10.0, 35.0)),
        "held": ((-80.0, 230.0), (0.0, 50.0)),
        "poor": ((150.0, 150.2), (20.0, 20.1)),
    }[regime]
    t = clock(seconds, 0.05)
    return np.stack(
        [levels(rng, t, voltage, (1.5, 25.0), (0.8, 5.0)), levels(rng, t, load, (3.0, 40.0), (0.8, 5.0))], axis=-1
    )


def start(u: Array, p: Array) -> Array:
    """A guess of the state under inputs u (2,).

    Args:
        u: (2,) inputs in their units.
        p: (n_parameters,) the law's own, each in its unit.
    """
    w = (u[U.voltage_V] - 0.6 * u[U.load_Nm]) / 1.05
    x = np.empty(len(X))
    x[X.current] = u[U.load_Nm]
    x[X.speed] = w
    x[X.T_winding] = x[X.T_frame] = 320.0
    x[X.bristle] = math.copysign(0.9, w)
    return x


def _on(
    state: str,
    effect: str,
    slot: str,
    typical: float,
    most: float,
    port: str = "balance",
    ports: tuple[str, ...] = (),
    scale: float = 1.0,
) -> Effect:
    return Effect(
        f"{effect}@{state}",
        slot,
        typical,
        most,
        (f"{port}:{state}", *ports),
        size=f"{effect}_{state}",
        scale=scale,
    )


_W, _I, _T, _V = "omega_rad_s", "current_A", "T_winding_K", "voltage_V"
MACHINE = Machine(
    name="motor",
    simulator="examples/motor.py:MOTOR",
    values={},
    calibrate=tuple(_OWN),
    inputs=_INPUTS,
    outputs=_OUTPUTS,
    parameters=_PARAMETERS,
    spread={name: 0.15 for name in _OWN if name != "T_amb_K"},
    offsets={"T_amb_K": 3.0},
    exponent=(1.9, 2.1),
    ambient=0.03,
    law=law,
    reading=reading,
    start=start,
    slow={X.current: 2.0, X.speed: 2.0, X.T_winding: 1.0},
    operate=operate,
    settle_s=120.0,
    period_s=0.05,
    fine=20,
    coarse=3,
    seconds={"train": (200.0, 200.0, 200.0), "held": (200.0, 200.0)},
    noise={
        "voltage_V": Noise(0.02, 0.0, 1.0),
        "load_Nm": Noise(0.02, 0.0, 1.0),
        "speed_rad_s": Noise(0.4, 0.25, 0.3),
        "amps_A": Noise(0.3, 0.2, 0.5),
        "T_probe_K": Noise(0.25, 0.15, 4.0),
    },
    lsb={"voltage_V": 0.01, "load_Nm": 0.01, "speed_rad_s": 0.1, "amps_A": 0.05, "T_probe_K": 0.0625},
    effects=(
        _on(_W, "coulomb_friction", "dry", 1.0, 20.0),
        _on(_W, "coulomb_friction_unequal", "dry_forward", 1.0, 20.0),
        _on(_W, "quadratic_friction", "windage", 5e-5, 2e-3),
        _on(_W, "cubic_friction", "cubic", 4e-7, 2e-5),
        _on(_W, "hysteresis", "bristles", 1.0, 20.0),
        _on(_W, "periodic", "shaker", 1.0, 20.0),
        _on(_W, "offset", "steady", 0.5, 10.0, ports=("input:load_Nm",), scale=-1.0),
        _on(_I, "constant_drop", "brushes", 20.0, 300.0),
        _on(_I, "quadratic_loss", "arc", 0.01, 0.5),
        _on(_T, "second_thermal_mass", "frame", 2e-3, 0.05),
        _on(_V, "dead_zone", "gap", 2.0, 40.0, port="input", ports=(f"balance:{_I}",)),
        _on(_V, "backlash", "play", 2.0, 40.0, port="input", ports=(f"balance:{_I}",)),
    ),
    foreign=(
        Effect("saturating_iron", "saturation", 0.05, 0.5, (f"balance:{_I}", f"balance:{_W}")),
        Effect("magnets_weaken_when_warm", "weakening", 0.02, 0.3, (f"balance:{_I}", f"balance:{_W}")),
    ),
    rippled="K_Nm_A",
    ripple_arguments=ripple_arguments,
    played={"voltage_V": "play"},
)
