"""The paper's recordings: a fresh compressor, of which at most one health parameter changes.

Speeds, ratios, suction and wear rates are those of the paper. Where the paper is silent: speed and pressure-ratio
targets hold for 60 to 240 s, so that load changes inside every sequence (at one operating point only three of the five
health parameters are observable); efficiency falls by 0.002 to 0.006 per minute; heat transfer falls over 2 to 6
minutes, in one stage or two.
"""

from __future__ import annotations

import numpy as np

from twinbench.data.batch import Array
from twinbench.data.scenario import Change, Scenario, stream
from twinbench.machines.compressor import COMPRESSOR, draw_loads

HEALTH = COMPRESSOR.health_names
HEALTHY = COMPRESSOR.coordinates.healthy
WORN = np.array([0.88, 0.90, 0.052, 0.65, 0.0])
RATE_PER_MIN = {"capacity": (0.003, 0.010), "efficiency": (0.002, 0.006), "leakage": (0.001, 0.004)}
HEAT_TRANSFER_LOSS = (0.10, 0.35)
HEAT_TRANSFER_RAMP_MIN = (2.0, 6.0)
BIAS_STEP_K = (1.5, 6.0)
KINDS = ("none", *HEALTH)
MIX = COMPRESSOR.leans
"""Latin-hypercube coordinates that ``draw`` takes."""


def draw(name: str, kind: str, seed: int, minutes: float, warmup_minutes: float, mix: Array) -> Scenario:
    """Draw one sequence of the paper's.

    Args:
        kind: what wears: one of KINDS.
        mix: (10,) dimensionless Latin-hypercube coordinates in [0, 1]: severities of the five health parameters, mean
            speed, mean ratio, mean suction, suction temperature, pace of the load changes.
    """
    rng = stream(seed, name)
    seconds, warm = 60.0 * minutes, 60.0 * warmup_minutes
    changing = () if kind == "none" else (kind,)
    return Scenario(
        machine=COMPRESSOR,
        name=name,
        kind=kind,
        seconds=seconds,
        changes=tuple(_change(p, mix[HEALTH.index(p)], warm, seconds, rng) for p in changing),
        drive=draw_loads(seconds, mix, rng),
        start=HEALTHY.copy(),
        seed=seed,
    )


def _change(parameter: str, severity: float, warm: float, seconds: float, rng: np.random.Generator) -> Change:
    """Of a fresh machine: at least a minute before, a transition, at least two minutes after, where time allows."""
    i = HEALTH.index(parameter)
    begin = warm + rng.uniform(0.04, 0.32) * (seconds - warm)
    room = 0.92 * seconds - begin
    if parameter == "T_bias_K":
        size = BIAS_STEP_K[0] + severity * (BIAS_STEP_K[1] - BIAS_STEP_K[0])
        sign = rng.choice([-1.0, 1.0])
        at = warm + rng.uniform(0.1, 0.8) * (seconds - warm)
        return Change(parameter, at, at + COMPRESSOR.sample_period_s, float(sign * size))
    if parameter == "heat_transfer":
        loss = HEAT_TRANSFER_LOSS[0] + severity * (HEAT_TRANSFER_LOSS[1] - HEAT_TRANSFER_LOSS[0])
        end = HEALTHY[i] - loss
        stages = int(rng.integers(1, 3))
        last = min(60.0 * rng.uniform(*HEAT_TRANSFER_RAMP_MIN) * (3 if stages == 2 else 1), room)
        return Change(parameter, begin, begin + last, float(end), stages)
    low, high = RATE_PER_MIN[parameter]
    rate = (low + rng.random() * (high - low)) / 60.0
    reach = (0.35 + 0.65 * severity) * (WORN[i] - HEALTHY[i])
    last = float(min(abs(reach) / rate, room))
    end = HEALTHY[i] + np.sign(reach) * rate * last
    return Change(parameter, begin, begin + last, float(end))
