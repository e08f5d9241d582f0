"""A hypothesis brought to its own fixed point: linearised where it says the machine is, until its evidence stands."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from scipy.special import logsumexp

from twinbench.mismatch.began import late_odds
from twinbench.mismatch.fit import Problem
from twinbench.mismatch.naming.bounded import Bounds
from twinbench.mismatch.naming.effect import Effect, may_wander, memory_starts, unknowns_of, width, with_effects
from twinbench.mismatch.naming.ground import Ground, Products
from twinbench.mismatch.naming.marginal import Learnt, one_sided
from twinbench.mismatch.naming.misfit import Wandering, diverged, misfit
from twinbench.mismatch.naming.odds import of_number
from twinbench.mismatch.naming.posterior import posterior
from twinbench.mismatch.naming.view import HARDLY, WANDERS, View
from twinbench.mismatch.solve import NEARLY, solve
from twinbench.physics.simulator import Array

SETTLED = 1.0
"""Nats by which the evidence may still move."""
TURNS, SHORTENINGS = 24, 5
"""Linearisations of one hypothesis at most, and how often one step is shortened."""
STALE = 5
"""Linearisations that may gain less than a nat together: three say that steps go to and fro, and two try halfway. Of
seven cases four found the same in all as no such end, and three in six."""
DAMPINGS = (0.01, 0.1, 1.0, 10.0)
"""How much a step of which no share makes the fit better is damped, one after the other: so it is along a curved
valley. On the Cascaded Tanks sets of a dozen effects came to rest at 246 nats without, at 421 with it."""
HOPELESS, GIVEN_UP_AFTER = 30.0, 2
"""Nats by which a hypothesis may lie behind the best one, what its next step promises counted, and linearisations
after which it is then given up, or after the first where a fit came before. A rival so far behind has no weight in any
answer."""
FAR_ROUNDS = 12
"""Jacobians of a fit without discrepancy, from far off."""
AS_WIDE = 2.0
"""Factor by which a prior may be wider or narrower than its effect is large. How large an effect may be was told from
afar: what is named larger gives way to a discrepancy, and what is smaller, one of a dozen, pays for all that there was
to explain. Then the prior becomes as wide as the effect is large. It moved the Cascaded Tanks from 305 nats to 417."""
SHORTENED = 0.4
"""What is left of a step that is too long, or of a way on which the run diverges."""


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
        wanders: positions of the sizes that may differ from place to place.
        share: by which they do (sd), WANDERS or HARDLY.
        mean: (K + W,) prior mean of the unknowns and of what wanders, from there, standardised: in prior sds.
        promised: nats that a further step only promises; ``log`` is less them.
        given_up: was it left behind before it came to rest?
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
    wanders: list[int]
    share: float
    mean: Array
    promised: float = 0.0
    given_up: bool = False

    @property
    def candidates(self) -> list[int]:
        """Positions of its effects' candidates."""
        return [e.variant.candidate for e in self.effects]

    @property
    def names(self) -> tuple[str, ...]:
        """Of its effects' candidates."""
        return tuple(self.problem.machine.candidates[c].name for c in self.candidates)

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
        return self.effects_at(self.z)

    def effects_at(self, z: Array) -> tuple[Effect, ...]:
        """The effects as they are elsewhere.

        Args:
            z: (K,) where the unknowns stand, each in its own unit.
        """
        found = []
        for i, effect in enumerate(self.effects):
            candidate = self.problem.machine.candidates[effect.variant.candidate]
            entries, n = self.entries(i), width(self.problem, effect.variant)
            shape = tuple(map(float, z[entries[1:n]])) or effect.variant.shape
            variant = replace(effect.variant, shape=shape)
            size, memory = float(z[entries[0]] - candidate.null[0]), tuple(map(float, z[entries[n:]]))
            found.append(replace(effect, variant=variant, size=size, memory=memory))
        return tuple(found)

    def entries(self, effect: int) -> np.ndarray:
        """Positions of an effect's parameters among the unknowns, its size first, then of where its memory starts."""
        counts = [width(self.problem, e.variant) for e in self.effects]
        at = self.first + sum(counts[:effect])
        own = self.problem.machine.own_states(self.problem.machine.candidates[self.effects[effect].variant.candidate])
        starts = [k for k, u in enumerate(self.problem.unknowns) if u.kind == "start" and u.at in own]
        return np.array([*range(at, at + counts[effect]), *starts], dtype=int)

    def wandering(self, effect: int) -> np.ndarray:
        """Positions, the unknowns first, of what an effect's size differs by from place to place; none of a fault."""
        size = int(self.entries(effect)[0])
        if size not in self.wanders:
            return np.empty(0, dtype=int)
        first = len(self.z)
        each = (len(self.mean) - first) // len(self.wanders)
        return first + each * self.wanders.index(size) + np.arange(each)

    @property
    def squares(self) -> float:
        """What it leaves of the readings without any discrepancy, in variances of the noise."""
        k = np.arange(len(self.z))
        G, b, squares = self.products.over()
        A = G[np.ix_(k, k)] + np.eye(len(k))
        step = np.linalg.solve(A, b[k] + self.mean[k])
        return float(squares - 2.0 * b[k] @ step + step @ G[np.ix_(k, k)] @ step)

    def prior(self, ground: Ground) -> tuple[Array, Array]:
        """Mean and precision (K + W + F,) of all that ``products`` has columns of, the discrepancy's functions last."""
        mean = np.concatenate((self.mean, np.zeros(len(ground.group))))
        return mean, np.concatenate((np.ones(len(self.mean)), ground.precision(self.learnt.s)))

    @property
    def odds(self) -> float:
        """Log prior odds of its effects, of so many, and of beginning when they do."""
        return odds_of(self.problem, self.effects)

    @property
    def since_s(self) -> float:
        """When its effects begin, on the recordings' clock; minus infinity if they were always there."""
        return _since(self.problem, self.effects)


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
    once it was made. Once at rest, priors become as wide as their effects are large, and it settles again, as long as
    that gains.

    Args:
        problem: with no effect in it.
        z: (K,) where the problem's unknowns stand, each in its own unit.
        s: (P,) discrepancy to begin with, per cent.
        far: is the calibrated machine so far off that the discrepancy would take all steps? Then the hypothesis is
            first fitted without one.
        rival: evidence of the best hypothesis so far, nats.
    """
    best = _at_rest(problem, z, effects, ground, s, rival, FAR_ROUNDS if far else 0)
    while not best.given_up:
        told = [now.as_large for now in best.now]
        if all(1.0 / AS_WIDE <= new.sd / now.sd <= AS_WIDE for new, now in zip(told, best.now, strict=True)):
            break
        again = _at_rest(best.bare, best.own, told, ground, best.learnt.s, rival)
        if not again.log > best.log + SETTLED:
            return max(best, again, key=lambda h: h.log)
        best = again
    return best


def _at_rest(
    problem: Problem,
    z: Array,
    effects: Sequence[Effect],
    ground: Ground,
    s: Array,
    rival: float,
    rounds: int = 0,
) -> Settled:
    """A hypothesis where it comes to rest, its priors as they are; arguments as of ``settled``.

    Args:
        rounds: Jacobians of a fit without discrepancy that comes first.
    """
    hypothesis, whole, z = _Hypothesis.begun(problem, z, effects, ground)
    if rounds:
        z = solve(whole, z, rounds, share=NEARLY)[0]
    best: Settled | None = None
    mark, marked = -np.inf, 0  # evidence at the last turn that was worth its while, and which turn that was
    by_runs, moved = False, True
    for turn in range(1, TURNS + 1):
        if moved:
            whole = whole.refined(z)  # what blocks leave out depends on where the hypothesis stands
        here = hypothesis.linearised(whole, z, s, by_runs)
        s = here.stands.learnt.s
        worse = best is not None and here.stands.log < best.log
        if best is None or here.stands.log > best.log:
            best = here.stands
        if best.log > mark + SETTLED:
            mark, marked = best.log, turn
        if here.promised < SETTLED or turn - marked >= STALE:
            break
        if (rounds or turn >= GIVEN_UP_AFTER) and here.hoped < rival - HOPELESS:
            return replace(best, given_up=True)
        if worse and turn > marked + 1:  # with the discrepancy's size a better fit is another, to and fro
            z, moved = 0.5 * (best.z + z), True
            continue
        ahead = _as_far_as_it_helps(z, here, misfit_around(here.stands, ground, here.view, here.columns))
        moved = ahead is not None
        if not moved and by_runs:
            break
        by_runs |= not moved  # columns that take each stretch for linear have led astray
        z = z if ahead is None else ahead
    assert best is not None
    return best


class _Here(NamedTuple):
    """A hypothesis linearised in one place.

    Attributes:
        stands: as it stands there; its evidence is less what the next step only promises.
        hoped: its evidence, nats, should the step keep its promise.
        promised: nats that the step should gain.
        moved: (K,) where the step goes, each unknown in its own unit; by how much it is damped.
        view: around that place.
        columns: (B, ny, K + W) per recording, in the outputs' units per prior sd; by WANDERS of what wanders.
    """

    stands: Settled
    hoped: float
    promised: float
    moved: Callable[[float], Array]
    view: View
    columns: list[Array]


@dataclass(frozen=True)
class _Hypothesis:
    """Effects beside a problem's own unknowns, of which there are ``first``; ``sizes`` are positions of theirs."""

    effects: tuple[Effect, ...]
    ground: Ground
    bounds: Bounds
    first: int
    sizes: list[int]
    wanders: list[int]

    @classmethod
    def begun(
        cls, problem: Problem, z: Array, effects: Sequence[Effect], ground: Ground
    ) -> tuple[_Hypothesis, Problem, Array]:
        """It, its problem, and where its unknowns (K,) begin, each in its own unit."""
        parameters = [u for e in effects for u in unknowns_of(problem, e)]
        starts = memory_starts(problem.machine, effects, len(problem.tracks))
        whole = replace(problem, unknowns=(*problem.unknowns, *parameters, *starts))
        bounds = Bounds.of(whole)
        z, sizes = with_effects(whole, z, effects)
        # Where the simulator's equations are taken for exact, so are the effects'.
        wanders = [k for k, e in zip(sizes, effects, strict=True) if ground.ports and may_wander(problem, e)]
        made = cls(tuple(effects), ground, bounds, len(problem.unknowns), sizes, wanders)
        z = np.clip(z, bounds.low, bounds.high)
        while not np.allclose(z, whole.z0) and diverged(whole, whole.residuals(z)):
            z = whole.z0 + SHORTENED * (z - whole.z0)  # towards the machine as it came
        return made, whole, z

    def linearised(self, whole: Problem, z: Array, s: Array, by_runs: bool) -> _Here:
        """It in one place.

        Args:
            z: (K,) this place.
            s: (P,) discrepancy to begin with, per cent.
            by_runs: as of ``Problem.columns``.
        """
        bounds, sizes = self.bounds, self.sizes
        shares = (WANDERS, HARDLY) if self.wanders else (WANDERS,)
        view = View.around(whole, z)
        columns = columns_of(view, self.ground, self.wanders, by_runs)
        products = self.ground.products(view, columns)
        mean = np.zeros(len(products.own[0]) - 1)
        mean[: len(z)] = (whole.z0 - z) / bounds.scale
        either = [products.scaled(np.arange(len(z), len(mean)), share / WANDERS) for share in shares]
        low, high = bounds.around(z)
        found = [posterior(p, mean, self.ground, s, low, high) for p in either]
        logs = np.array([one.log for one in found])
        likelier = int(np.argmax(logs))
        products, share, said = either[likelier], shares[likelier], found[likelier]
        learnt, promised = said.learnt, said.promised

        def moved(damping: float) -> Array:
            step = said.damped(damping) if damping else said.step
            return np.clip(z + step * bounds.scale, bounds.low, bounds.high)

        # Intervals stay as wide as a form that is not exact makes them.
        cov = found[0].cov[: len(z), : len(z)]
        at = moved(0.0) if promised < SETTLED else z
        from_none, sds = (at - whole.z0)[sizes], (np.sqrt(np.diag(cov)) * bounds.scale)[sizes]
        log = float(logsumexp(logs)) - np.log(len(shares)) - 0.5 * products.over()[2]
        log += float(one_sided(np.abs(from_none), sds, bounds.one_way[sizes]).sum()) + odds_of(whole, self.effects)
        ahead = promised if promised > SETTLED else 0.0
        stands = Settled(
            self.effects, whole, z, self.first, log - ahead, from_none, sds, learnt,
            at, cov, products, self.wanders, share, mean, ahead,
        )  # fmt: skip
        return _Here(stands, log, promised, moved, view, columns)


