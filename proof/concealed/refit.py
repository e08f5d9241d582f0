"""How near the rivals of an effect come when all that is unknown is fitted anew, and not to first order alone.

Where parameters hide most of a large effect they move far, and a distance along first-order columns is off by factors:
a leak and a lost gain can be one thing there, and look a hundred sds apart.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from twinbench.mismatch.calibrate import own_unknowns, shared_unknowns
from twinbench.mismatch.fit import Problem, Unknown
from twinbench.mismatch.naming.answer import PERIODIC
from twinbench.mismatch.naming.effect import Effect, unknowns_of
from twinbench.mismatch.sensors import SensorNoise
from twinbench.mismatch.solve import NEARLY, solve
from twinbench.mismatch.variants import Variant, switched, typical, variants
from twinbench.physics.simulator import Array
from twinbench.proof.concealed.columns import background_sds
from twinbench.proof.concealed.forms import in_step, loudest_s
from twinbench.proof.concealed.linear import Linear
from twinbench.proof.concealed.machine import Machine
from twinbench.proof.concealed.on_twin import OnTwin

ROUNDS = 5, 2
"""Jacobians of a fit, and of the same after blocks were brought in line with samples where it stands."""
TRIED = 0.03
"""Of a candidate's typical size: the step that its column is taken with, and the least size that a fit begins at."""
NOTHING = ""
"""The name of no effect at all."""
FREE = 1e3
"""sd of the size of another effect of the case, in its true sizes: as good as unknown."""


@dataclass
class _Known(Problem):
    """A fit under noise that is known, beside changes that are linear and unknown.

    Attributes:
        noise: of block means.
        beside: (S, E) columns of these changes, whitened, in sds of their sizes; S readings of all recordings.
    """

    noise: SensorNoise = field(kw_only=True)
    beside: Array = field(kw_only=True)

    def __post_init__(self) -> None:
        super().__post_init__()
        self._factor = cho_factor(np.eye(self.beside.shape[1]) + self.beside.T @ self.beside)

    def white(self, values: Array) -> Array:
        """Innovations in sds; arguments as in ``Problem``.

        Args:
            values: (B, ny) or (B, ny, K), in the outputs' units.
        """
        return self.noise.whitened(np.nan_to_num(values.reshape(*values.shape[:2], -1))).reshape(values.shape)

    def inner(self, a: Array, b: Array) -> Array:
        """Products of what the changes beside leave of columns (S, K) and (S, L), in sds: (K, L)."""
        return np.asarray(a.T @ b - (self.beside.T @ a).T @ cho_solve(self._factor, self.beside.T @ b))

    def cost(self, z: Array) -> float:
        """Squared distance; infinite where the machine diverges.

        Args:
            z: (K,) where the problem's unknowns stand, each in its own unit.
        """
        residuals = self.residuals(z)
        if not all(np.isfinite(r).all() for r in residuals):
            return np.inf
        left = self.stacked(residuals)
        return float(self.inner(left, left)[0, 0] + np.sum(self._prior(z) ** 2))

    def normal(self, z: Array) -> tuple[Array, list[Array]]:
        """As in ``Problem``.

        Args:
            z: (K,) where the problem's unknowns stand, each in its own unit.
        """
        whitened = [self.white(c) for c in self.columns(z)]
        J = np.concatenate([w.reshape(-1, len(z)) for w in whitened])
        return self.inner(J, J) + np.diag(self._precision), whitened

    def right_side(self, z: Array, whitened: Sequence[Array]) -> Array:
        """As in ``Problem``.

        Args:
            z: (K,) where the problem's unknowns stand, each in its own unit.
            whitened: columns (B, ny, K) per recording, dimensionless, as ``normal`` has them.
        """
        J = np.concatenate([w.reshape(-1, len(z)) for w in whitened])
        return self.inner(J, self.stacked(self.residuals(z)))[:, 0] + self._precision * (self.z0 - z)

    def stacked(self, values: Sequence[Array]) -> Array:
        """Whitened readings (B, ny) or columns (B, ny, K) of all recordings, (S, K)."""
        return np.concatenate([self.white(v).reshape(v.shape[0] * v.shape[1], -1) for v in values])


class _At(NamedTuple):
    """At the truth's constants: normal matrix, right side, columns (S, K) in sds, residuals (S, 1) in sds."""

    G: Array
    b: Array
    columns: Array
    left: Array


class _Begun(NamedTuple):
    """A rival with the size that it has to first order, and what that gains, in squared sds."""

    effect: Effect
    gain: float


def refitted(
    run: OnTwin,
    change: Mapping[int, Array],
    others: Sequence[Mapping[int, Array]],
    background_pct: float,
    names: Iterable[str],
) -> dict[str, float]:
    """Squared distances of an effect's readings from what the twin comes nearest to with each of these, in sds.

    Args:
        change: what the effect does to the readings of each take that may be learnt from, (N, ny), in their units.
        others: likewise what other effects of the case do, whose sizes are unknown.
        background_pct: the ripple's size.
        names: of the catalogue, or ``NOTHING``. What the twin has no small size of is left out.
    """
    problem = _problem(run, change, others, background_pct)
    G, whitened = problem.normal(problem.z0)
    b, left = problem.right_side(problem.z0, whitened), problem.stacked(problem.residuals(problem.z0))
    at = _At(G, b, np.concatenate([w.reshape(-1, len(b)) for w in whitened]), left)
    names, found = list(names), {}

    def name_of(variant: Variant) -> str:
        return run.twin.candidates[variant.candidate].name

    tried, periods_s = [v for v in variants(run.twin.candidates) if not name_of(v).startswith(PERIODIC)], None
    if any(name.startswith(PERIODIC) for name in names):
        periods_s = loudest_s(run, change)
        tried += in_step(run, periods_s[1])
    for name in names:
        begun = [_begun(problem, v, at) for v in tried if name_of(v) == name]
        if name == NOTHING:
            found[name] = _distance_sq(problem, None)
        elif begun:
            nearest = max(begun, key=lambda one: one.gain).effect
            found[name] = _distance_sq(problem, nearest, periods_s if name.startswith(PERIODIC) else None)
    return found


