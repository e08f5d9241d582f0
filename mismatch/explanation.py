"""A set of candidates as an explanation of the recordings, fitted by forward runs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import chi2

from twinbench.mismatch.fit import Problem, Unknown
from twinbench.mismatch.noise import fit_whitener
from twinbench.mismatch.picture import Picture, Variant, is_amplitude, is_fault, price, shape_count, typical
from twinbench.mismatch.solve import solve
from twinbench.physics.simulator import Array


@dataclass(frozen=True)
class Explanation:
    """A set of candidates, fitted.

    Attributes:
        names: candidates in it.
        problem: the fit; its unknowns hold the candidates' parameters after those of the base problem.
        z: (K,) where its unknowns stand, each in its own unit.
        cost: whitened sum of squares with priors.
    """

    names: tuple[str, ...]
    chosen: tuple[Variant, ...]
    problem: Problem
    z: Array
    cost: float

    @property
    def faults(self) -> int:
        """How many of them are faults of sensors or inputs."""
        return sum(is_fault(self.problem.machine.candidates[v.candidate]) for v in self.chosen)

    @property
    def first(self) -> int:
        """Where in z the effects' parameters begin."""
        machine = self.problem.machine
        return len(self.z) - sum(len(machine.candidates[v.candidate].at) for v in self.chosen)

    @property
    def bare(self) -> Problem:
        """The problem without its effects."""
        return replace(self.problem, unknowns=self.problem.unknowns[: self.first])

    def score(self, penalty: float) -> float:
        """Cost and what its effects must earn."""
        shapes = sum(shape_count(self.problem.machine.candidates[v.candidate]) for v in self.chosen)
        return self.cost + price(len(self.names), self.faults, shapes, penalty)


def with_candidates(problem: Problem, chosen: Sequence[Variant], ridge: float = 5.0) -> Problem:
    """The problem with the candidates' parameters among its unknowns.

    Args:
        ridge: prior standard deviation of their sizes, in typical ones.
    """
    added = []
    for variant in chosen:
        candidate = problem.machine.candidates[variant.candidate]
        amplitude = is_amplitude(candidate)
        values = candidate.null if amplitude else np.array([candidate.null[0], *variant.shape])
        for place, (at, v, value) in enumerate(zip(candidate.at, candidate.mechanism.parameters, values, strict=True)):
            scale = abs(typical(candidate)) if place == 0 else (v.high - v.low) / 6.0
            sd = ridge * scale if place == 0 or amplitude else (v.high - v.low) / 2.0
            low, high = (min(v.low, value), max(v.high, value)) if place or amplitude else (v.low, v.high)
            added.append(Unknown(f"{candidate.name}.{v.name}", "mechanism", at, low, high, value, sd, scale))
    return replace(problem, unknowns=(*problem.unknowns, *added))


def refit(problem: Problem, z: Array, shown: Picture, chosen: Sequence[int], rounds: int = 0) -> Explanation:
    """Fit a set: a few steps with the picture's columns, then ``rounds`` with its own.

    Args:
        z: (K,) where the problem's unknowns stand, each in its own unit.
    """
    picked = tuple(shown.variants[i] for i in chosen)
    whole = with_candidates(problem, picked)
    known = []
    for nuisance, columns in zip(shown.nuisance, shown.columns, strict=True):
        own = np.zeros((*nuisance.shape[:2], len(whole.unknowns) - len(z)))
        at = 0
        for i, variant in zip(chosen, picked, strict=True):
            own[:, :, at] = columns[:, :, i]
            at += len(problem.machine.candidates[variant.candidate].at)
        known.append(np.concatenate((nuisance, own), axis=-1))
    begin = np.concatenate((z, whole.z0[len(z) :]))
    at = len(z)
    for i, variant in zip(chosen, picked, strict=True):
        begin[at] += shown.sizes[i]
        at += len(problem.machine.candidates[variant.candidate].at)
    fitted = solve(whole, begin, 1 + rounds, chords=5, known=known)
    names = tuple(problem.machine.candidates[v.candidate].name for v in picked)
    return Explanation(names, picked, whole, *fitted)


def present(explanation: Explanation) -> dict[Variant, float]:
    """The fitted variants of an explanation and their sizes."""
    machine = explanation.problem.machine
    at = explanation.first
    found = {}
    for variant in explanation.chosen:
        candidate = machine.candidates[variant.candidate]
        values = explanation.z[at : at + len(candidate.at)]
        at += len(candidate.at)
        shape = variant.shape if is_amplitude(candidate) else tuple(float(v) for v in values[1:])
        found[Variant(variant.candidate, shape)] = float(values[0] - candidate.null[0])
    return found


def rewhitened(fitted: Problem, z: Array, floor: Array, order: int, problem: Problem | None = None) -> Problem:
    """``problem`` (the fitted one if left out) with its noise model learnt from the residuals of a fit.

    Args:
        z: (K,) where the unknowns of ``fitted`` stand, each in its own unit.
        floor: (ny,) least noise of block means, in the outputs' units.
    """
    return replace(problem or fitted, whitener=fit_whitener(fitted.residuals(z), floor, order))


def fitted_again(problem: Problem, explanation: Explanation, rounds: int = 3) -> Explanation:
    """An explanation fitted again under another problem's noise and onsets."""
    moved = replace(explanation.problem, whitener=problem.whitener, since=problem.since)
    moved = moved.refined(explanation.z)
    z, cost = solve(moved, explanation.z, rounds)
    return replace(explanation, problem=moved, z=z, cost=cost)


def residual_chi2(explanation: Explanation) -> tuple[float, float]:
    """Whitened mean square of the residuals, and the largest that noise alone makes in one of a thousand."""
    e = np.concatenate([explanation.problem.whitener(r).ravel() for r in explanation.problem.residuals(explanation.z)])
    e = e[np.isfinite(e)]
    return float(np.mean(e**2)), float(chi2.isf(1e-3, len(e)) / len(e))
