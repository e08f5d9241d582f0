"""Which candidates explain what calibration leaves: one linear picture of all of them, then refits.

Around a fit, every candidate is a column: what the readings would do if it were there. What
parameters, start states and drifts can imitate is projected out of the columns, so a candidate is
judged by what it alone can explain. The picture is right near the fit only, so the sets that look
best in it are fitted in full before anything is said.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np

from mismatch.fit import Problem, Unknown, parallel, solve
from mismatch.machine import Candidate, Machine
from mismatch.noise import fit_whitener
from physics.simulator import Array

PROBE = 0.2
"""Share of its typical size at which a candidate's column is taken."""
PENALTY = 16.0
"""Log-likelihood units (twice) that each further effect must earn: log n + 2 log m for usual n and m."""
SHAPES = (0.5, 0.15, 0.85)
"""Where in its range a shape parameter is tried: its nominal value for the first."""
REFITS = 6
"""Sets that are fitted in full, per number of effects."""
LARGEST = 12
"""Effects in one explanation at most."""


@dataclass(frozen=True)
class Variant:
    """A candidate with its shape parameters at one trial value."""

    candidate: int
    shape: tuple[float, ...]


@dataclass(frozen=True)
class Picture:
    """All variants at once, nuisances eliminated: gain of a set S is ``b_S' G_S^-1 b_S``.

    Attributes:
        G, b: (V, V), (V,), in units of each variant's typical size.
        low, high: (V,) what the sizes may be, in the same units.
        units: (V,) the variants' typical sizes.
        nuisance, columns: whitened, per recording: (B, ny, K) of the unknowns, (B, ny, V) per unit of size.
        sizes: (V,) what was there where the picture was taken.
    """

    variants: tuple[Variant, ...]
    G: Array
    b: Array
    low: Array
    high: Array
    units: Array
    nuisance: Sequence[Array]
    columns: Sequence[Array]
    sizes: Array

    def gain(self, chosen: Sequence[int]) -> float:
        """What a set explains; minus infinity if a size would leave its physical range."""
        if not chosen:
            return 0.0
        i = list(chosen)
        G = self.G[np.ix_(i, i)] + 1e-9 * np.diag(np.diag(self.G)[i] + 1e-300)
        try:
            size = np.linalg.solve(G, self.b[i])
        except np.linalg.LinAlgError:
            return -np.inf
        if (size < self.low[i] - 1e-9).any() or (size > self.high[i] + 1e-9).any():
            return -np.inf
        return float(self.b[i] @ size)


@dataclass(frozen=True)
class Explanation:
    """A set of candidates, fitted.

    Attributes:
        names: candidates in it.
        problem, z: the fit; its unknowns hold the candidates' parameters after those of the base problem.
        cost: whitened sum of squares with priors.
    """

    names: tuple[str, ...]
    chosen: tuple[Variant, ...]
    problem: Problem
    z: Array
    cost: float


def variants(candidates: Sequence[Candidate]) -> tuple[Variant, ...]:
    """Every candidate with its shape parameters at their nominal and at an early and a late value."""
    out = []
    for j, candidate in enumerate(candidates):
        shapes = candidate.mechanism.parameters[1:] if not _is_amplitude(candidate) else ()
        nominal = tuple(v.nominal for v in shapes)
        out.append(Variant(j, nominal))
        for place, v in enumerate(shapes):
            for share in SHAPES[1:]:
                moved = list(nominal)
                moved[place] = _within(v.low, v.high, share)
                out.append(Variant(j, tuple(moved)))
    return tuple(out)


def _is_amplitude(candidate: Candidate) -> bool:
    return candidate.mechanism.term is None and candidate.mechanism.series is None


def _within(low: float, high: float, share: float) -> float:
    """A share of the way from low to high, by ratio where the range spans decades."""
    if low > 0 and high / low > 20.0:
        return float(low * (high / low) ** share)
    return low + share * (high - low)


def typical(candidate: Candidate) -> float:
    """Size that a candidate plainly has, measured from its absence."""
    size = float(candidate.typical[0] - candidate.null[0])
    return size or candidate.mechanism.parameters[0].scale


