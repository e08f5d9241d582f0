"""A hypothesis brought to its own fixed point: linearised where it says the machine is, until its evidence stands."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from scipy.linalg import cho_factor, cho_solve
from scipy.special import erfcx, logsumexp

from twinbench.mismatch.fit import Problem, Unknown
from twinbench.mismatch.machine import Machine
from twinbench.mismatch.naming.bounded import bounded
from twinbench.mismatch.naming.ground import Ground, Products
from twinbench.mismatch.naming.marginal import UNTOLD, Learnt, eliminated, learn, one_sided
from twinbench.mismatch.naming.view import HARDLY, WANDERS, View, scale_of
from twinbench.mismatch.place import CLOCK
from twinbench.mismatch.solve import NEARLY, solve
from twinbench.mismatch.variants import Variant, is_amplitude, typical
from twinbench.physics.simulator import Array, Series

SETTLED = 1.0
"""Nats by which the evidence may still move."""
TURNS, SHORTENINGS = 24, 5
"""Linearisations of one hypothesis at most, and how often one step is shortened."""
HOPELESS, TRIED = 30.0, 2
"""Nats by which a hypothesis may lie behind the best one, what its next step promises counted, and linearisations
after which it is then given up. A rival so far behind has no weight in any answer."""
FAR_ROUNDS = 12
"""Jacobians of a fit without discrepancy, from far off."""
BOUND_TURNS = 4
"""Times at most that the discrepancy is learnt because other unknowns stand at their bounds; most hypotheses meet none
and take one. What more of them would change was not measured."""
SHORTENED = 0.4
"""What is left of a step that is too long."""


@dataclass(frozen=True)
class Effect:
    """An effect as part of a hypothesis: a candidate, its shape and its size.

    Attributes:
        size: from absence, in the first parameter's unit.
        sd: of the size's prior, in the same unit.
        prior: log prior odds.
    """

    variant: Variant
    size: float
    sd: float
    prior: float


@dataclass(frozen=True, eq=False)
class Settled:
    """A hypothesis at its fixed point.

    Attributes:
        effects: as they were proposed; ``now`` has them as they are.
        problem: its fit; its last unknowns are the effects' parameters, then where what they remember starts.
        z: (K,) where the problem's unknowns stand, each in its own unit.
        first: how many unknowns are not the effects'.
        log: evidence in nats, its prior in it; comparable between hypotheses.
        sizes: (E,) of each effect from absence, in its first parameter's unit.
        sds: (E,) their posterior sds, in the same units.
        learnt: the discrepancy beside it.
        at: (K,) where its unknowns are, each in its own unit: the posterior mean, if the step there could be made.
        cov: (K, K) posterior covariance of the standardised unknowns, which are in prior sds.
        products: of the columns there.
        share: by which its effects' sizes differ from place to place (sd), WANDERS or HARDLY.
        mean: (K + W,) prior mean of the unknowns and of what wanders, from there, standardised: in prior sds.
    """

    effects: tuple[Effect, ...]
    problem: Problem
    z: Array
    first: int
    log: float
    sizes: Array
    sds: Array
    learnt: Learnt
    at: Array
    cov: Array
    products: Products
    share: float
    mean: Array

    @property
    def bare(self) -> Problem:
        """The problem without its effects."""
        return replace(self.problem, unknowns=self.problem.unknowns[: self.first])

    @property
    def own(self) -> Array:
        """Where the unknowns of the bare problem stand."""
        return self.z[: self.first]

    @property
    def now(self) -> tuple[Effect, ...]:
        """The effects with the sizes and shapes that they have."""
        found, at = [], self.first
        for effect, size in zip(self.effects, self.sizes, strict=True):
            n = _entries(self.problem, effect.variant)
            shape = tuple(self.z[at + 1 : at + n]) or effect.variant.shape
            found.append(replace(effect, variant=replace(effect.variant, shape=shape), size=float(size)))
            at += n
        return tuple(found)

    def entries(self, effect: int) -> np.ndarray:
        """Positions of an effect's parameters among the unknowns, its size first, then of where its memory starts."""
        counts = [_entries(self.problem, e.variant) for e in self.effects]
        at = self.first + sum(counts[:effect])
        own = self.problem.machine.own_states(self.problem.machine.candidates[self.effects[effect].variant.candidate])
        starts = [k for k, u in enumerate(self.problem.unknowns) if u.kind == "start" and u.at in own]
        return np.array([*range(at, at + counts[effect]), *starts], dtype=int)

    @property
    def wanders(self) -> list[int]:
        """Positions of the sizes that may differ from place to place."""
        return [int(self.entries(i)[0]) for i, e in enumerate(self.effects) if may_wander(self.problem, e)]

    def prior(self, ground: Ground) -> tuple[Array, Array]:
        """Mean and precision (K + W + F,) of all that ``products`` has columns of, the discrepancy's functions last."""
        mean = np.concatenate((self.mean, np.zeros(len(ground.group))))
        return mean, np.concatenate((np.ones(len(self.mean)), ground.precision(self.learnt.s)))

    @property
    def since_s(self) -> float:
        """When its effects begin, on the recordings' clock; minus infinity if they were always there."""
        return self.problem.since[0] if self.effects and self.problem.since else -np.inf


