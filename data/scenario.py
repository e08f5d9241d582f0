"""What a machine goes through in one sequence: load, suction, wear. All of it drawn from a seed.

Speeds, ratios, suction and wear rates are those of the paper. Where the paper is silent: speed and
pressure-ratio targets hold for 60 to 240 s, so that load changes inside every sequence (at one
operating point only three of the five health parameters are observable); efficiency falls by 0.002
to 0.006 per minute; heat transfer falls over 2 to 6 minutes, in one stage or two.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass

import numpy as np
from scipy.stats import qmc

from twinbench.data.batch import HEALTH, SAMPLE_PERIOD_S, Array
from twinbench.physics.health import HEALTHY
from twinbench.physics.steady import valve_for

N_LIMITS_RPM = (900.0, 1800.0)
P_SUC_LIMITS_BAR = (0.82, 1.08)
RATIO_LIMITS = (2.36, 4.85)  # what the valve aims at on a healthy machine at 0.95 bar
WORN = np.array([0.88, 0.90, 0.052, 0.65, 0.0])
RATE_PER_MIN = {"capacity": (0.003, 0.010), "efficiency": (0.002, 0.006), "leakage": (0.001, 0.004)}
HEAT_TRANSFER_LOSS = (0.10, 0.35)
HEAT_TRANSFER_RAMP_MIN = (2.0, 6.0)
BIAS_STEP_K = (1.5, 6.0)
KINDS = ("none", *HEALTH)
MIX = 10
"""Latin-hypercube coordinates that ``draw`` takes."""


@dataclass(frozen=True)
class Change:
    """One health parameter: from where it was to ``end`` between ``begin_s`` and ``finish_s``."""

    parameter: str
    begin_s: float
    finish_s: float
    end: float
    stages: int = 1  # 2: half of it, a pause as long as a stage, the other half


@dataclass(frozen=True)
class Scenario:
    """One sequence, warm-up included. Knots are (time_s, value) pairs joined by straight lines.

    Attributes:
        seconds: how long it lasts.
        N_rpm: (n_knots, 2) speed: seconds and rpm.
        ratio: (n_knots, 2) pressure ratio to aim at: seconds and a dimensionless ratio.
        p_suc_bar: (n_knots, 2) suction pressure: seconds and bar.
        T_suc_K: suction temperature's mean in K, period in s and phase in rad.
        start: (5,) health at the beginning in the parameters' units, order HEALTH.
        changes: what wears, and when; of one parameter one after another.
    """

    name: str
    kind: str
    seconds: float
    N_rpm: Array
    ratio: Array
    p_suc_bar: Array
    T_suc_K: tuple[float, float, float]
    start: Array
    changes: tuple[Change, ...]
    seed: int

    @property
    def samples(self) -> int:
        """Ticks, warm-up included."""
        return round(self.seconds / SAMPLE_PERIOD_S)

    def time_s(self) -> Array:
        """(N,) from 0."""
        return np.arange(self.samples, dtype=np.float64) * SAMPLE_PERIOD_S

    def inputs(self) -> Array:
        """(N, 4) true inputs, order INPUTS."""
        t = self.time_s()
        N, ratio, p_suc = (np.interp(t, knots[:, 0], knots[:, 1]) for knots in (self.N_rpm, self.ratio, self.p_suc_bar))
        mean, period, phase = self.T_suc_K
        T_suc = mean + 3.0 * np.sin(2 * np.pi * t / period + phase)
        return np.stack([p_suc, T_suc, N, valve_for(N, ratio)], axis=-1)

    def health(self) -> Array:
        """(N, 5) true health, order HEALTH."""
        return health_of(self.start, self.changes, self.time_s())


def health_of(start: Array, changes: tuple[Change, ...], time_s: Array) -> Array:
    """(N, 5) health in the parameters' units, order HEALTH.

    Args:
        start: (5,) at the beginning, in the same units.
        changes: what moves; of one parameter one after another.
        time_s: (N,) in seconds.
    """
    values = np.tile(start, (len(time_s), 1))
    for change in changes:
        i = HEALTH.index(change.parameter)
        begin, finish, a, b = change.begin_s, change.finish_s, values[-1, i], change.end
        if change.stages == 2:
            third, middle = (finish - begin) / 3, 0.5 * (a + b)
            knots = ([begin, begin + third, finish - third, finish], [a, middle, middle, b])
        else:
            knots = ([begin, finish], [a, b])
        later = time_s >= begin
        values[later, i] = np.interp(time_s[later], *knots)
    return values


def stream(*axes: object) -> np.random.Generator:
    """A random stream named by its axes; independent of how many others there are."""
    digest = hashlib.sha256(repr(axes).encode()).digest()
    return np.random.default_rng(int.from_bytes(digest[:8], "little"))


def draw(name: str, kind: str, seed: int, minutes: float, warmup_minutes: float, mix: Array) -> Scenario:
    """Draw one sequence of the paper's: a fresh machine, of which at most one health parameter changes.

    Args:
        kind: what wears: one of KINDS.
        mix: (10,) dimensionless Latin-hypercube coordinates in [0, 1]: severities of the five health parameters, mean
            speed, mean ratio, mean suction, suction temperature, pace of the load changes.
    """
    rng = stream(seed, name)
    seconds, warm = 60.0 * minutes, 60.0 * warmup_minutes
    pace = 0.6 + 0.8 * mix[9]
    changing = () if kind == "none" else (kind,)
    return Scenario(
        name=name,
        kind=kind,
        seconds=seconds,
        changes=tuple(_change(p, mix[HEALTH.index(p)], warm, seconds, rng) for p in changing),
        N_rpm=_pieces(rng, seconds, N_LIMITS_RPM, mix[5], (60 * pace, 240 * pace), (5.0, 20.0)),
        ratio=_pieces(rng, seconds, RATIO_LIMITS, mix[6], (60 * pace, 240 * pace), (4.0, 30.0)),
        p_suc_bar=_pieces(rng, seconds, P_SUC_LIMITS_BAR, mix[7], (90.0, 300.0), (0.1, 0.2)),
        T_suc_K=(288.0 + 20.0 * mix[8], rng.uniform(300.0, 900.0), rng.uniform(0.0, 2 * np.pi)),
        start=HEALTHY.copy(),
        seed=seed,
    )


def _pieces(
    rng: np.random.Generator,
    seconds: float,
    limits: tuple[float, float],
    lean: float,
    hold_s: tuple[float, float],
    ramp_s: tuple[float, float],
) -> Array:
    """Held levels joined by ramps; ``lean`` in [0, 1] tilts the levels to the low or high end."""
    power = 2.0 ** (1.0 - 2.0 * lean)

    def level() -> float:
        return limits[0] + (limits[1] - limits[0]) * float(rng.random()) ** power

    knots = [(0.0, level())]
    while knots[-1][0] < seconds:
        leave = knots[-1][0] + rng.uniform(*hold_s)
        knots += [(leave, knots[-1][1]), (leave + rng.uniform(*ramp_s), level())]
    return np.array(knots)


def _change(parameter: str, severity: float, warm: float, seconds: float, rng: np.random.Generator) -> Change:
    """Of a fresh machine: at least a minute before, a transition, at least two minutes after, where time allows."""
    i = HEALTH.index(parameter)
    begin = warm + rng.uniform(0.04, 0.32) * (seconds - warm)
    room = 0.92 * seconds - begin
    if parameter == "T_bias_K":
        size = BIAS_STEP_K[0] + severity * (BIAS_STEP_K[1] - BIAS_STEP_K[0])
        sign = rng.choice([-1.0, 1.0])
        at = warm + rng.uniform(0.1, 0.8) * (seconds - warm)
        return Change(parameter, at, at + SAMPLE_PERIOD_S, float(sign * size))
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


def latin_hypercube(count: int, size: int, columns: int, *axes: object) -> Array:
    """(count, columns) coordinates in [0, 1]: hypercubes of ``size`` rows, one after another, so that a row does not
    depend on how many others are asked for.
    """
    sampler = qmc.LatinHypercube(columns, seed=stream(*axes, size))
    return np.concatenate([sampler.random(size) for _ in range(max(1, -(-count // size)))])[:count]