def picture(
    problem: Problem, z: Array, listed: Sequence[Variant], present: Mapping[Variant, float] = MappingProxyType({}),
    advance: Callable[[], None] = lambda: None,
) -> Picture:
    """Linearise around a fit.

    Args:
        problem, z: parameters, start states and drifts, and where they stand.
        listed: variants to show; those of ``present`` are added.
        present: what the fit holds already, and how much of it; sizes are shown from its absence all the same.
    """
    machine = problem.machine
    listed = (*present, *(v for v in listed if v not in present))
    sizes = np.array([present.get(v, 0.0) for v in listed])
    for variant, size in present.items():
        problem = replace(problem, theta=switched(machine, problem.theta, variant, size))
    residuals = problem.residuals(z)
    theta = problem.theta
    n = len(listed)
    columns = [np.zeros((*track.means.shape, n)) for track in problem.tracks]

    def column(r: int, v: int) -> None:
        variant = listed[v]
        candidate = machine.candidates[variant.candidate]
        step = PROBE * typical(candidate)
        first = candidate.mechanism.parameters[0]
        if not first.low <= candidate.null[0] + sizes[v] + step <= first.high:
            step = -step
        changed = switched(machine, theta, variant, sizes[v] + step)
        columns[r][:, :, v] = (residuals[r] - problem.residual(r, z, changed)) / step
        advance()

    parallel([lambda r=r, v=v: column(r, v) for r in range(len(problem.tracks)) for v in range(n)])
    _, _, nuisance = problem.normal(z, residuals)
    columns = [problem.whitener(c) for c in columns]
    units = np.array([typical(machine.candidates[v.candidate]) for v in listed])
    G, b = problem.projected(z, residuals, nuisance, [c * units for c in columns])
    ends = np.empty((n, 2))
    for i, variant in enumerate(listed):
        candidate = machine.candidates[variant.candidate]
        bounds = np.array([candidate.mechanism.parameters[0].low, candidate.mechanism.parameters[0].high])
        ends[i] = np.sort((bounds - candidate.null[0]) / units[i])
    # A candidate that moves nothing here must not be divided by.
    G = G + 1e-6 * np.eye(n)
    b = b + G @ (sizes / units)
    return Picture(tuple(listed), G, b, ends[:, 0], ends[:, 1], units, nuisance, columns, sizes)


def switched(machine: Machine, theta: Array, variant: Variant, size: float) -> Array:
    """Parameters with a variant there, ``size`` from its absence."""
    candidate = machine.candidates[variant.candidate]
    changed = theta.copy()
    changed[candidate.at[0]] = candidate.null[0] + size
    if _is_amplitude(candidate):
        rest = candidate.null[1:] + size / typical(candidate) * (candidate.typical[1:] - candidate.null[1:])
    else:
        rest = np.array(variant.shape)
    changed[list(candidate.at[1:])] = rest
    return changed


def best_sets(
    shown: Picture, most: int, penalty: float = PENALTY, pairs: bool = True, start: Sequence[int] = ()
) -> list[tuple[int, ...]]:
    """Promising sets of variants: the best singles, the best pairs, and what a local search ends in.

    The local search adds, drops, swaps, and puts one for two until nothing helps.
    """
    n = len(shown.variants)
    owner = [v.candidate for v in shown.variants]
    singles = sorted(range(n), key=lambda i: -shown.gain((i,)))
    once = _first_of_each(singles, owner)
    found: list[tuple[int, ...]] = [(i,) for i in once[:REFITS] if np.isfinite(shown.gain((i,)))]
    if pairs:
        # Two effects that each look poor alone can be plain together.
        diagonal = np.maximum(np.diag(shown.G), 1e-12)
        scored = [
            (shown.gain((i, j)), (i, j))
            for i, j in itertools.combinations(range(n), 2)
            if owner[i] != owner[j] and abs(shown.G[i, j]) < 0.995 * np.sqrt(diagonal[i] * diagonal[j])
        ]
        scored.sort(key=lambda s: -s[0])
        seen: set[frozenset[int]] = set()
        for gain, pair in scored:
            names = frozenset(owner[i] for i in pair)
            if np.isfinite(gain) and names not in seen and len(seen) < REFITS:
                seen.add(names)
                found.append(pair)
    for begin in ((), tuple(start), *found[:1], *found[-1:]):
        local = local_search(shown, begin, most, penalty, pairs)
        if local and local not in found:
            found.append(local)
    return found


