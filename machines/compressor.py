"""The compressor of the paper, as a machine of the benchmark."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from twinbench.machines.coordinates import Array
from twinbench.machines.loads import along, pieces
from twinbench.machines.machine import Machine
from twinbench.machines.parts import Health, Lag, Reading
from twinbench.machines.sensors import Drift, Growth, Noise
from twinbench.physics.compressor import M_REF_KG_S, PLANT, U, Y
from twinbench.physics.nominal import NOMINAL, RECALIBRATED
from twinbench.physics.places import places
from twinbench.physics.steady import steady_state, valve_for

N_LIMITS_RPM = (900.0, 1800.0)
P_SUC_LIMITS_BAR = (0.82, 1.08)
RATIO_LIMITS = (2.36, 4.85)
"""What the valve aims at on a healthy machine at 0.95 bar."""
VALVE_LIMITS = next((v.low, v.high) for v in PLANT.inputs if v.name == "valve")
FASTER = Growth("N_rpm", 900.0, 0.7, 0.6)
"""Noise at 1800 rpm is 1.3/0.7 of that at 900."""
MEAN_SPEED, MEAN_RATIO, MEAN_SUCTION, T_SUCTION, PACE = range(5, 10)
"""Coordinates of the Latin hypercube that loads lean by; the first five are the paper's severities of wear."""


@dataclass(frozen=True)
class Loads:
    """What the compressor is run through. Knots are (time_s, value) pairs joined by straight lines.

    Attributes:
        N_rpm: (n_knots, 2) speed: seconds and rpm.
        ratio: (n_knots, 2) pressure ratio to aim at: seconds and a dimensionless ratio.
        p_suc_bar: (n_knots, 2) suction pressure: seconds and bar.
        T_suc_K: suction temperature's mean in K, period in s and phase in rad.
    """

    N_rpm: Array
    ratio: Array
    p_suc_bar: Array
    T_suc_K: tuple[float, float, float]

    def __call__(self, time_s: Array) -> Array:
        """(N, 4) true inputs in the channels' units.

        Args:
            time_s: (N,) seconds.
        """
        N, ratio, p_suc = (along(knots, time_s) for knots in (self.N_rpm, self.ratio, self.p_suc_bar))
        mean, period, phase = self.T_suc_K
        T_suc = mean + 3.0 * np.sin(2 * np.pi * time_s / period + phase)
        return np.stack([p_suc, T_suc, N, valve_for(N, ratio)], axis=-1)


def draw_loads(seconds: float, lean: Array, rng: np.random.Generator) -> Loads:
    """Loads of the paper's kind: targets hold for one to four minutes, suction for longer.

    Args:
        seconds: how long the recording lasts.
        lean: (10,) dimensionless Latin-hypercube coordinates in [0, 1].
        rng: what they are drawn from.
    """
    pace = 0.6 + 0.8 * lean[PACE]
    hold_s = (60 * pace, 240 * pace)
    return Loads(
        N_rpm=pieces(rng, seconds, N_LIMITS_RPM, lean[MEAN_SPEED], hold_s, (5.0, 20.0)),
        ratio=pieces(rng, seconds, RATIO_LIMITS, lean[MEAN_RATIO], hold_s, (4.0, 30.0)),
        p_suc_bar=pieces(rng, seconds, P_SUC_LIMITS_BAR, lean[MEAN_SUCTION], (90.0, 300.0), (0.1, 0.2)),
        T_suc_K=(288.0 + 20.0 * lean[T_SUCTION], rng.uniform(300.0, 900.0), rng.uniform(0.0, 2 * np.pi)),
    )


def stretched(loads: Loads, beyond: float) -> Loads:
    """Speeds and pressure ratios farther from the middle of what the benchmark has.

    Args:
        loads: what is stretched.
        beyond: by which share.
    """

    def far(knots: Array, limits: tuple[float, float]) -> Array:
        middle = 0.5 * (limits[0] + limits[1])
        return np.stack([knots[:, 0], middle + (1.0 + beyond) * (knots[:, 1] - middle)], axis=-1)

    return replace(loads, N_rpm=far(loads.N_rpm, N_LIMITS_RPM), ratio=far(loads.ratio, RATIO_LIMITS))


def nearly_settled(u0: Array) -> Array:
    """The plant's state (8,) a little off its operating point, in the states' units.

    Args:
        u0: (4,) inputs in their units.
    """
    return 0.98 * steady_state(PLANT, u0) + 0.02 * PLANT.initial(u0, np.array([3.0, 400.0, 0.1]), PLANT.theta())


def recombined(inputs: Array, outputs: Array, rng: np.random.Generator) -> Array:
    """(B, N, 4) inputs: each of suction pressure, suction temperature, speed and ratio from any of the recordings.

    Args:
        inputs: (B, N, 4) true ones in the channels' units.
        outputs: (B, N, 3) clean ones in the channels' units.
        rng: what is drawn from.
    """
    p_suc, T_suc, N, ratio = (rng.permutation(len(inputs)) for _ in range(4))
    ratios = (outputs[..., Y.p_dis_bar] / inputs[..., U.p_suc_bar])[ratio]
    u = inputs.copy()
    for column, drawn in ((U.p_suc_bar, p_suc), (U.T_suc_K, T_suc), (U.N_rpm, N)):
        u[..., column] = inputs[drawn, :, column]
    u[..., U.valve] = np.clip(valve_for(u[..., U.N_rpm], np.clip(ratios, *RATIO_LIMITS)), *VALVE_LIMITS)
    return u


