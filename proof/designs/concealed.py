"""A concealed machine that was recorded too narrowly, and on which further experiments can be made."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from twinbench.data.recording import Recording
from twinbench.data.scenario import stream
from twinbench.mismatch.design.limits import Limits
from twinbench.physics.simulator import Array, Simulator
from twinbench.proof.concealed.generate import PAUSE_S, Item, draw
from twinbench.proof.concealed.integrate import Parameters
from twinbench.proof.concealed.machine import Machine
from twinbench.proof.concealed.machines import machine_of
from twinbench.proof.concealed.record import recorded
from twinbench.proof.concealed.severity import Take, readings
from twinbench.proof.twins import simulator_of

NARROW = 0.15, 0.6
"""Share of the usual movement of the inputs that a narrow recording has; drawn evenly."""
RECORDED = 2
"""Narrow recordings that are learnt from at most; one is held back."""
PROOF_CANDIDATES = 100


@dataclass(frozen=True)
class Concealed:
    """A machine with one effect that its twin lacks.

    Attributes:
        truth: as the generator seals it, but for what the ideal observer says.
        parameters: (np,) of the law, the effect's amplitude among them, each in its unit.
        narrow: inputs (N, nu) of the recordings at hand in their units, the last one held back.
        limits: what ordinary recordings do.
    """

    machine: Machine
    twin: Simulator
    truth: dict[str, Any]
    parameters: Array
    narrow: tuple[Array, ...]
    limits: Limits
    seed: int

    def recorded(self, name: str, start_s: float, u: Array) -> Recording:
        """A recording of it under some inputs, from rest under the first ones.

        Args:
            u: (N, nu) these, in their units.

        Raises:
            FloatingPointError: the machine diverges.
        """
        machine, steady = self.machine, Parameters.steady(self.parameters)
        take = Take(name, start_s, u)
        clean = readings(machine, take, u, machine.settled(u, self.parameters, start_s), steady, machine.fine)
        if not np.isfinite(clean).all():
            raise FloatingPointError(f"machine {machine.name} diverged while {name} was recorded")
        channels = (*machine.inputs, *machine.outputs)
        rng = stream(self.seed, "designs", self.truth["case"], name)
        values = recorded(machine, channels, np.concatenate((u, clean), axis=1), rng)
        time_s = np.round(start_s + np.arange(len(u)) * machine.period_s, 6)
        order = [channels.index(v.name) for v in (*self.twin.inputs, *self.twin.outputs)]
        return Recording(name, time_s, tuple(channels[i] for i in order), values[:, order])

    def at_hand(self) -> list[Recording]:
        """The narrow recordings, the last one held back."""
        made, clock = [], 0.0
        for k, u in enumerate(self.narrow):
            name = "held" if k + 1 == len(self.narrow) else f"narrow_{k + 1}"
            made.append(self.recorded(name, clock, u))
            clock += len(u) * self.machine.period_s + PAUSE_S
        return made

    def later(self, recordings: list[Recording]) -> float:
        """When a further recording may begin, s."""
        return max(float(r.time_s[-1]) for r in recordings) + PAUSE_S


def concealed(item: Item, seed: int) -> Concealed:
    """Draw a machine with an effect; the same item and seed give the same one.

    Raises:
        FloatingPointError: it diverges.
    """
    machine, case = machine_of(item.machine, seed), draw(item, seed, observed=False)
    (effect,) = case.truth["effects"]
    named = machine.effect(effect["name"])
    p = machine.p(**case.truth["parameters"])
    p[machine.at(named.slot)] = effect["amplitude"]
    public = case.public
    twin = simulator_of(public["simulator"], public.get("network", {})).with_values(**public["values"])
    twin = replace(twin, calibrate=tuple(public["calibrate"]), drifts=())
    rng = stream(seed, "narrow", item.case, item.machine)
    seconds = machine.seconds["train"][0]
    wide = [machine.operate(rng, seconds, "train") for _ in range(3)]
    every = np.concatenate(wide)
    share, many = float(rng.uniform(*NARROW)), int(rng.integers(1, RECORDED + 1))
    low, high = every.min(axis=0), every.max(axis=0)
    centre = low + rng.uniform(0.5 * share, 1.0 - 0.5 * share, len(low)) * (high - low)
    narrow = tuple(np.clip(centre + share * (u - 0.5 * (low + high)), low, high) for u in wide[: many + 1])
    fastest = np.max([np.abs(np.diff(u, axis=0)).max(axis=0) for u in wide], axis=0) / machine.period_s
    limits = Limits(low, high, fastest, seconds, machine.period_s, candidates=PROOF_CANDIDATES)
    return Concealed(machine, twin, case.truth, p, narrow, limits, seed)


def observed_truth(item: Item, seed: int) -> dict[str, Any]:
    """The truth of a machine, with what the ideal observer makes of ordinary recordings of it."""
    return dict(draw(item, seed).truth)
