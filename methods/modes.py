"""How health and sensors change, as modes of a chain. ``methods.mixing`` runs a filter for each.

At any time health stands still, or one of its parameters ramps, or one leaps, or one output is erratic, or is off, or
has just been mended.

An output that fails tells its filter nothing. One that is erratic may read anything at every tick. One that is off
reads its noise around an offset, which is learnt. Its filter remembers the machine without that output for as long as a
failure lasts. So it is there when one has crept in, and an output that has been mended is compared with it.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from twinbench.machines.coordinates import Array
from twinbench.machines.machine import Machine
from twinbench.methods.noise import health_walk_var

STAY_S = (200.0, 300.0, 5.0)
"""How long health stands still, one of its parameters ramps, or one leaps, on average. A leap takes one tick, but shows
for seconds: one second errs by a tenth more on the two tanks, twenty no less. The others matter little."""
NEXT = np.array([[0.0, 0.7, 0.3], [0.7, 0.15, 0.15], [0.7, 0.3, 0.0]])
"""Dimensionless: which of them follows which. Ramps are commoner than leaps, and most end in standing still."""
FAILED_S, FAILS_EVERY_S = 60.0, 3600.0
"""How long an output fails, and how seldom each does in either way, on average. Ten times as seldom costs a failure
2.3 of its score: one reading that is clearly off."""
WANDERS_SD = 0.3
"""By how many sd of its noise the offset of an output that is off wanders in a second. With a third of it, or three
times as much, what health errs by after a drift or a bias of a sensor changes by 6 % at most."""


class Modes(NamedTuple):
    """M modes: health stands still; a parameter ramps or leaps; an output is erratic, off or mended. One for each.

    Attributes:
        walk: (M, nh) dimensionless variances that a tick adds to the coordinates of health.
        out: (M, ny) dimensionless: 1 for an output that is not believed.
        turn: (M, M) dimensionless probabilities of going from one mode to another in a tick.
        pools: (G, M) dimensionless probabilities of going from a mode to each of one pool's, as ``pools_of`` has them.
        pool: (M,) dimensionless numbers of the modes' pools.
        lasts: (M,) dimensionless: 1 where an output is off by what it was a tick before, 0 where by anything.
        wander: dimensionless, of the variance of an output's noise: what a tick adds to that of its offset.
    """

    walk: Array
    out: Array
    turn: Array
    pools: Array
    pool: np.ndarray
    lasts: Array
    wander: float


def failing_of(machine: Machine) -> np.ndarray:
    """Positions of the outputs that may fail. One whose bias is a health parameter does not: that ramps or leaps."""
    return np.flatnonzero([not reading.bias for reading in machine.readings])


def count_of(machine: Machine) -> int:
    """How many modes a machine has."""
    return 1 + 2 * len(machine.health) + 3 * len(failing_of(machine))


def modes_of(machine: Machine, health_walk: float, still: float, leap: float) -> Modes:
    """The modes of a machine.

    Args:
        machine: whose.
        health_walk: dimensionless, of a parameter that ramps, times the walk of the machine's record.
        still: dimensionless, times that of one that ramps: the walk of one that stands still.
        leap: dimensionless sd of a leap, in the coordinates of health.
    """
    tick_s, parameters = machine.sample_period_s, len(machine.health)
    failing = failing_of(machine)
    ramp = health_walk_var(machine, health_walk)
    walk = np.tile(still**2 * ramp, (count_of(machine), 1))
    each = np.arange(parameters)
    walk[1 + each, each] = ramp
    walk[1 + parameters + each, each] = ramp + leap**2 * min(tick_s / STAY_S[-1], 1.0)
    out, lasts = np.zeros((len(walk), len(machine.outputs))), np.zeros(len(walk))
    erratic = 1 + 2 * parameters + np.arange(len(failing))
    off = erratic + len(failing)
    out[erratic, failing] = out[off, failing] = lasts[off] = 1.0
    turn = chain(parameters, len(failing), tick_s)
    return Modes(walk, out, turn, *pools_of(turn), lasts, WANDERS_SD**2 * tick_s)


def chain(parameters: int, failing: int, tick_s: float) -> Array:
    """Probabilities (M, M) of going from one mode to another in a tick.

    Args:
        parameters: of health.
        failing: outputs that may fail.
        tick_s: how long a tick is.
    """
    kind = np.repeat(range(len(STAY_S)), (1, parameters, parameters))
    leave = np.minimum(tick_s / np.array(STAY_S), 1.0)[kind]
    moving = slice(len(kind))
    fails, mended = slice(len(kind), len(kind) + 2 * failing), slice(len(kind) + 2 * failing, len(kind) + 3 * failing)
    turn = np.zeros((mended.stop,) * 2)
    turn[moving, moving] = leave[:, None] * NEXT[np.ix_(kind, kind)] / np.bincount(kind)[kind] + np.diag(1.0 - leave)
    begins, ends = min(tick_s / FAILS_EVERY_S, 0.25 / max(failing, 1)), min(tick_s / FAILED_S, 1.0)
    turn[moving] *= 1.0 - 2 * failing * begins
    turn[moving, fails] = begins
    turn[fails, fails] = (1.0 - ends) * np.eye(2 * failing)
    turn[fails, mended] = ends * np.tile(np.eye(failing), (2, 1))
    turn[mended, 0] = 1.0
    return turn


def pools_of(turn: Array) -> tuple[Array, np.ndarray]:
    """Modes that all others turn into with the same probability share a pool. What comes in is mixed once for a pool.

    Args:
        turn: (M, M) dimensionless probabilities of going from one mode to another in a tick.

    Returns:
        Dimensionless probabilities (G, M) of going from a mode to each of one pool's, and the pool (M,) of each mode.
        What the diagonal of ``turn`` has beyond these is staying.
    """
    pools: list[Array] = []
    pool, members = np.zeros(len(turn), np.int64), np.arange(len(turn))
    for j in members:
        for i in members[:j]:
            others = (members != i) & (members != j)
            if (turn[others, i] == turn[others, j]).all():
                pool[j] = pool[i]
                pools[pool[i]][i], pools[pool[i]][j] = turn[i, j], turn[j, i]
                break
        else:
            pool[j] = len(pools)
            pools.append(np.where(members == j, 0.0, turn[:, j]))
    return np.array(pools), pool


def at_first(modes: Modes) -> Array:
    """Probabilities (M,) before the first reading: those of the long run, two ticks after one at which no output fails.

    Two, since after one none has been mended, and a mode without any probability has no mixture to start from.

    Args:
        modes: of a machine.
    """
    mu = np.where(modes.out.any(axis=1), 0.0, in_the_long_run(modes.turn))
    return np.asarray(mu / mu.sum() @ modes.turn @ modes.turn)


def in_the_long_run(turn: Array) -> Array:
    """Probabilities (M,) of the modes of a chain that has gone on for long.

    Args:
        turn: (M, M) dimensionless probabilities of going from one mode to another in a tick.
    """
    return np.asarray(np.linalg.matrix_power(turn, 2**20)[0])