def _first_of_each(order: Sequence[int], owner: Sequence[int]) -> list[int]:
    seen: set[int] = set()
    return [i for i in order if not (owner[i] in seen or seen.add(owner[i]))]  # type: ignore[func-returns-value]


def local_search(
    shown: Picture, begin: Sequence[int], most: int, penalty: float, pairs: bool = True
) -> tuple[int, ...]:
    """Add, drop, swap, and put one for two, whatever helps most, until nothing does."""
    owner = [v.candidate for v in shown.variants]
    current = tuple(sorted(begin))
    score = shown.gain(current) - penalty * len(current)
    n = len(owner)
    while True:
        options = [current[:k] + current[k + 1 :] for k in range(len(current))]
        taken = {owner[i] for i in current}
        outside = [i for i in range(n) if owner[i] not in taken]
        if len(current) < most:
            options += [(*current, i) for i in outside]
        for k in range(len(current)):
            rest = current[:k] + current[k + 1 :]
            same = [i for i in range(n) if owner[i] == owner[current[k]] and i != current[k]]
            options += [(*rest, i) for i in (*outside, *same)]
        if pairs and len(current) >= 2:
            for k, m in itertools.combinations(range(len(current)), 2):
                rest = tuple(x for place, x in enumerate(current) if place not in (k, m))
                options += [(*rest, i) for i in outside]
        best = max(options, key=lambda s: shown.gain(s) - penalty * len(s), default=current)
        found = shown.gain(best) - penalty * len(best)
        if not found > score + 1e-6:
            return current
        current, score = tuple(sorted(best)), found


def with_candidates(problem: Problem, chosen: Sequence[Variant]) -> Problem:
    """The problem with the candidates' parameters among its unknowns."""
    added = []
    for variant in chosen:
        candidate = problem.machine.candidates[variant.candidate]
        amplitude = _is_amplitude(candidate)
        values = candidate.null if amplitude else np.array([candidate.null[0], *variant.shape])
        for place, (at, v, value) in enumerate(zip(candidate.at, candidate.mechanism.parameters, values, strict=True)):
            scale = abs(typical(candidate)) if place == 0 else (v.high - v.low) / 6.0
            sd = 5.0 * scale if place == 0 or amplitude else (v.high - v.low) / 2.0
            ends = (min(v.low, value), max(v.high, value))
            added.append(Unknown(f"{candidate.name}.{v.name}", "mechanism", at, *ends, value, sd, scale))
    return replace(problem, unknowns=(*problem.unknowns, *added))


def refit(problem: Problem, z: Array, shown: Picture, chosen: Sequence[int], rounds: int = 0) -> Explanation:
    """Fit a set: a few steps with the picture's columns, then ``rounds`` with its own."""
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
    fitted = solve(whole, begin, 1, chords=5, known=known)
    if rounds:
        fitted = solve(whole, fitted[0], rounds)
    names = tuple(problem.machine.candidates[v.candidate].name for v in picked)
    return Explanation(names, picked, whole, *fitted)


def present(explanation: Explanation) -> dict[Variant, float]:
    """The fitted variants of an explanation and their sizes."""
    machine = explanation.problem.machine
    at = len(explanation.z) - sum(len(machine.candidates[v.candidate].at) for v in explanation.chosen)
    found = {}
    for variant in explanation.chosen:
        candidate = machine.candidates[variant.candidate]
        values = explanation.z[at : at + len(candidate.at)]
        at += len(candidate.at)
        shape = variant.shape if _is_amplitude(candidate) else tuple(float(v) for v in values[1:])
        found[Variant(variant.candidate, shape)] = float(values[0] - candidate.null[0])
    return found


def rewhitened(fitted: Problem, z: Array, floor: Array, order: int, problem: Problem | None = None) -> Problem:
    """``problem`` (the fitted one if left out) with its noise model learnt from the residuals of a fit."""
    return replace(problem or fitted, whitener=fit_whitener(fitted.residuals(z), floor, order))
