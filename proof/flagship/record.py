"""How a drawn plant is run and recorded.

There are six training recordings. Another regime has three for the engine's proof and three for the filter.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from twinbench.data.batch import Array, Batch, Truth
from twinbench.data.corrupt import Corruption, corrupt
from twinbench.data.fresh import HEALTH, MIX, draw
from twinbench.data.scenario import Scenario, stream
from twinbench.machines.compressor import COMPRESSOR, Loads
from twinbench.physics.integrate import Varying, simulate
from twinbench.physics.simulator import Simulator
from twinbench.physics.steady import steady_state
from twinbench.proof.concealed.machine import levels

WARMUP_MIN = 5.0
SUBSTEPS = 5
"""Runge-Kutta steps per sample; the engine and the filters take one or two, or step over whole blocks."""


@dataclass(frozen=True)
class Part:
    """Recordings of one kind: their regime as (low, high) of each input, and what wears in each."""

    name: str
    minutes: float
    N_rpm: tuple[float, float]
    ratio: tuple[float, float]
    p_suc_bar: tuple[float, float]
    T_suc_K: tuple[float, float]
    wear: tuple[tuple[str, ...], ...]
    pace: float  # share of the benchmark's rates of wear


TRAINING = Part(
    "train", 15.0, (900.0, 1500.0), (2.25, 4.0), (0.86, 1.08), (286.0, 300.0),
    ((), (), ("leakage", "capacity"), ("efficiency",), ("heat_transfer",), HEALTH), 0.5,
)  # fmt: skip
HELD_OUT = Part("held", 25.0, (1200.0, 1800.0), (2.9, 4.85), (0.82, 1.0), (299.0, 310.0), (HEALTH, HEALTH, HEALTH), 1.0)
PROOF = replace(HELD_OUT, name="proof")
"""What the engine holds its findings against. The filter runs on other recordings, which the engine never sees."""
SWING_K = 3.0
"""Swing of the suction temperature that ``Loads`` adds."""
HOLD_S = (15.0, 240.0)
"""Loads hold this long, evenly drawn in the logarithm: quick changes tell laws of flow apart, slow ones show metal."""


def record(simulator: Simulator, part: Part, seed: int, number: int) -> Batch:
    """The recordings of one part with their truth; the same plant, seed and number give the same."""
    scenarios = [_scenario(part, i, seed, number) for i in range(len(part.wear))]
    u, health = np.stack([s.inputs() for s in scenarios]), np.stack([s.health() for s in scenarios])
    x0 = np.stack([steady_state(simulator, row) for row in u[:, 0]])
    x, y = simulate(simulator, u, x0, substeps=SUBSTEPS, varying=Varying(HEALTH, health))
    if not np.isfinite(y).all():
        raise FloatingPointError(f"plant {number} of seed {seed} diverged while {part.name} was recorded")
    sensors = [stream(seed, "flagship", number, s.name, "sensors") for s in scenarios]
    measured = np.stack([corrupt(COMPRESSOR, a, b, Corruption(), rng) for a, b, rng in zip(u, y, sensors, strict=True)])
    warm = round(60.0 * WARMUP_MIN / COMPRESSOR.sample_period_s)
    u, health, x, y, measured = (np.ascontiguousarray(a[:, warm:]) for a in (u, health, x, y, measured))
    time_s = np.arange(u.shape[1], dtype=np.float64) * COMPRESSOR.sample_period_s
    return Batch(tuple(s.name for s in scenarios), time_s, measured, Truth(x, health, y, u))


def _scenario(part: Part, i: int, seed: int, number: int) -> Scenario:
    """The benchmark's wear at the part's pace, under a load of the part's regime."""
    name = f"{part.name}_{i + 1}"
    rng = stream(seed, "flagship", number, name)
    minutes = WARMUP_MIN + part.minutes
    worn = [draw(f"{number}-{name}-{p}", p, seed, minutes, WARMUP_MIN, rng.random(MIX)) for p in part.wear[i]]
    idle = draw(f"{number}-{name}", "none", seed, minutes, WARMUP_MIN, rng.random(MIX))
    slowed = tuple(
        replace(c, end=float(s.start[HEALTH.index(c.parameter)] * (1.0 - part.pace) + c.end * part.pace))
        for s in worn
        for c in s.changes
    )
    mean = rng.uniform(part.T_suc_K[0] + SWING_K, part.T_suc_K[1] - SWING_K)
    assert isinstance(idle.drive, Loads)
    drive = Loads(
        N_rpm=_held(rng, idle, part.N_rpm, HOLD_S, (5.0, 20.0)),
        ratio=_held(rng, idle, part.ratio, HOLD_S, (4.0, 30.0)),
        p_suc_bar=_held(rng, idle, part.p_suc_bar, (90.0, 300.0), (0.1, 0.2)),
        T_suc_K=(mean, *idle.drive.T_suc_K[1:]),
    )
    return replace(idle, name=name, drive=drive, changes=slowed)


def _held(
    rng: np.random.Generator,
    scenario: Scenario,
    limits: tuple[float, float],
    hold_s: tuple[float, float],
    ramp_s: tuple[float, float],
) -> Array:
    """Knots (N, 2) of held levels joined by ramps."""
    t = scenario.time_s()
    return np.stack([t, levels(rng, t, limits, hold_s, ramp_s)], axis=-1)