def settled(
    problem: Problem,
    z: Array,
    effects: Sequence[Effect],
    ground: Ground,
    s: Array,
    far: bool = False,
    rival: float = -np.inf,
) -> Settled:
    """Linearise, move to the posterior mean, and again.

    The evidence is that of a Gaussian around where the hypothesis stands (Laplace): what a step promises counts only
    once it was made.

    Args:
        problem: with no effect in it.
        z: (K,) where the problem's unknowns stand, each in its own unit.
        s: (P,) discrepancy to begin with, per cent.
        far: is the calibrated machine so far off that the discrepancy would take all steps? Then the hypothesis is
            first fitted without one.
        rival: evidence of the best hypothesis so far, nats.
    """
    parameters = [u for e in effects for u in unknowns_of(problem, e)]
    starts = memory_starts(problem.machine, effects, len(problem.tracks))
    whole = replace(problem, unknowns=(*problem.unknowns, *parameters, *starts))
    bounds = _Bounds.of(whole)
    z, firsts = _start(whole, z, effects)
    z = np.clip(z, bounds.low, bounds.high)
    # Where the simulator's equations are taken for exact, so are the effects'.
    wanders = [k for k, e in zip(firsts, effects, strict=True) if ground.ports and may_wander(problem, e)]
    shares = (WANDERS, HARDLY) if wanders else (WANDERS,)
    if far:
        z = solve(whole, z, FAR_ROUNDS, share=NEARLY)[0]
    best: Settled | None = None
    for turn in range(1, TURNS + 1):
        whole = whole.refined(z)  # what blocks leave out depends on where the hypothesis stands
        view = View.around(whole, z)
        columns = columns_of(view, ground, wanders)
        products = ground.products(view, columns)
        mean = np.zeros(len(products.own[0]) - 1)
        mean[: len(z)] = (whole.z0 - z) / bounds.scale
        either = [products.scaled(np.arange(len(z), len(mean)), share / WANDERS) for share in shares]
        low, high = ((side - z) / bounds.scale for side in (bounds.low, bounds.high))
        found = [_posterior(p, mean, ground, s, low, high) for p in either]
        logs = np.array([one.log for one in found])
        likelier = int(np.argmax(logs))
        products, share, (_, learnt, _, step, promised) = either[likelier], shares[likelier], found[likelier]
        # Intervals stay as wide as a form that is not exact makes them.
        cov = found[0].cov[: len(z), : len(z)]
        s = learnt.s
        moved = np.clip(z + step * bounds.scale, bounds.low, bounds.high)
        at = moved if promised < SETTLED else z
        sizes, sds = (at - whole.z0)[firsts], (np.sqrt(np.diag(cov)) * bounds.scale)[firsts]
        log = float(logsumexp(logs)) - np.log(len(shares)) - 0.5 * products.over()[2] + sum(e.prior for e in effects)
        log += float(one_sided(np.abs(sizes), sds, bounds.one_way[firsts]).sum())
        hopeless = turn >= TRIED and log < rival - HOPELESS
        if promised > SETTLED:
            log -= promised
        if best is None or log > best.log:
            best = Settled(
                tuple(effects), whole, z, len(problem.unknowns), log, sizes, sds, learnt, at, cov, products, share, mean
            )
        if promised < SETTLED or hopeless:
            break
        wandering = [ground.whitened(r, c[:, :, len(z) :], view.residuals[r])[:, :-1] for r, c in enumerate(columns)]
        ahead = _as_far_as_it_helps(z, moved, misfit(whole, ground, s, Wandering.of(products, wandering, share)), whole)
        if ahead is None:
            break
        z = ahead
    assert best is not None
    return best


