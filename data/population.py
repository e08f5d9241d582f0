"""A population of worn machines: where their health starts, and how it moves while they are watched.

Nobody's machine is fresh on the first day that a twin runs beside it. Here every recording starts anywhere in a
machine's life, and up to four of the five health parameters change: they wear slowly or at once, recover, or wear and
come back. Training, validation, test and the learners' re-simulations share this population, and its mean and
covariance are what every filter starts from. The paper's recordings, fresh machines with one change each, are drawn
by ``data.scenario.draw``.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from twinbench.data.batch import HEALTH, SAMPLE_PERIOD_S, Array
from twinbench.data.scenario import MIX, WORN, Change, Scenario, draw, latin_hypercube, stream
from twinbench.physics.health import HEALTHY, SPAN, to_zeta

COMMISSIONING_S = 300.0
"""The first minutes of a recording are reported and not ranked: they ask how fast an estimator finds its place."""
COMMISSIONING_SHARE = 0.2
"""Of a recording, at most: a short one is commissioned sooner. Nothing changes within that share."""
BIAS_START_K, BIAS_LIMIT_K = 3.0, float(SPAN[HEALTH.index("T_bias_K")])
"""A machine's temperature sensor starts within the first of its truth, and never errs by more than the second."""
SIZE = (0.4, 0.9)
"""Of a change, in the parameter's life range: large enough that holding the true start loses to a filter."""
BEGIN_MIN, RAMP_MIN = (6.0, 14.0), (3.0, 8.0)
"""When a change begins and how long a slow one takes, in minutes of a recording of USUAL_MIN."""
USUAL_MIN = 25.0
REST_MIN, LEAST_LEFT_MIN = 1.0, 2.5
"""A parameter that wears and comes back stays worn for the first, and is back the second before the end at latest."""
COURSES = {"ramp": 0.4, "step": 0.2, "recovery": 0.1, "sudden recovery": 0.1, "wear and back": 0.2}
"""How a parameter may move, and how often each comes."""
BLOCK = (0, 2, 2, 2, 3, 3, 3, 4, 4, 4)
"""How many parameters change in each of ten recordings; the order is drawn."""

_BIAS = HEALTH.index("T_bias_K")
_LOW = np.where(np.arange(len(HEALTH)) == _BIAS, -BIAS_LIMIT_K, np.minimum(HEALTHY, WORN))
_HIGH = np.where(np.arange(len(HEALTH)) == _BIAS, BIAS_LIMIT_K, np.maximum(HEALTHY, WORN))


def start_of(wear: Array) -> Array:
    """Health (..., 5) in the parameters' units of a machine that is worn by so much.

    Args:
        wear: (..., 5) dimensionless, order HEALTH: 0 is healthy and 1 worn; of the temperature bias its lowest
            and its highest value.
    """
    health = HEALTHY + wear * (WORN - HEALTHY)
    health[..., _BIAS] = BIAS_START_K * (2.0 * wear[..., _BIAS] - 1.0)
    return health


def _prior() -> tuple[Array, Array]:
    """Mean (5,) and covariance (5, 5) of the starts in the filters' coordinates, by the midpoint rule."""
    wear = (np.arange(10_000) + 0.5) / 10_000
    zeta = to_zeta(start_of(np.tile(wear[:, None], (1, len(HEALTH)))))
    return zeta.mean(axis=0), np.diag(zeta.var(axis=0))


PRIOR_MEAN, PRIOR_COV = _prior()
"""Of health at the start, (5,) and (5, 5), dimensionless coordinates zeta: what every filter knows before it reads."""


def commissioning_s(duration_s: float) -> float:
    """How much of the beginning of a recording is commissioning, in seconds."""
    return min(COMMISSIONING_S, COMMISSIONING_SHARE * duration_s)


