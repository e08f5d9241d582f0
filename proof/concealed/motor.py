"""The concealed motor: armature, shaft and winding with what ``examples/motor.py`` leaves out."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from twinbench.physics.simulator import Array
from twinbench.proof.concealed.integrate import LAW
from twinbench.proof.concealed.machine import Effect, Machine, Noise, clock, levels

_NAMES = (
    "R_ohm", "L_H", "K_Nm_A", "J_kg_m2", "b_Nms", "C_J_K", "G_W_K", "T_amb_K",
    "ripple", "ripple_phase", "ambient", "ambient_phase", "exponent",
    "dry", "dry_forward", "windage", "cubic", "bristles", "brushes", "arc", "shaker", "steady", "frame", "gap", "play",
    "saturation", "weakening",
)  # fmt: skip


@njit(LAW, cache=True, error_model="numpy")
def law(t, x, u, p, dx):  # type: ignore[no-untyped-def]
    """States: current, speed, winding, frame, bristle, amplifier, and speed as sensed."""
    i, w, T, z = x[0], x[1], x[2], x[4]
    ambient = p[7] + p[10] * math.sin(2.0 * math.pi * t / 1800.0 + p[11])
    R = p[0] + p[0] * 0.0039 * (T - 293.0)
    K = p[2] * (1.0 + p[8] * math.sin(0.045 * w + p[9]) * math.cos(0.09 * i))
    K *= 1.0 - p[25] * (i / 60.0) ** 2 / (1.0 + (i / 120.0) ** 2) - p[26] * (T - 330.0) / 30.0
    n = p[12]

    V = u[0]
    if p[23] > 0.0:
        V -= p[23] * math.tanh(u[0] / p[23])  # a dead zone with a soft knee
    if p[24] > 0.0:
        V = x[5]

    # Drops of current and speed per second: brushes, arcing; friction (Coulomb's falls a little from standstill on).
    drop = p[18] * i / math.sqrt(i * i + 0.5) + p[19] * math.copysign(abs(i) ** n, i) * 40.0 ** (2.0 - n)
    sense = w / math.sqrt(w * w + 2.0)
    slow = p[13] * sense * (1.0 + 0.05 * math.exp(-((w / 12.0) ** 2))) + p[17] * z
    if w > 0.0:
        slow += p[14] * sense
    slow += p[15] * math.copysign(abs(w) ** n, w) * 120.0 ** (2.0 - n)
    slow += p[16] * math.copysign(abs(w) ** (n + 1.0), w) * 120.0 ** (2.0 - n)
    slow += p[21] - p[20] * math.sin(2.0 * math.pi * t / 7.3 + 0.4)

    dx[0] = (V - R * i - K * w) / p[1] - drop
    dx[1] = (K * i - p[4] * w - u[1]) / p[3] - slow
    dx[2] = (R * i * i - p[6] * (T - ambient)) / p[5] - p[22] * (T - x[3])
    dx[3] = (T - x[3]) / 260.0
    toward = 1.0 - z if w > 0.0 else 1.0 + z
    dx[4] = w / 12.0 * max(toward, 0.0) ** 1.1
    behind = u[0] - x[5]
    beyond = max(behind - 0.5 * p[24], 0.0) + min(behind + 0.5 * p[24], 0.0)
    dx[5] = beyond / 0.02
    dx[6] = (w - x[6]) / 0.003
    return 0.0


@njit(LAW, cache=True, error_model="numpy")
def reading(t, x, u, p, y):  # type: ignore[no-untyped-def]
    """speed_rad_s, amps_A, T_probe_K."""
    y[0], y[1], y[2] = x[6], x[0], x[2]
    return 0.0


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
    w = (u[0] - 0.6 * u[1]) / 1.05
    return np.array([u[1], w, 320.0, 320.0, math.copysign(0.9, w), u[0], w])


def _on(
    state: str,
    effect: str,
    slot: str,
    typical: float,
    most: float,
    port: str = "balance",
    also: tuple[str, ...] = (),
    ports: tuple[str, ...] = (),
) -> Effect:
    return Effect(
        f"{effect}@{state}",
        slot,
        typical,
        most,
        (f"{effect}@{state}", *also),
        (f"{port}:{state}", *ports),
        size=f"{effect}_{state}",
    )


_W, _I, _T, _V = "omega_rad_s", "current_A", "T_winding_K", "voltage_V"
MACHINE = Machine(
    name="motor",
    simulator="examples/motor.py:MOTOR",
    values={},
    calibrate=_NAMES[:8],
    inputs=("voltage_V", "load_Nm"),
    outputs=("speed_rad_s", "amps_A", "T_probe_K"),
    parameters=dict(zip(_NAMES, (0.6, 0.08, 1.0, 1.5, 0.05, 4000.0, 25.0, 295.0) + (0.0,) * 19, strict=True)),
    spread=dict.fromkeys(_NAMES[:7], 0.15),
    offsets={"T_amb_K": 3.0},
    exponent=(1.9, 2.1),
    ambient=0.03,
    law=law,
    reading=reading,
    start=start,
    slow={0: 2.0, 1: 2.0, 2: 1.0},
    operate=operate,
    settle_s=120.0,
    period_s=0.05,
    fine=20,
    coarse=9,
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
        _on(_W, "offset", "steady", 0.5, 10.0, also=("input_bias@load_Nm",), ports=("input:load_Nm",)),
        _on(_I, "constant_drop", "brushes", 20.0, 300.0),
        _on(_I, "quadratic_loss", "arc", 0.01, 0.5),
        _on(_T, "second_thermal_mass", "frame", 2e-3, 0.05),
        _on(_V, "dead_zone", "gap", 2.0, 40.0, port="input", ports=(f"balance:{_I}",)),
        _on(_V, "backlash", "play", 2.0, 40.0, port="input", ports=(f"balance:{_I}",)),
    ),
    foreign=(
        Effect("saturating_iron", "saturation", 0.05, 0.5, (), (f"balance:{_I}", f"balance:{_W}")),
        Effect("magnets_weaken_when_warm", "weakening", 0.02, 0.3, (), (f"balance:{_I}", f"balance:{_W}")),
    ),
    confusable=(
        ("coulomb_friction@omega_rad_s", "hysteresis@omega_rad_s"),
        ("coulomb_friction@omega_rad_s", "coulomb_friction_unequal@omega_rad_s"),
        ("quadratic_friction@omega_rad_s", "cubic_friction@omega_rad_s"),
        ("constant_drop@current_A", "quadratic_loss@current_A"),
        ("dead_zone@voltage_V", "backlash@voltage_V"),
    ),
)
