"""Candidates with a shape: what is tried of each, and how a parameter vector holds it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from twinbench.mismatch.machine import Candidate, Machine
from twinbench.physics.simulator import Amplitude, Array

SHAPES = (0.05, 0.2, 0.35, 0.5, 0.65, 0.8, 0.95)
"""Where in its range a shape parameter is tried, beside its nominal value. Evidence has a peak of its own wherever a
threshold lies between other readings, and a fit stays at the one that it began next to."""


@dataclass(frozen=True)
class Variant:
    """A candidate with its shape parameters at one trial value."""

    candidate: int
    shape: tuple[float, ...]


def variants(candidates: Sequence[Candidate]) -> tuple[Variant, ...]:
    """Every candidate with its shape parameters at their nominal values, and each of them through its range."""
    out = []
    for j, candidate in enumerate(candidates):
        shapes = candidate.mechanism.parameters[1:] if not is_amplitude(candidate) else ()
        nominal = tuple(v.nominal for v in shapes)
        tried = {nominal: None}  # a set that keeps its order
        for place, v in enumerate(shapes):
            for share in SHAPES:
                moved = list(nominal)
                moved[place] = _within(v.low, v.high, share)
                tried[tuple(moved)] = None
        out += [Variant(j, shape) for shape in tried]
    return tuple(out)


def is_amplitude(candidate: Candidate) -> bool:
    """Are its parameters the simulator's own? They have no shape apart from their size."""
    return isinstance(candidate.mechanism, Amplitude)


def _within(low: float, high: float, share: float) -> float:
    """A share of the way from low to high, by ratio where the range spans decades."""
    if low > 0 and high / low > 20.0:
        return float(low * (high / low) ** share)
    return low + share * (high - low)


def typical(candidate: Candidate) -> float:
    """Size that a candidate plainly has, measured from its absence."""
    size = float(candidate.typical[0] - candidate.null[0])
    return size or candidate.mechanism.parameters[0].scale


def switched(machine: Machine, theta: Array, variant: Variant, size: float) -> Array:
    """Parameters with a variant there, ``size`` from its absence.

    Args:
        theta: (n_theta,) each in its parameter's unit.
        size: in the unit of its first parameter.
    """
    candidate = machine.candidates[variant.candidate]
    changed = theta.copy()
    if is_amplitude(candidate):
        changed[list(candidate.at)] = candidate.null + size * per_size(candidate)
    else:
        changed[candidate.at[0]] = candidate.null[0] + size
        changed[list(candidate.at[1:])] = variant.shape
    return changed


def per_size(candidate: Candidate) -> Array:
    """(n,) how far each parameter of an amplitude moves, in its unit, per unit of the first."""
    moves = (candidate.typical - candidate.null) / typical(candidate)
    moves[0] = 1.0  # also where what is typical is what the simulator has
    return np.asarray(moves)
