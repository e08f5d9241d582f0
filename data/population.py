"""A population of worn machines: where their health starts, and how it moves while they are watched.

Nobody's machine is fresh on the first day that a twin runs beside it. Here every recording starts anywhere in a
machine's life, and up to four of its health parameters change: they wear slowly or at once, recover, or wear and
come back. Training, validation, test and the learners' re-simulations share this population, and its mean and
covariance are what every filter starts from. The paper's recordings, fresh machines with one change each, are drawn
by ``data.fresh.draw``.
"""

from __future__ import annotations

import numpy as np

from twinbench.data.batch import Array
from twinbench.data.scenario import Change, Scenario, latin_hypercube, stream
from twinbench.machines.machine import Machine
from twinbench.machines.parts import Health

COMMISSIONING_S = 300.0
"""The first minutes of a recording are reported and not ranked: they ask how fast an estimator finds its place."""
COMMISSIONING_SHARE = 0.2
"""Of a recording, at most: a short one is commissioned sooner. Nothing changes within that share."""
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
"""How many parameters change in each of ten recordings; the order is drawn. A machine of few has no more of them."""


def commissioning_s(duration_s: float) -> float:
    """How much of the beginning of a recording is commissioning, in seconds."""
    return min(COMMISSIONING_S, COMMISSIONING_SHARE * duration_s)


def changing(parameters: int, block: int, *axes: object) -> list[tuple[int, ...]]:
    """Which parameters change in each recording of a block of ten, as positions; all about equally often.

    Args:
        parameters: how many the machine has.
        block: which block.
        axes: what names its random stream.
    """
    rng = stream(*axes, "block", block)
    used, chosen = np.zeros(parameters), []
    for count in rng.permutation(BLOCK):
        order = np.lexsort((rng.random(parameters), used))[:count]
        used[order] += 1
        chosen.append(tuple(int(i) for i in order))
    return chosen


def courses(
    machine: Machine,
    start: Array,
    parameters: tuple[int, ...],
    warm_s: float,
    seconds: float,
    rng: np.random.Generator,
) -> tuple[Change, ...]:
    """How health moves in one recording.

    Args:
        machine: whose.
        start: (nh,) health at the beginning in the parameters' units.
        parameters: which of them change, as positions.
        warm_s: how long the warm-up is, which nobody sees and in which nothing changes.
        seconds: how long all of it is.
        rng: what is random about it.
    """
    changes: list[Change] = []
    for i in parameters:
        changes += _course(machine, i, float(start[i]), warm_s, seconds, rng)
    return tuple(changes)


def _course(
    machine: Machine, i: int, start: float, warm_s: float, seconds: float, rng: np.random.Generator
) -> list[Change]:
    health, tick_s = machine.health[i], machine.sample_period_s
    kind = str(rng.choice(list(COURSES), p=list(COURSES.values())))
    kept_min = (seconds - warm_s) / 60.0
    pace = kept_min / USUAL_MIN
    begin = warm_s + 60.0 * pace * rng.uniform(*BEGIN_MIN)
    ramp = 60.0 * min(pace, 1.0) * rng.uniform(*RAMP_MIN)
    size, back, sign = rng.uniform(*SIZE), rng.random(), float(rng.choice([-1.0, 1.0]))
    end = _end(health, start, size, "recovery" in kind, sign)
    if kind != "wear and back":
        sudden = "step" in kind or "sudden" in kind
        return [Change(health.name, begin, begin + (tick_s if sudden else ramp), end)]
    rest, left = (60.0 * min(pace, 1.0) * minutes for minutes in (REST_MIN, LEAST_LEFT_MIN))
    last = seconds - left
    worn = min(begin + ramp, last - rest)
    at = worn + rest + back * (last - rest - worn)
    return [Change(health.name, begin, worn, end), Change(health.name, at, at + tick_s, start)]


def _end(health: Health, start: float, size: float, recovers: bool, sign: float) -> float:
    """Where a change ends: ``size`` of the life range on towards wear, or back; turned round where no room is left."""
    fresh, worn = health.ends
    towards = sign if start == 0.0 or not recovers else np.sign(start)
    towards = float(towards if health.either_way else np.sign(worn - fresh))
    towards = -towards if recovers else towards
    low, high = sorted(health.ends)
    ends = [float(np.clip(start + way * size * health.span, low, high)) for way in (towards, -towards)]
    return ends[0] if abs(ends[0] - start) >= SIZE[0] * health.span else ends[1]


def worn_machines(
    machine: Machine, part: str, count: int, size: int, seed: int, minutes: float, warmup_minutes: float
) -> list[Scenario]:
    """The population's recordings of one part. A recording does not depend on how many others there are.

    Args:
        machine: of which kind.
        part: what it is for, and what its recordings are called: ``test-07``.
        count: how many.
        size: rows of a Latin hypercube.
        seed: of everything that is drawn.
        minutes: how long each is, warm-up included.
        warmup_minutes: how much of that nobody sees.
    """
    parameters = len(machine.health)
    mixes = latin_hypercube(count, size, machine.leans + parameters, seed, part, "population")
    seconds, warm_s = 60.0 * minutes, 60.0 * warmup_minutes
    scenarios = []
    for k in range(count):
        name = f"{part}-{k:02d}"
        lean, start = mixes[k, : machine.leans], machine.start_of(mixes[k, machine.leans :])
        moving = changing(parameters, k // len(BLOCK), seed, part)[k % len(BLOCK)]
        moves = courses(machine, start, moving, warm_s, seconds, stream(seed, name, "health"))
        drive = machine.loads(seconds, lean, stream(seed, name))
        scenarios.append(Scenario(machine, name, "population", seconds, drive, start, moves, seed))
    return scenarios
