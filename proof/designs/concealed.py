"""A concealed machine that was recorded too narrowly, and on which further experiments can be made."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from twinbench.data.recording import Recording
from twinbench.data.scenario import stream
from twinbench.mismatch.design.limits import Limits
from twinbench.physics.simulator import Array, Simulator
from twinbench.proof.concealed.changes import change_of
from twinbench.proof.concealed.generate import BACKGROUND_PCT, PAUSE_S, Item, drawn_parameters, drawn_takes
from twinbench.proof.concealed.machine import Machine
from twinbench.proof.concealed.machines import machine_of
from twinbench.proof.concealed.record import written
from twinbench.proof.concealed.severity import Take, Yardstick
from twinbench.proof.designs.ideal import Truth
from twinbench.proof.twins import simulator_of

NARROW = 0.05, 0.3
"""Share of the usual movement of the inputs that a narrow recording has; drawn evenly."""
REACH = 1.5, 10.0
"""How many times as far as in the narrow recordings experiments may go; drawn evenly in its logarithm."""
LENGTH_SHARE = 0.1, 1.0
"""Length of an experiment, as a share of a recording's; drawn evenly in its logarithm."""
PROOF_CANDIDATES = 100


@dataclass(frozen=True)
class Concealed:
    """A machine with one effect that its twin lacks.

    Attributes:
        truth: what only the generator and the ideal observer know.
        ordinary: (N, nu) inputs of an ordinary recording, within the limits of an experiment, in their units: as long a
            part of it as an experiment, the one in which they move most. No engine gets it.
        narrow: recordings at hand, the last one held back.
        limits: of experiments.
        reach: how many times as far as in the narrow recordings they may go.
        length_share: how long they last, as a share of a recording.
        case, seed: what errors are drawn by.
    """

    twin: Simulator
    truth: Truth
    ordinary: Array
    narrow: tuple[Take, ...]
    limits: Limits
    reach: float
    length_share: float
    case: str
    seed: int

    @property
    def machine(self) -> Machine:
        """Its true equations."""
        return self.truth.machine

    def recorded(self, take: Take) -> Recording:
        """A recording of it, from rest under the first inputs.

        Raises:
            FloatingPointError: the machine diverges.
        """
        rng = stream(self.seed, "designs", self.case, take.name)
        time_s, values = written(self.machine, take, self.truth.parameters, rng)
        channels = (*self.machine.inputs, *self.machine.outputs)
        order = [channels.index(v.name) for v in (*self.twin.inputs, *self.twin.outputs)]
        return Recording(take.name, time_s, tuple(channels[i] for i in order), values[:, order])

    @cached_property
    def at_hand(self) -> list[Recording]:
        """The narrow recordings, the last one held back."""
        return [self.recorded(take) for take in self.narrow]

    def later(self, name: str, u: Array, takes: Sequence[Take]) -> Take:
        """A further recording, after others.

        Args:
            u: (N, nu) its inputs, in their units.
        """
        return Take(name, max(t.start_s + len(t.u) * self.machine.period_s for t in takes) + PAUSE_S, u)


def concealed(item: Item, seed: int) -> Concealed:
    """Draw a machine with an effect that has the item's severity in the narrow recordings; the same item, the same one.

    Raises:
        FloatingPointError: it diverges.
    """
    machine, rng = machine_of(item.machine, seed), stream(seed, "narrow", item.case, item.machine, item.effects)
    background = float(rng.choice(BACKGROUND_PCT[0], p=BACKGROUND_PCT[1]))
    p = drawn_parameters(machine, item.cell, background, rng)
    usual = drawn_takes(machine, "", rng)
    every = np.concatenate([t.u for t in usual if not t.held_out])
    low, high = every.min(axis=0), every.max(axis=0)
    share, reach, length_share = (
        float(rng.uniform(*NARROW)),
        _drawn_evenly_in_logarithm(rng, REACH),
        _drawn_evenly_in_logarithm(rng, LENGTH_SHARE),
    )
    wider, centre = min(reach * share, 1.0), low + rng.uniform(0.5 * share, 1.0 - 0.5 * share, len(low)) * (high - low)
    middle = np.clip(centre, low + 0.5 * wider * (high - low), high - 0.5 * wider * (high - low))
    narrow, far = _within(usual, share, centre), _within(usual, wider, middle)
    ends = middle - 0.5 * wider * (high - low), middle + 0.5 * wider * (high - low)
    fastest = np.max([np.abs(np.diff(t.u, axis=0)).max(axis=0) for t in far], axis=0) / machine.period_s
    length_s = length_share * machine.seconds["train"][0]
    limits = Limits(*ends, fastest, length_s, machine.period_s, candidates=PROOF_CANDIDATES)
    narrow = (narrow[0], next(t for t in narrow if t.held_out))
    effect = machine.effect(item.effects[0])
    truth = Truth(machine, p, effect, 0.0, background)
    truth = replace(truth, amplitude=_scaled(truth, narrow, item.severity))
    twin = simulator_of(machine.simulator, machine.network).with_values(**machine.values)
    twin = replace(twin, calibrate=tuple(machine.calibrate), drifts=())
    ordinary = liveliest(far[0].u, len(limits.time_s), high - low)
    return Concealed(twin, truth, ordinary, narrow, limits, wider / share, length_share, item.case, seed)


def _drawn_evenly_in_logarithm(rng: np.random.Generator, ends: tuple[float, float]) -> float:
    return float(np.exp(rng.uniform(*np.log(ends))))


def _within(takes: Sequence[Take], share: float, centre: Array) -> tuple[Take, ...]:
    """Recordings whose inputs move by a share of what they did, around a centre (nu,) in their units."""
    learnt = np.concatenate([t.u for t in takes if not t.held_out])
    low, high = learnt.min(axis=0), learnt.max(axis=0)
    shrunk = [centre + share * (np.clip(t.u, low, high) - 0.5 * (low + high)) for t in takes]
    return tuple(replace(t, u=u) for t, u in zip(takes, shrunk, strict=True))


def liveliest(u: Array, many: int, span: Array) -> Array:
    """The part (many, nu) of inputs in which they move most.

    Args:
        u: (N, nu) these, in their units.
        span: (nu,) how far each moves in all, in its unit.
    """
    starts = range(0, max(len(u) - many, 0) + 1, max(1, many // 4))
    return max(
        (u[k : k + many] for k in starts),
        key=lambda part: float((np.ptp(part, axis=0) / np.maximum(span, np.finfo(float).eps)).sum()),
    )


def _scaled(truth: Truth, takes: Sequence[Take], severity: float) -> float:
    """The amplitude at which the effect has a severity in recordings, or the one that comes nearest."""
    yardstick = Yardstick(truth.machine, takes, truth.quiet)
    change = change_of(yardstick, truth.effect)
    return yardstick.scale(change.of, change.start, change.most, severity)[0]
