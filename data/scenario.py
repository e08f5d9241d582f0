"""What a machine goes through in one recording: loads, and how its health moves. All of it drawn from a seed."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass

import numpy as np
from scipy.stats import qmc

from twinbench.data.batch import Array
from twinbench.machines.machine import Drive, Machine


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
    """One recording of a machine, warm-up included.

    Attributes:
        seconds: how long it lasts.
        drive: true inputs (N, nu) in their units over times (N,) in seconds.
        start: (nh,) health at the beginning in the parameters' units.
        changes: what wears, and when; of one parameter one after another.
    """

    machine: Machine
    name: str
    kind: str
    seconds: float
    drive: Drive
    start: Array
    changes: tuple[Change, ...]
    seed: int

    def time_s(self) -> Array:
        """(N,) from 0."""
        period_s = self.machine.sample_period_s
        return np.arange(round(self.seconds / period_s), dtype=np.float64) * period_s

    def inputs(self) -> Array:
        """(N, nu) true inputs."""
        return self.drive(self.time_s())

    def health(self) -> Array:
        """(N, nh) true health."""
        return health_of(self.machine.health_names, self.start, self.changes, self.time_s())


def health_of(names: tuple[str, ...], start: Array, changes: tuple[Change, ...], time_s: Array) -> Array:
    """(N, nh) health in the parameters' units.

    Args:
        names: of the nh parameters.
        start: (nh,) at the beginning, in the same units.
        changes: what moves; of one parameter one after another.
        time_s: (N,) in seconds.
    """
    values = np.tile(start, (len(time_s), 1))
    for change in changes:
        i = names.index(change.parameter)
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


def latin_hypercube(count: int, size: int, columns: int, *axes: object) -> Array:
    """(count, columns) coordinates in [0, 1]: hypercubes of ``size`` rows, one after another, so that a row does not
    depend on how many others are asked for.
    """
    sampler = qmc.LatinHypercube(columns, seed=stream(*axes, size))
    return np.concatenate([sampler.random(size) for _ in range(max(1, -(-count // size)))])[:count]