def misfit_around(
    found: Settled, ground: Ground, view: View, columns: Sequence[Array]
) -> Callable[[Array, Problem], float]:
    """``misfit`` around where a hypothesis stands.

    Args:
        columns: (B, ny, K + W) per recording, in the outputs' units, as of ``columns_of``.
    """
    k, residuals = len(found.z), view.residuals
    white = [ground.whitened(r, c[:, :, k:], residuals[r])[:, :-1] for r, c in enumerate(columns)]
    return misfit(found.problem, ground, found.learnt.s, Wandering.of(found.products, white, found.share))


def columns_of(
    view: View,
    ground: Ground,
    wanders: Sequence[int],
    by_runs: bool = False,
    added: Mapping[int, Sequence[Array]] | None = None,
) -> list[Array]:
    """Columns of a view's unknowns, then of the sizes (positions ``wanders``) that differ from place to place.

    Args:
        by_runs: as of ``Problem.columns``.
        added: by position, (S,) per recording, in the size's unit, as ``View.wandering`` has it.
    """
    own = view.unknowns(by_runs)
    if not wanders:
        return own
    wandering = view.wandering(ground.discrepancy, wanders, WANDERS, added)
    return [np.concatenate((j, w), axis=2) for j, w in zip(own, wandering, strict=True)]


def _since(problem: Problem, effects: Sequence[Effect]) -> float:
    return problem.since[0] if effects and problem.since else -np.inf


def odds_of(problem: Problem, effects: Sequence[Effect]) -> float:
    """Log prior odds of effects in a problem, of so many, and of beginning when they do."""
    late = late_odds(problem.tracks) if _since(problem, effects) > -np.inf else 0.0
    return late + of_number(len(effects), len(problem.machine.candidates)) + sum(e.prior for e in effects)


def _as_far_as_it_helps(z: Array, here: _Here, cost: Callable[[Array, Problem], float]) -> Array | None:
    """Where the step goes, or as much of it or as damped as makes the fit better; None if nothing does."""
    problem, step = here.stands.problem, here.moved(0.0) - z
    now = cost(z, problem)
    shorter = (z + step * SHORTENED**k for k in range(SHORTENINGS))
    for moved in itertools.chain(shorter, map(here.moved, DAMPINGS)):
        if cost(moved, problem) < now:
            return moved
    return None