def may_wander(problem: Problem, effect: Effect) -> bool:
    """Is it physics, whose form is never exact? A fault of a channel is what it says."""
    return not isinstance(problem.machine.candidates[effect.variant.candidate].mechanism, Series)


def columns_of(view: View, ground: Ground, wanders: Sequence[int]) -> list[Array]:
    """Columns of a view's unknowns, then of the sizes (positions ``wanders``) that differ from place to place."""
    own = view.unknowns()
    if not wanders:
        return own
    wandering = view.wandering(ground.discrepancy, wanders, WANDERS)
    return [np.concatenate((j, w), axis=2) for j, w in zip(own, wandering, strict=True)]


@dataclass(frozen=True)
class _Bounds:
    """Of unknowns (K,), in their own units; ``one_way`` where the prior's mean is a bound."""

    low: Array
    high: Array
    scale: Array
    one_way: np.ndarray

    @classmethod
    def of(cls, problem: Problem) -> _Bounds:
        u = problem.unknowns
        one_way = np.array([v.mean in (v.low, v.high) for v in u], dtype=bool)
        return cls(np.array([v.low for v in u]), np.array([v.high for v in u]), np.array([*map(scale_of, u)]), one_way)


def _entries(problem: Problem, variant: Variant) -> int:
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


def _start(whole: Problem, z: Array, effects: Sequence[Effect]) -> tuple[Array, list[int]]:
    """The unknowns with the effects as proposed, and where their sizes stand."""
    at, firsts, parts = len(z), [], [z]
    for effect in effects:
        n = _entries(whole, effect.variant)
        candidate = whole.machine.candidates[effect.variant.candidate]
        parts.append(np.array([candidate.null[0] + effect.size, *(effect.variant.shape if n > 1 else ())]))
        firsts.append(at)
        at += n
    parts.append(np.zeros(len(whole.unknowns) - at))
    return np.concatenate(parts), firsts


class _Posterior(NamedTuple):
    """Of the unknowns (K,) and what wanders (W,), around where a hypothesis stands.

    Attributes:
        log: evidence in nats, constants apart, within the bounds.
        learnt: the discrepancy beside them.
        cov: (K + W, K + W) their covariance, in prior sds squared, bounds apart.
        step: (K,) to the likeliest within the bounds, in prior sds.
        promised: nats that the step gains.
    """

    log: float
    learnt: Learnt
    cov: Array
    step: Array
    promised: float


def _posterior(products: Products, mean: Array, ground: Ground, s: Array, low: Array, high: Array) -> _Posterior:
    """What the products say.

    Args:
        mean: (K + W,) of the prior, from where the hypothesis stands, in prior sds.
        s: (P,) discrepancy to begin with, per cent.
        low: (K,) bounds of the unknowns, from there, in prior sds.
        high: (K,) likewise.
    """
    G, b, _ = products.over()
    n, many = len(mean), len(b)
    held, x = np.zeros(many, dtype=bool), np.zeros(many)
    step, at_bound = np.zeros(n), np.zeros(n, dtype=bool)
    for _ in range(BOUND_TURNS):
        # What a bound holds stands there, and the discrepancy is learnt with it there.
        held[:n], x[:n] = at_bound, np.where(at_bound, step, 0.0)
        free, left = np.flatnonzero(~held[:n]), np.flatnonzero(~held)
        right = b - G @ x
        inner = eliminated(G[np.ix_(left, left)], right[left], np.arange(len(free)), mean[free], np.ones(len(free)))
        learnt = learn(inner.G, inner.b, ground.group, s)
        block = np.arange(n, many)
        outer = eliminated(G, b, block, np.zeros(len(block)), ground.precision(learnt.s))
        A, slope = outer.G + np.eye(n) * (1.0 + 1e-9), outer.b + mean
        step, at_bound = bounded(A, slope, low, high)
        if np.array_equal(at_bound, held[:n]):
            break
    cov = cho_solve(cho_factor(A), np.eye(n))
    # What wanders moves with no step: it is integrated out of what the step gains, as the discrepancy is.
    wander, k = slope[len(low) :], slice(len(low), n)
    idle = 0.5 * float(wander @ cho_solve(cho_factor(A[k, k]), wander)) if len(wander) else 0.0
    promised = float(slope @ step) - 0.5 * float(step @ A @ step) - idle
    stands, sd = x[held], np.sqrt(np.diag(cov)[held[:n]])
    log = inner.log + learnt.log + float(stands @ (b[held] - 0.5 * G[np.ix_(held, held)] @ stands))
    log -= 0.5 * float(np.sum((stands - mean[held[:n]]) ** 2))
    # At a bound only the flank exp(-t x - x^2/2) of what is likelier beyond it is left, in place of a whole Gaussian.
    flank = np.abs(slope - A @ step)[held[:n]] * sd
    log += float(np.log(sd * erfcx(flank / np.sqrt(2.0))).sum())
    return _Posterior(log, learnt, cov, step[: len(low)], promised)


