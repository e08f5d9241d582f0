"""Inputs that an experiment may have: steps, staircases, ramps, multisines and chirps within limits, drawn by seed."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from numba import njit, types

from twinbench.data.recording import Recording
from twinbench.mismatch.design.limits import Limits
from twinbench.mismatch.seed import ENGINE_SEED
from twinbench.mismatch.tracks import Track
from twinbench.mismatch.words import number, with_unit
from twinbench.physics.jit import VECTOR
from twinbench.physics.simulator import Array, Simulator

LEAST_MOVE = 0.3
"""Share of an input's range that a candidate moves it by, at least."""
FEWEST_PERIODS, MOST_PERIODS, SAMPLES_OF_A_PERIOD = 2.0, 100.0, 10.0
"""Periods in an experiment of the slowest and the fastest oscillation, and samples that a period has at least."""


class Candidate(NamedTuple):
    """One experiment that could be made.

    Attributes:
        kind: how its inputs go, in a word.
        says: the same in words that can be followed.
        time_s: (N,) seconds from nothing on.
        u: (N, nu) inputs in their units.
    """

    kind: str
    says: str
    time_s: Array
    u: Array


class _Course(NamedTuple):
    """How one input goes, as shares (N,) of its range, and what tells it from others of its kind."""

    share: Array
    says: str


