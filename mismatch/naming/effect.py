"""An effect as part of a hypothesis: a candidate, its shape and its size, and what it adds to what is unknown."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from twinbench.mismatch.fit import Problem, Unknown
from twinbench.mismatch.machine import Machine
from twinbench.mismatch.place import CLOCK
from twinbench.mismatch.variants import Variant, is_amplitude, typical
from twinbench.physics.simulator import Array, Series


@dataclass(frozen=True)
class Effect:
    """An effect as part of a hypothesis: a candidate, its shape and its size.

    Attributes:
        size: from absence, in the first parameter's unit.
        sd: of the size's prior, in the same unit.
        prior: log prior odds.
        least_sd: the sd's least, in the same unit; the sd itself if left out.
        memory: where what it remembers starts, in each recording, in its states' units; at nothing if left out.
    """

    variant: Variant
    size: float
    sd: float
    prior: float
    least_sd: float | None = None
    memory: tuple[float, ...] = ()

    @property
    def as_large(self) -> Effect:
        """It with a prior as wide as it is large."""
        return replace(self, sd=max(self.sd if self.least_sd is None else self.least_sd, abs(self.size)))


def may_wander(problem: Problem, effect: Effect) -> bool:
    """Is it physics, whose form is never exact? A fault of a channel is what it says."""
    return not isinstance(problem.machine.candidates[effect.variant.candidate].mechanism, Series)


def width(problem: Problem, variant: Variant) -> int:
    """How many parameters a fit of it has."""
    candidate = problem.machine.candidates[variant.candidate]
    return 1 if is_amplitude(candidate) else len(candidate.at)


def unknowns_of(problem: Problem, effect: Effect) -> list[Unknown]:
    """An effect's size and its shape, if it has one; of an amplitude the first parameter moves all the others."""
    candidate = problem.machine.candidates[effect.variant.candidate]
    found = []
    for place, (at, v) in enumerate(zip(candidate.at, candidate.mechanism.parameters, strict=True)):
        name = f"{candidate.name}.{v.name}"
        if place == 0:
            null, size = float(candidate.null[0]), abs(typical(candidate))
            low, high = min(v.low, null), max(v.high, null)
            found.append(Unknown(name, "mechanism", at, low, high, null, effect.sd, size))
        elif not is_amplitude(candidate):
            spread = (v.high - v.low) / 2.0
            mean = float(candidate.null[place])
            found.append(Unknown(name, "mechanism", at, v.low, v.high, mean, spread, spread / 3.0))
    return found


def memory_starts(machine: Machine, effects: Sequence[Effect], recordings: int) -> list[Unknown]:
    """Where what effects remember starts, in each of so many recordings: nothing says that it starts in balance."""
    found = []
    for e in effects:
        for at in machine.own_states(machine.candidates[e.variant.candidate]):
            v = machine.states[at]
            if v.name.startswith(CLOCK):
                continue
            found += [
                Unknown(f"start of {v.name}", "start", at, -np.inf, np.inf, 0.0, v.scale, 0.2 * v.scale, r)
                for r in range(recordings)
            ]
    return found


def with_effects(whole: Problem, z: Array, effects: Sequence[Effect]) -> tuple[Array, list[int]]:
    """The unknowns (K,), each in its own unit, with the effects as proposed; and where their sizes stand.

    Args:
        z: (k,) those that are not the effects', each in its own unit.
    """
    at, firsts, parts = len(z), [], [z]
    for effect in effects:
        n = width(whole, effect.variant)
        candidate = whole.machine.candidates[effect.variant.candidate]
        parts.append(np.array([candidate.null[0] + effect.size, *(effect.variant.shape if n > 1 else ())]))
        firsts.append(at)
        at += n
    for effect in effects:
        many = len(memory_starts(whole.machine, [effect], len(whole.tracks)))
        parts.append(np.array(effect.memory or (0.0,) * many))
    return np.concatenate(parts), firsts
