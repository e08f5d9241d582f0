"""One linear picture of everything that might be missing.

Around a fit, every candidate is a column: what the readings would do if it were there. What
parameters, start states and drifts can imitate is projected out of the columns, so a candidate is
judged by what it alone can explain. The picture is right near the fit only, so what looks best in it
is fitted in full before anything is said.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np

from twinbench.mismatch.fit import Problem, parallel
from twinbench.mismatch.machine import Candidate, Machine
from twinbench.physics.simulator import Amplitude, Array, Series

PROBE_SIZE = 0.2
"""Share of its typical size at which a candidate's column is taken."""
RARE = 20.0
"""Units that every faulty sensor or input must earn besides, if it is not alone: that two things go wrong is rare."""
SHAPED = 8.0
"""Units that each parameter which shapes an effect must earn besides its size: a flexible form fits by chance."""
SWEEPS = 5
"""Rounds of bringing the sizes of a set into their ranges, one after the other."""
SHAPES = (0.5, 0.15, 0.85)
"""Where in its range a shape parameter is tried: its nominal value for the first."""


@dataclass(frozen=True)
class Variant:
    """A candidate with its shape parameters at one trial value."""

    candidate: int
    shape: tuple[float, ...]


@dataclass(frozen=True)
class Picture:
    """All variants at once, nuisances eliminated: gain of a set S is ``b_S' G_S^-1 b_S``.

    Attributes:
        G: (V, V) dimensionless, per unit of each variant's typical size.
        b: (V,) likewise.
        low: (V,) least that the sizes may be, in units of the typical ones.
        high: (V,) most that they may be, likewise.
        units: (V,) the variants' typical sizes, each in its first parameter's unit.
        nuisance: whitened columns of the unknowns, (B, ny, K) per recording.
        columns: whitened columns of the variants, (B, ny, V) per recording and per unit of size.
        sizes: (V,) what was there where the picture was taken, each in its first parameter's unit.
        faults: (V,) bool, is the variant a fault of a sensor or an input?
        shapes: (V,) dimensionless, how many parameters shape it.
        families: (V,) dimensionless labels of what can become the same effect: one of a family is enough.
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
    faults: np.ndarray
    shapes: np.ndarray
    families: np.ndarray

    def gain(self, chosen: Sequence[int]) -> float:
        """What a set explains, sizes in their physical ranges; minus infinity if one would have to be negative."""
        return float(self.gains([chosen])[0])

    def gains(self, sets: Sequence[Sequence[int]]) -> Array:
        """Of many sets at once."""
        out = np.zeros(len(sets))
        lengths = np.array([len(chosen) for chosen in sets])
        for k in np.unique(lengths[lengths > 0]):
            of_length = np.flatnonzero(lengths == k)
            i = np.array([sets[int(place)] for place in of_length])
            b = self.b[i]
            # A hair on the diagonal: of two columns that are the same, neither may be divided by.
            G = self.G[i[:, :, None], i[:, None, :]] + 1e-9 * np.eye(k) * self.G[i, i][:, None, :]
            size = np.linalg.solve(G, b[:, :, None])[:, :, 0]
            low, high = self.low[i], self.high[i]
            gains = np.sum(b * size, axis=1)
            outside = ((size < low - 1e-9) | (size > high + 1e-9)).any(axis=1)
            if outside.any():
                gains[outside] = _gain_within(G[outside], b[outside], size[outside], low[outside], high[outside])
            out[of_length] = gains
        return out

    def score(self, chosen: Sequence[int], penalty: float) -> float:
        """Gain of a set less what its effects must earn."""
        return float(self.scores([chosen], penalty)[0])

    def scores(self, sets: Sequence[Sequence[int]], penalty: float) -> Array:
        """Of many sets at once."""
        owed = []
        for chosen in sets:
            i = list(chosen)
            owed.append(price(len(i), int(self.faults[i].sum()), int(self.shapes[i].sum()), penalty))
        return self.gains(sets) - np.array(owed)


def _gain_within(G: Array, b: Array, size: Array, low: Array, high: Array) -> Array:
    """Gains (S,) of sets whose best sizes (S, k) lie outside their ranges, with sizes inside.

    One that would have to be there less than not at all does not belong into its set: minus infinity.
    """
    wrong = (((size < low - 1e-9) & (low == 0.0)) | ((size > high + 1e-9) & (high == 0.0))).any(axis=1)
    size = np.clip(size, low, high)
    for _ in range(SWEEPS):
        for k in range(size.shape[1]):
            left = b[:, k] - np.sum(G[:, k] * size, axis=1)
            size[:, k] = np.clip(size[:, k] + left / G[:, k, k], low[:, k], high[:, k])
    gains = np.sum(size * (2.0 * b - np.sum(G * size[:, None, :], axis=2)), axis=1)
    return np.where(wrong, -np.inf, gains)


def price(effects: int, faults: int, shapes: int, penalty: float) -> float:
    """What so many effects, faults among them, with so many parameters that shape them, must earn."""
    return penalty * effects + RARE * min(faults, max(effects - 1, 0)) + SHAPED * shapes


def is_fault(candidate: Candidate) -> bool:
    """Of a sensor or of an input."""
    return candidate.mechanism.kind != "physics"


def shape_count(candidate: Candidate) -> int:
    """Parameters besides its size that a fit may move."""
    return 0 if is_amplitude(candidate) else len(candidate.at) - 1


def variants(candidates: Sequence[Candidate]) -> tuple[Variant, ...]:
    """Every candidate with its shape parameters at their nominal and at an early and a late value."""
    out = []
    for j, candidate in enumerate(candidates):
        shapes = candidate.mechanism.parameters[1:] if not is_amplitude(candidate) else ()
        nominal = tuple(v.nominal for v in shapes)
        out.append(Variant(j, nominal))
        for place, v in enumerate(shapes):
            for share in SHAPES[1:]:
                moved = list(nominal)
                moved[place] = _within(v.low, v.high, share)
                out.append(Variant(j, tuple(moved)))
    return tuple(out)


def is_amplitude(candidate: Candidate) -> bool:
    """Are its parameters the simulator's own? They have no shape apart from their size."""
    return isinstance(candidate.mechanism, Amplitude)