def drawn(simulator: Simulator, limits: Limits, stay: Array | None = None, seed: int = ENGINE_SEED) -> list[Candidate]:
    """As many candidates as the limits ask for, each kind in its turn; each moves one input, or all of them.

    Args:
        stay: (nu,) where an input that does not move stays, in its unit, if the limits allow it: where the recordings
            had it. The middle of its range without recordings.
    """
    middle = 0.5 * (limits.low + limits.high)
    still = middle if stay is None else np.clip(stay, limits.low, limits.high)
    time_s, rng = limits.time_s, np.random.default_rng(seed)
    free = np.flatnonzero((limits.high > limits.low) & (limits.rate_per_s > 0.0))
    moving = [[int(i)] for i in free] + ([[int(i) for i in free]] if len(free) > 1 else [])
    found = []
    for k in range(limits.candidates):
        kind, course = list(KINDS.items())[k % len(KINDS)]
        u = np.tile(still, (len(time_s), 1))
        said = []
        for i in moving[(k // len(KINDS)) % len(moving)]:
            made, v = course(time_s, rng), simulator.inputs[i]
            wanted = limits.low[i] + made.share * (limits.high[i] - limits.low[i])
            u[:, i] = within_rate(np.ascontiguousarray(wanted), float(limits.rate_per_s[i]) * limits.sampling_s)
            ends = f"{number(u[:, i].min())} to {with_unit(u[:, i].max(), v.unit)}"
            said.append(f"a {kind} of {v.name} from {ends}{made.says}")
        found.append(Candidate(kind, " and ".join(said), time_s, u))
    return found


def usual(tracks: Sequence[Track]) -> Array:
    """(nu,) where recordings had each input, in its unit: half of the time lower, half of it higher."""
    return np.asarray(np.median(np.concatenate([t.u for t in tracks]), axis=0))


def of_recordings(recordings: Sequence[Recording], simulator: Simulator) -> list[Candidate]:
    """Runs that were chosen by the user, or made before: the inputs of recordings."""
    many = len(simulator.inputs)
    return [
        Candidate("run", f"the inputs of {r.name}", r.time_s - r.time_s[0], np.ascontiguousarray(r.values[:, :many]))
        for r in recordings
    ]


@njit(types.Array(types.float64, 1, "C")(VECTOR, types.float64), cache=True)
def within_rate(values: Array, most: float) -> Array:
    """A series followed as fast as it may be, by so much from sample to sample.

    Args:
        values: (N,) the series, in any unit.
    """
    out = values.copy()
    for k in range(1, len(values)):
        out[k] = min(max(values[k], out[k - 1] - most), out[k - 1] + most)
    return out


def _ends(rng: np.random.Generator) -> tuple[float, float]:
    """Two shares of a range, plainly apart; half of all reach over the whole of it."""
    if rng.random() < 0.5:
        return 0.0, 1.0
    low = rng.uniform(0.0, 1.0 - LEAST_MOVE)
    return low, rng.uniform(low + LEAST_MOVE, 1.0)


def _step(time_s: Array, rng: np.random.Generator) -> _Course:
    low, high = _ends(rng)
    first, second = (low, high) if rng.random() < 0.5 else (high, low)
    at = rng.uniform(0.1, 0.5) * time_s[-1]
    way = "up" if second > first else "down"
    return _Course(np.where(time_s < at, first, second), f", {way} at {with_unit(at, 's')}")


def _staircase(time_s: Array, rng: np.random.Generator) -> _Course:
    (low, high), many = _ends(rng), int(rng.integers(3, 11))
    levels = np.linspace(low, high, many)
    way = ("up", "down", "up and down", "in mixed order")[int(rng.integers(4))]
    if way == "down":
        levels = levels[::-1]
    elif way == "up and down":
        levels = np.concatenate((levels, levels[-2::-1]))
    elif way == "in mixed order":
        levels = rng.permutation(levels)
    place = np.minimum((time_s / time_s[-1] * len(levels)).astype(int), len(levels) - 1)
    each = with_unit(time_s[-1] / len(levels), "s")
    return _Course(levels[place], f", {len(levels)} levels {way}, {each} each")


def _ramp(time_s: Array, rng: np.random.Generator) -> _Course:
    (low, high), many = _ends(rng), int(rng.integers(1, 5))
    turned = np.abs((time_s / time_s[-1] * many) % 2.0 - 1.0)
    share = turned if rng.random() < 0.5 else 1.0 - turned
    return _Course(low + share * (high - low), f", {many} times from end to end")


def _periods(time_s: Array, rng: np.random.Generator) -> tuple[float, float]:
    """The slowest and the fastest oscillation of an experiment, in periods of it."""
    most = min(MOST_PERIODS, len(time_s) / SAMPLES_OF_A_PERIOD)
    return FEWEST_PERIODS, float(
        np.exp(rng.uniform(np.log(2.0 * FEWEST_PERIODS), np.log(max(most, 3.0 * FEWEST_PERIODS))))
    )


def _multisine(time_s: Array, rng: np.random.Generator) -> _Course:
    (low, high), (slow, fast) = _ends(rng), _periods(time_s, rng)
    many = int(rng.integers(3, 9))
    periods = np.unique(np.round(np.geomspace(slow, fast, many)))
    phases = rng.uniform(0.0, 2.0 * np.pi, len(periods))
    wave = np.sin(2.0 * np.pi * periods * time_s[:, None] / time_s[-1] + phases).sum(axis=1)
    share = (wave - wave.min()) / np.ptp(wave)
    ends = f"{number(time_s[-1] / fast, 2)} to {with_unit(time_s[-1] / slow, 's', 2)}"
    return _Course(low + share * (high - low), f", {len(periods)} periods of {ends}")


def _chirp(time_s: Array, rng: np.random.Generator) -> _Course:
    (low, high), (slow, fast) = _ends(rng), _periods(time_s, rng)
    growth = np.log(fast / slow)
    turns = slow / growth * (np.exp(growth * time_s / time_s[-1]) - 1.0)
    share = 0.5 - 0.5 * np.cos(2.0 * np.pi * turns)
    ends = f"{number(time_s[-1] / slow, 2)} to {with_unit(time_s[-1] / fast, 's', 2)}"
    return _Course(low + share * (high - low), f", its period falls from {ends}")


KINDS: dict[str, Callable[[Array, np.random.Generator], _Course]] = {
    "staircase": _staircase,
    "step": _step,
    "ramp": _ramp,
    "multisine": _multisine,
    "chirp": _chirp,
}