COMPRESSOR = Machine(
    name="compressor",
    says="variable-speed reciprocating air compressor",
    plant=PLANT,
    reduced=NOMINAL,
    estimated=("p_int_bar", "p_exh_bar", "T_gas_K", "T_wall_K", "flow_memory"),
    health=(
        Health("capacity", (1.0, 0.88), walk=4e-4, counterfactual=(0.86, 1.03), farthest=0.75),
        Health("efficiency", (1.0, 0.90), walk=4e-4, counterfactual=(0.88, 1.03), farthest=0.75),
        Health("leakage", (0.015, 0.052), exponential=True, walk=1.2e-4, counterfactual=(0.008, 0.060), farthest=0.002),
        Health("heat_transfer", (1.0, 0.65), exponential=True, walk=2e-3, counterfactual=(0.60, 1.06), farthest=0.30),
        Health(
            "T_bias_K",
            (-3.0, 3.0),
            (-6.0, 6.0),
            either_way=True,
            on_readings=True,
            walk=0.05,
            counterfactual=(-7.0, 7.0),
            farthest=-11.0,
        ),
    ),
    readings=(
        Reading("p_dis_bar", "p_exh_bar", key="p", says="exhaust pressure", reads="discharge pressure"),
        Reading(
            "T_dis_K",
            "T_probe_K",
            bias="T_bias_K",
            key="T",
            says="gas temperature in degC",
            reads="discharge temperature in degC",
            zero=273.15,
        ),
        Reading("m_flow_kg_s", "flow_memory", M_REF_KG_S, key="m", says="mass flow", reads="mass flow"),
    ),
    noise=(
        Noise("p_suc_bar", 0.0015, relative=True),
        Noise("T_suc_K", 0.2),
        Noise("N_rpm", 1.5),
        Noise("valve", 0.0),
        Noise("p_dis_bar", 0.0040, 0.0025, 0.4, relative=True, grows=FASTER),
        Noise("T_dis_K", 0.6, 0.4, 3.0),
        Noise("m_flow_kg_s", 0.008, 0.005, 0.6, relative=True, grows=FASTER),
    ),
    labels={
        "p_suc_bar": "suction pressure",
        "T_suc_K": "suction temperature",
        "N_rpm": "speed",
        "valve": "valve",
        "p_dis_bar": "discharge pressure",
        "T_dis_K": "discharge temperature",
        "m_flow_kg_s": "mass flow",
        "p_int_bar": "intake pressure",
        "p_exh_bar": "exhaust pressure",
        "T_gas_K": "gas temperature",
        "T_wall_K": "wall temperature",
        "flow_memory": "flow memory",
        "capacity": "capacity",
        "efficiency": "efficiency",
        "leakage": "leakage",
        "heat_transfer": "heat transfer",
        "T_bias_K": "temperature bias",
    },
    loads=draw_loads,
    leans=10,
    lags=(Lag("T_probe_K", "T_gas_K", "tau_T_s", "flow_memory", "tau_T_x"), Lag("valve_pos", "valve", "tau_v_s")),
    drift=Drift(("p_suc_bar", "p_dis_bar"), 0.0008, 300.0),
    recalibrated=RECALIBRATED,
    state_walk={
        "p_int_bar": 1e-3,
        "p_exh_bar": 1e-3,
        "T_gas_K": 0.05,
        "T_wall_K": 0.05,
        "flow_memory": 1e-3,
        "T_probe_K": 0.01,
        "valve_pos": 1e-4,
        "T_head_K": 0.05,
    },
    state_spread={"p_int_bar": 0.006, "p_exh_bar": 0.06, "T_gas_K": 6.0, "T_wall_K": 8.0, "flow_memory": 0.04},
    least={"flow_memory": 0.05},
    query=("N_rpm", "p_dis_bar/p_suc_bar", "T_suc_K", "p_suc_bar", "valve"),
    slow=("T_dis_K",),
    silent=("m_flow_kg_s",),
    alike=(("p_int_bar", "p_exh_bar"),),
    regimes={"speed": "N_rpm", "ratio": "p_dis_bar/p_suc_bar"},
    commands=("N_rpm", "valve"),
    start=nearly_settled,
    recombine=recombined,
    stretched=stretched,
)

INPUTS, OUTPUTS, CHANNELS = COMPRESSOR.inputs, COMPRESSOR.outputs, COMPRESSOR.channels
STATES, HEALTH, ESTIMATED = COMPRESSOR.estimated, COMPRESSOR.health_names, COMPRESSOR.quantities
STATE, CHANNEL, ESTIMATE = places(STATES), places(CHANNELS), places(ESTIMATED)
"""Where states, channels and estimated quantities stand, by name; inputs stand first among the channels."""
SAMPLE_PERIOD_S = COMPRESSOR.sample_period_s
