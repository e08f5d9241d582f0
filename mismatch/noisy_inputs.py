"""Inputs whose records are noisy or have spikes: the machine is driven by something steadier, and the readings show it.

A machine that is driven by a noisy record seems to have play at that input, which takes the noise away. So the noise
has to go before anything is named. What is taken away has to be white and Gaussian, and the readings have to be plainly
likelier without it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple, TypeVar

import numpy as np
from scipy.stats import kurtosis

from twinbench.mismatch.fit import Problem
from twinbench.mismatch.followed import IMPLAUSIBLE
from twinbench.mismatch.noise import BEYOND_DOUBT, noise_floor
from twinbench.mismatch.sensors import SensorNoise
from twinbench.mismatch.series import steadied
from twinbench.mismatch.solve import NEARLY, solve
from twinbench.mismatch.spikes import find_spikes
from twinbench.mismatch.tracks import Track
from twinbench.physics.simulator import Array

STEADY_FOR = (16, 8, 4, 2)
"""Samples over which an input may go on steadily while its record scatters, the most first. What changes faster than
the least cannot be told from noise."""
WHITE = 0.2
"""Correlation, from each of three samples to the next, up to which what is taken away is white."""
HEAVY_TAILED = 3.0
"""Excess kurtosis from which what is taken away is no noise: steps have more by far."""
JACOBIANS = 4
"""Of a fit to recordings without the noise, from where it was with it. What other numbers change was not measured."""


class NoisyInput(NamedTuple):
    """An input, its noise, and what says so.

    Attributes:
        column: its position among the inputs.
        sd: of a sample, in the input's unit.
        steady_for: samples over which it is steady.
        nats: by which the readings are likelier without the noise of this input.
    """

    name: str
    unit: str
    column: int
    sd: float
    steady_for: int
    nats: float

    def off(self, track: Track) -> Track:
        """A recording without the noise."""
        values = np.ascontiguousarray(track.u[:, self.column])
        return track.driven_by(self.column, _less_noise(values, self.sd, self.steady_for))


class SpikyInput(NamedTuple):
    """An input of which single values jump away and return, and what says that the machine did not get them.

    Attributes:
        column: its position among the inputs.
        many: values in the recordings that are learnt from.
        nats: by which the readings are likelier without them.
    """

    name: str
    column: int
    many: int
    nats: float

    def off(self, track: Track) -> Track:
        """A recording in which the value before holds on instead."""
        values = track.u[:, self.column].copy()
        spikes = find_spikes(values)
        values[spikes] = values[spikes - 1]
        return track.driven_by(self.column, values)


_Either = TypeVar("_Either", SpikyInput, NoisyInput)


def find_noisy_inputs(problem: Problem, z: Array, told: Array) -> tuple[SpikyInput | NoisyInput, ...]:
    """What the readings plainly want taken off the inputs' records, in a calibrated simulator: spikes, then noise.

    Args:
        z: (K,) where the problem's unknowns stand, each in its own unit.
        told: (nu,) standard deviation of a sample of each input, in its unit, where a user told it; else 0.
    """
    inputs = problem.machine.simulator.inputs
    spiky: list[SpikyInput] = []
    noisy: list[NoisyInput] = []
    for c, v in enumerate(inputs):
        many = sum(len(find_spikes(t.u[:, c])) for t in problem.tracks)
        spiky += [SpikyInput(v.name, c, many, 0.0)] if many else []
    spiky = _wanted(problem, z, spiky)
    if spiky:
        problem, z = _without(problem, z, spiky)
    for c, v in enumerate(inputs):
        noise = _noise([np.ascontiguousarray(t.u[:, c]) for t in problem.tracks], float(told[c]), v.scale)
        noisy += [NoisyInput(v.name, v.unit, c, *noise, 0.0)] if noise is not None else []
    return (*spiky, *_wanted(problem, z, noisy))


def _wanted(problem: Problem, z: Array, found: list[_Either]) -> list[_Either]:
    """Those that make the readings plainly likelier, alone and beside the others; what does least goes first."""
    if found:
        recorded = _log(*_without(problem, z, []))
        found = [one for one in found if _log(*_without(problem, z, [one])) >= recorded + BEYOND_DOUBT]
    while found:
        best = _log(*_without(problem, z, found))
        rests = [[o for o in found if o is not one] for one in found]
        gains = [best - _log(*_without(problem, z, rest)) for rest in rests]
        least = int(np.argmin(gains))
        if gains[least] >= BEYOND_DOUBT:
            return [one._replace(nats=gain) for one, gain in zip(found, gains, strict=True)]
        found = rests[least]
    return []


def _noise(series: Sequence[Array], told: float, scale: float) -> tuple[float, int] | None:
    """Standard deviation of a record's noise, and over how many samples it is steady; None if there is none.

    A column whose rows are in a wrong order looks the same, but its noise is about as large as what the input does. So
    that much is noise only where a user told it.
    """
    sd = told or float(noise_floor([u[:, None] for u in series])[0])
    if told or 0.0 < sd < IMPLAUSIBLE * scale:
        for steady_for in STEADY_FOR:
            off = np.concatenate([u - _less_noise(u, sd, steady_for) for u in series])
            if np.std(off) > 0.0 and _is_noise(off):
                return sd, steady_for
    return None


def _is_noise(off: Array) -> bool:
    off = (off - off.mean()) / off.std()
    memory = max(abs(float(np.mean(off[k:] * off[:-k]))) for k in (1, 2, 3))
    return memory < WHITE and float(kurtosis(off)) < HEAVY_TAILED


def _less_noise(u: Array, sd: float, steady_for: int) -> Array:
    """A record (N,) less its noise, in two passes: what the first leaves is half as much and lasts twice as long."""
    return steadied(steadied(u, sd, 0.5 * steady_for), 0.5 * sd, float(steady_for))


def _without(problem: Problem, z: Array, found: Sequence[SpikyInput | NoisyInput]) -> tuple[Problem, Array]:
    """The fit with these taken off the recordings, and where it then stands; also without any it goes on a little."""
    tracks = list(problem.tracks)
    for one in found:
        tracks = [one.off(t) for t in tracks]
    changed = replace(problem, tracks=tracks, offsets=(), starts=()).refined(z)
    return changed, solve(changed, z, JACOBIANS, share=NEARLY)[0]


def _log(problem: Problem, z: Array) -> float:
    """Nats of the readings under the likeliest noise of the sensors, constants apart; none where the run diverges."""
    residuals, floor = problem.residuals(z), problem.sd
    if not np.isfinite(problem.cost(z)):
        return -np.inf
    return SensorNoise.first_guess(floor).learnt(residuals, floor).log(residuals)
