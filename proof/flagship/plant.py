"""The machines of the flagship study, drawn from a seed: what is true of each, and what the engine has to find."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from twinbench.data.scenario import stream
from twinbench.physics.compressor import PLANT
from twinbench.physics.mechanisms import CATALOGUE
from twinbench.physics.nominal import NOMINAL, REDUCED
from twinbench.physics.simulator import Mechanism, Simulator

CELLS = ("plain", "left_out", "nominal", "enriched", "loose")
"""The plant as it is; the same recordings with one or two of its effects taken out of the catalogue; recordings of
the nominal model itself; the plant with two effects more; the plant with constants that nobody knows well."""
EFFECTS = tuple(m for m in CATALOGUE if m.parameters[0].name in REDUCED)
"""What the nominal model leaves out of every plant."""
SIZE_RANGE = (0.6, 1.4)
"""An effect's size over that of ``physics.compressor``, both measured from what the nominal model has of it."""
CALIBRATED = {"V_d_m3": 0.05, "eta_0": 0.02, "UA_gw_W_K": 0.15}
"""How far the parameters that the engine calibrates lie off, as a share, evenly either way."""
UNKNOWN = ("UA_c_W_K", "C_w_J_K", "V_int_m3", "a_in", "V_exh_m3", "tau_v_s", "tau_m_s", "UA_ha_W_K", "C_h_J_K")
UNKNOWN_SHARE = 0.03
"""In cell ``loose`` constants that no mechanism is about lie off by up to this share; the engine is told which, and
how far."""
SEPARABLE = (
    "suction_valve_loss", "suction_preheat", "leak_reheating", "wall_conductance_with_flow", "efficiency_off_design",
    "probe_lag_with_flow", "isothermal_manifold",
)  # fmt: skip
"""Effects that a catalogue can be made to lack: of each other pair one stands in for the other on any such data
(discharge valve loss and efficiency with speed, say), and nothing would be missing."""
ADDED = ("recycle_leak", "external_leak", "larger_clearance", "filter_fouling", "discharge_heat_loss", "motor_slip",
         "stem_conduction", "flow_meter_gain")  # fmt: skip
"""Effects that an enriched plant has two of."""


@dataclass(frozen=True)
class Item:
    """One case: a cell of CELLS and the number of the plant that it is about."""

    cell: str
    number: int

    @property
    def name(self) -> str:
        return f"{self.number:02d}-{self.cell}"


@dataclass(frozen=True)
class Effect:
    """An effect that the plant has and the nominal model has not: ``true`` and ``absent`` values of its parameter."""

    name: str
    parameter: str
    true: float
    absent: float


@dataclass(frozen=True)
class Plant:
    """A true machine.

    Attributes:
        simulator: its equations and parameters, what the oracle knows.
        effects: what the engine has to name.
        constants: what the engine is told to calibrate besides, to ``UNKNOWN_SHARE``.
        without: mechanisms that the engine's catalogue lacks.
    """

    simulator: Simulator
    effects: tuple[Effect, ...]
    without: tuple[str, ...]
    constants: tuple[str, ...]


def draw(item: Item, seed: int) -> Plant:
    """The plant of a case; cells ``plain`` and ``left_out`` of one number have the same plant."""
    rng = stream(seed, "flagship", item.number)
    nominal = NOMINAL.theta()
    values = {n: _off(nominal[NOMINAL.index(n)], share, rng) for n, share in CALIBRATED.items()}
    if item.cell == "nominal":
        return Plant(replace(NOMINAL.with_values(**values), name="plant"), (), (), ())
    off = {n: _off(nominal[NOMINAL.index(n)], UNKNOWN_SHARE, rng) for n in UNKNOWN}
    effects = [_effect(m, PLANT.theta()[PLANT.index(m.parameters[0].name)], rng) for m in EFFECTS]
    without = tuple(str(n) for n in rng.choice(SEPARABLE, rng.integers(1, 3), replace=False))
    if item.cell == "enriched":
        known = {m.name: m for m in CATALOGUE}
        effects += [_effect(known[n], known[n].parameters[0].nominal, rng) for n in rng.choice(ADDED, 2, replace=False)]
    values |= {e.parameter: e.true for e in effects} | (off if item.cell == "loose" else {})
    simulator = replace(PLANT.with_values(**values), name="plant")
    return Plant(
        simulator, tuple(effects), without if item.cell == "left_out" else (), UNKNOWN if item.cell == "loose" else ()
    )


def _off(value: float, share: float, rng: np.random.Generator) -> float:
    return float(value * (1.0 + share * rng.uniform(-1.0, 1.0)))


def _effect(mechanism: Mechanism, typical: float, rng: np.random.Generator) -> Effect:
    """Of a drawn size; the exhaust volume's energy balance is there or not."""
    v = mechanism.parameters[0]
    absent = float(NOMINAL.theta()[NOMINAL.index(v.name)])
    share = 1.0 if v.name == "iso" else rng.uniform(*SIZE_RANGE)
    return Effect(mechanism.name, v.name, float(absent + share * (typical - absent)), absent)