def _begun(problem: _Known, variant: Variant, at: _At) -> _Begun:
    candidate = problem.machine.candidates[variant.candidate]
    first, null, usual = candidate.mechanism.parameters[0], candidate.null[0], typical(candidate)
    step = TRIED * usual if first.low <= null + TRIED * usual <= first.high else -TRIED * usual
    theta = switched(problem.machine, problem.theta, variant, step)
    z0, every = problem.z0, range(len(problem.tracks))
    there = [problem.residual(r, z0, theta) for r in every]
    change = [(a - b) / step for a, b in zip(problem.residuals(z0), there, strict=True)]
    if not all(np.isfinite(c).all() for c in change):
        return _Begun(Effect(variant, step, np.inf, 0.0), -np.inf)
    column = problem.stacked(change)
    across = problem.inner(at.columns, column)[:, 0]
    hidden = np.linalg.solve(at.G, np.stack((across, at.b), axis=1))
    square = float(problem.inner(column, column)[0, 0] - across @ hidden[:, 0])
    product = float(problem.inner(column, at.left)[0, 0] - across @ hidden[:, 1])
    size = product / max(square, np.finfo(float).tiny)
    size = float(np.clip(size if abs(size) > abs(step) else step, first.low - null, first.high - null))
    return _Begun(Effect(variant, size, np.inf, 0.0), size * (2.0 * product - size * square))


def _distance_sq(problem: _Known, effect: Effect | None, periods_s: tuple[float, float, float] | None = None) -> float:
    """Squared distance of the readings from the nearest that the twin can come, in sds of the noise.

    Args:
        periods_s: of a periodic force, as of ``loudest_s``.
    """
    z = problem.z0
    if effect is not None:
        unknowns = unknowns_of(problem, effect)
        begins = [unknowns[0].mean + effect.size, *(effect.variant.shape if len(unknowns) > 1 else ())]
        if periods_s is not None:
            unknowns[1:] = _in_step(unknowns[1:], periods_s)
        unknowns = [replace(u, sd=np.inf) for u in unknowns]
        problem = replace(problem, unknowns=(*problem.unknowns, *unknowns))
        z = np.concatenate((z, begins))
    cost = np.inf
    for rounds, share in zip(ROUNDS, (NEARLY, 0.0), strict=True):
        problem = problem.refined(z)
        z, cost = solve(problem, z, rounds, chords=0, share=share)
    return cost


def _in_step(shape: Sequence[Unknown], periods_s: tuple[float, float, float]) -> list[Unknown]:
    """Period and phase of a periodic force: a fit loses no count of its cycles, and no phase is at a bound."""
    (period, phase), (least, loudest, most) = shape, periods_s
    period = replace(period, low=least, high=most, mean=loudest, scale=(most - least) / 6.0)
    return [period, replace(phase, low=2.0 * phase.low, high=2.0 * phase.high)]


def _problem(
    run: OnTwin, change: Mapping[int, Array], others: Sequence[Mapping[int, Array]], background_pct: float
) -> _Known:
    machine, sigma = run.yardstick.machine, run.yardstick.machine.sigma()
    tracks = [track.reading(track.y + change[i]) for i, track in run.tracks.items()]
    unknowns = (*shared_unknowns(run.simulator), *own_unknowns(run.simulator, tracks))
    since = (run.onset_s,) * len(tracks) if np.isfinite(run.onset_s) else ()
    noise = noise_of_means(machine, int(np.diff(tracks[0].starts)[0]))
    linear, rippled = Linear(run.yardstick, run.onset_s), background_pct > 0.0
    sds = np.array(background_sds(machine, background_pct / 100.0))
    beside = []
    for i, track in run.tracks.items():
        unsure = linear.nuisances(i, rippled)[len(machine.calibrate) :].transpose(2, 1, 0) * sds
        columns = np.concatenate((unsure, *(FREE * other[i][:, :, None] for other in others)), axis=2)
        beside.append(np.add.reduceat(columns, track.starts) / track.coarse.samples[:, None, None])
    first = _Known(run.twin, tracks, unknowns, sigma, since=since, noise=noise, beside=np.zeros((1, 0)))
    return replace(first, beside=first.stacked(beside))


def noise_of_means(machine: Machine, block: int) -> SensorNoise:
    """The noise of means over blocks of so many samples."""
    apart = np.arange(1, block)
    found = []
    for name in machine.outputs:
        noise = machine.noise[name]
        keeps = np.exp(-machine.period_s / noise.tau_s) if noise.coloured else 0.0
        kept = (block + 2.0 * np.sum((block - apart) * keeps**apart)) / block**2
        memory = noise.tau_s / (block * machine.period_s) if noise.coloured else 1.0
        found.append(((noise.white**2 + machine.lsb[name] ** 2 / 12.0) / block, kept * noise.coloured**2, memory))
    return SensorNoise(*(np.array(part) for part in zip(*found, strict=True)))