class Wandering(NamedTuple):
    """Columns of what differs from place to place, in its prior sds.

    Attributes:
        white: (B * ny, W) per recording, whitened.
        own: (W, W) products of these with each other.
        cross: (W, F) and with the discrepancy's.
    """

    white: Sequence[Array]
    own: Array
    cross: Array

    @classmethod
    def of(cls, products: Products, white: Sequence[Array], share: float) -> Wandering:
        """The last columns of products that were made smaller to a share, from those that were not.

        Args:
            white: (B * ny, W) per recording, whitened, by WANDERS.
        """
        k = slice(products.own.shape[1] - 1 - white[0].shape[1], -1)
        return cls(
            [w * (share / WANDERS) for w in white], products.own[:, k, k].sum(axis=0), products.cross[:, k].sum(axis=0)
        )


def misfit(
    problem: Problem, ground: Ground, s: Array, wandering: Wandering | None = None
) -> Callable[[Array, Problem], float]:
    """Twice minus the log posterior of unknowns (K,), the discrepancy of a size integrated out, constants apart.

    It is asked with the unknowns and with the problem, which may differ from the one given in when effects begin.

    Args:
        s: (P,) size of the discrepancy at each port, per cent.
        wandering: what else is integrated out.
    """
    square = squared(ground, s, wandering)
    scale = np.array([scale_of(u) for u in problem.unknowns])

    def of(z: Array, problem: Problem) -> float:
        residuals = problem.residuals(z)
        if any(np.isnan(r[np.isfinite(t.means)]).any() for r, t in zip(residuals, problem.tracks, strict=True)):
            return np.inf
        return float(np.sum(((z - problem.z0) / scale) ** 2)) + square(residuals)

    return of


def squared(ground: Ground, s: Array, wandering: Wandering | None = None) -> Callable[[Sequence[Array]], float]:
    """Squares of what readings differ by, (B, ny) per recording, in sds of the noise; the discrepancy integrated out.

    Args:
        s: (P,) size of the discrepancy at each port, per cent.
        wandering: what else is integrated out.
    """
    d = 1.0 / np.sqrt(ground.precision(s))
    FF, white = ground.FF.sum(axis=0), list(ground.white)
    if wandering is not None:
        d = np.concatenate((np.ones(len(wandering.own)), d))
        FF = np.block([[wandering.own, wandering.cross], [wandering.cross.T, FF]])
        white = [np.concatenate(pair, axis=1) for pair in zip(wandering.white, white, strict=True)]
    some = np.flatnonzero(d**2 * np.diag(FF) > UNTOLD)
    d, shown = d[some], [w[:, some] for w in white]
    factor = cho_factor(np.eye(len(some)) + d[:, None] * FF[np.ix_(some, some)] * d) if len(some) else None

    def of(differences: Sequence[Array]) -> float:
        total, right = 0.0, np.zeros(len(some))
        for r, difference in enumerate(differences):
            left = ground.whitened(r, np.empty((*difference.shape, 0)), difference)[:, 0]
            total += float(left @ left)
            right += shown[r].T @ left
        return total - (float((d * right) @ cho_solve(factor, d * right)) if factor is not None else 0.0)

    return of


def _as_far_as_it_helps(
    z: Array, moved: Array, cost: Callable[[Array, Problem], float], problem: Problem
) -> Array | None:
    """The step, or as much of it as makes the fit better; None if nothing does."""
    here = cost(z, problem)
    for _ in range(SHORTENINGS):
        if cost(moved, problem) < here:
            return moved
        moved = z + SHORTENED * (moved - z)
    return None