def changing(block: int, *axes: object) -> list[tuple[int, ...]]:
    """Which parameters change in each recording of a block of ten, as positions in HEALTH; all about equally often."""
    rng = stream(*axes, "block", block)
    used, chosen = np.zeros(len(HEALTH)), []
    for count in rng.permutation(BLOCK):
        order = np.lexsort((rng.random(len(HEALTH)), used))[:count]
        used[order] += 1
        chosen.append(tuple(int(i) for i in order))
    return chosen


def courses(
    start: Array, parameters: tuple[int, ...], warm_s: float, seconds: float, rng: np.random.Generator
) -> tuple[Change, ...]:
    """How health moves in one recording.

    Args:
        start: (5,) health at the beginning in the parameters' units, order HEALTH.
        parameters: which of them change, as positions in HEALTH.
        warm_s: how long the warm-up is, which nobody sees and in which nothing changes.
        seconds: how long all of it is.
        rng: what is random about it.
    """
    changes: list[Change] = []
    for i in parameters:
        changes += _course(i, float(start[i]), warm_s, seconds, rng)
    return tuple(changes)


def _course(i: int, start: float, warm_s: float, seconds: float, rng: np.random.Generator) -> list[Change]:
    kind = str(rng.choice(list(COURSES), p=list(COURSES.values())))
    kept_min = (seconds - warm_s) / 60.0
    pace = kept_min / USUAL_MIN
    begin = warm_s + 60.0 * pace * rng.uniform(*BEGIN_MIN)
    ramp = 60.0 * min(pace, 1.0) * rng.uniform(*RAMP_MIN)
    size, back, sign = rng.uniform(*SIZE), rng.random(), float(rng.choice([-1.0, 1.0]))
    end = _end(i, start, size, "recovery" in kind, sign)
    if kind != "wear and back":
        sudden = "step" in kind or "sudden" in kind
        return [Change(HEALTH[i], begin, begin + (SAMPLE_PERIOD_S if sudden else ramp), end)]
    rest, left = (60.0 * min(pace, 1.0) * minutes for minutes in (REST_MIN, LEAST_LEFT_MIN))
    last = seconds - left
    worn = min(begin + ramp, last - rest)
    at = worn + rest + back * (last - rest - worn)
    return [Change(HEALTH[i], begin, worn, end), Change(HEALTH[i], at, at + SAMPLE_PERIOD_S, start)]


def _end(i: int, start: float, size: float, recovers: bool, sign: float) -> float:
    """Where a change ends: ``size`` of the life range on towards wear, or back; turned round where no room is left."""
    towards = np.sign(WORN[i] - HEALTHY[i]) if i != _BIAS else sign if start == 0.0 or not recovers else np.sign(start)
    towards = float(-towards if recovers else towards)
    ends = [float(np.clip(start + way * size * SPAN[i], _LOW[i], _HIGH[i])) for way in (towards, -towards)]
    return ends[0] if abs(ends[0] - start) >= SIZE[0] * SPAN[i] else ends[1]


def worn_machines(part: str, count: int, size: int, seed: int, minutes: float, warmup_minutes: float) -> list[Scenario]:
    """The population's recordings of one part. A recording does not depend on how many others there are.

    Args:
        part: what it is for, and what its recordings are called: ``test-07``.
        count: how many.
        size: rows of a Latin hypercube.
        seed: of everything that is drawn.
        minutes: how long each is, warm-up included.
        warmup_minutes: how much of that nobody sees.
    """
    mixes = latin_hypercube(count, size, MIX + len(HEALTH), seed, part, "population")
    scenarios = []
    for k in range(count):
        name = f"{part}-{k:02d}"
        start = start_of(mixes[k, MIX:])
        parameters = changing(k // len(BLOCK), seed, part)[k % len(BLOCK)]
        load = draw(name, "none", seed, minutes, warmup_minutes, mixes[k, :MIX])
        moves = courses(start, parameters, 60.0 * warmup_minutes, load.seconds, stream(seed, name, "health"))
        scenarios.append(replace(load, kind="population", start=start, changes=moves))
    return scenarios