def _is_of_a_sensor(candidate: Candidate) -> bool:
    """Does it change what a sensor makes of its readings, and nothing else?"""
    return isinstance(candidate.mechanism, Series) and candidate.mechanism.port.place == "output"


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
    problem: Problem,
    z: Array,
    listed: Sequence[Variant],
    present: Mapping[Variant, float] = MappingProxyType({}),
    advance: Callable[[], None] = lambda: None,
    projection: bool = True,
) -> Picture:
    """Linearise around a fit.

    Args:
        problem: parameters, start states and drifts.
        z: (K,) where the problem's unknowns stand, each in its own unit.
        listed: variants to show; those of ``present`` are added.
        present: what the fit holds already, and how much of it; sizes are shown from its absence all the same.
        projection: take out what the unknowns can imitate.
    """
    machine = problem.machine
    listed = (*present, *(v for v in listed if v not in present))
    sizes = np.array([present.get(v, 0.0) for v in listed])
    for variant, size in present.items():
        problem = replace(problem, theta=switched(machine, problem.theta, variant, size))
    residuals = problem.residuals(z)
    columns = _columns(problem, z, listed, sizes, advance)
    _, _, nuisance = problem.normal(z, residuals)
    columns = [problem.whitener(c) for c in columns]
    candidates = [machine.candidates[v.candidate] for v in listed]
    units = np.array([typical(c) for c in candidates])
    fixed = problem if projection else replace(problem, unknowns=())
    imitated = nuisance if projection else [c[:, :, :0] for c in nuisance]
    G, b = fixed.projected(z if projection else z[:0], residuals, imitated, [c * units for c in columns])
    # A candidate that moves nothing here must not be divided by.
    G = G + 1e-6 * np.eye(len(listed))
    low, high = _ranges(candidates, units)
    return Picture(
        variants=tuple(listed),
        G=G,
        b=b + G @ (sizes / units),
        low=low,
        high=high,
        units=units,
        nuisance=nuisance,
        columns=columns,
        sizes=sizes,
        faults=np.array([is_fault(c) for c in candidates]),
        shapes=np.array([shape_count(c) for c in candidates]),
        families=_families(candidates),
    )


def _columns(
    problem: Problem, z: Array, listed: Sequence[Variant], sizes: Array, advance: Callable[[], None]
) -> list[Array]:
    """What a unit of each variant's size does to the block means, (B, ny, V) per recording.

    Args:
        sizes: (V,) what of them is there already.
        advance: told that one more column is done.
    """
    machine, theta, residuals = problem.machine, problem.theta, problem.residuals(z)
    clean = [problem.clean(r, z) for r in range(len(problem.tracks))]
    columns = [np.zeros((*track.means.shape, len(listed))) for track in problem.tracks]

    def column(r: int, v: int) -> None:
        variant = listed[v]
        candidate = machine.candidates[variant.candidate]
        step = PROBE_SIZE * typical(candidate)
        first = candidate.mechanism.parameters[0]
        if not first.low <= candidate.null[0] + sizes[v] + step <= first.high:
            step = -step
        changed = switched(machine, theta, variant, sizes[v] + step)
        # A sensor's fault leaves the machine's own course as it is.
        known = clean[r] if _is_of_a_sensor(candidate) else None
        columns[r][:, :, v] = (residuals[r] - problem.residual(r, z, changed, known)) / step
        advance()

    parallel([lambda r=r, v=v: column(r, v) for r in range(len(problem.tracks)) for v in range(len(listed))])
    return columns


def _ranges(candidates: Sequence[Candidate], units: Array) -> tuple[Array, Array]:
    """What the sizes may be, lows (V,) and highs (V,), in typical sizes (V,)."""
    ends = np.empty((len(candidates), 2))
    for i, candidate in enumerate(candidates):
        bounds = np.array([candidate.mechanism.parameters[0].low, candidate.mechanism.parameters[0].high])
        ends[i] = np.sort((bounds - candidate.null[0]) / units[i])
    # However much of a candidate there must be, in the picture it begins at nothing.
    ends[:, 0] = np.minimum(ends[:, 0], 0.0)
    return ends[:, 0], ends[:, 1]


def _families(listed: Sequence[Candidate]) -> np.ndarray:
    known = {family: i for i, family in enumerate(dict.fromkeys(c.family for c in listed))}
    return np.array([known[c.family] for c in listed])


def switched(machine: Machine, theta: Array, variant: Variant, size: float) -> Array:
    """Parameters with a variant there, ``size`` from its absence.

    Args:
        theta: (n_theta,) each in its parameter's unit.
        size: in the unit of its first parameter.
    """
    candidate = machine.candidates[variant.candidate]
    changed = theta.copy()
    changed[candidate.at[0]] = candidate.null[0] + size
    if is_amplitude(candidate):
        rest = candidate.null[1:] + size / typical(candidate) * (candidate.typical[1:] - candidate.null[1:])
    else:
        rest = np.array(variant.shape)
    changed[list(candidate.at[1:])] = rest
    return changed
