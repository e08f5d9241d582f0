"""All candidates in one view: what each would do to the readings, tried where it shows as half the noise."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from copy import copy
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from twinbench.mismatch.began import late_odds
from twinbench.mismatch.machine import Candidate
from twinbench.mismatch.naming.bounded import Bounds
from twinbench.mismatch.naming.effect import Effect
from twinbench.mismatch.naming.ground import Ground, Products
from twinbench.mismatch.naming.marginal import Reduced, eliminated
from twinbench.mismatch.naming.odds import log_odds
from twinbench.mismatch.naming.posterior import posterior
from twinbench.mismatch.naming.sets import PARAMETER, Sets
from twinbench.mismatch.naming.view import WANDERS, View, prior_mean
from twinbench.mismatch.variants import Variant, typical
from twinbench.physics.simulator import Array

FIRST_PROBE = 0.05
"""Share of its typical size that a candidate is first tried with."""
SHOWS = 0.5
"""Then it is tried with what shows as so many noise sds: an effect is judged at the size that it may have."""
LEAST_PROBE, MOST_PROBE = 1e-3, 1.0
VISIBLE = 0.5
"""Prior sd of how strongly an effect shows, in noise sds, or as strongly as all that there is to explain."""


@dataclass(frozen=True)
class Picture:
    """Candidates' variants around a view, each from the beginning, then the late ones.

    Attributes:
        variants: (V,) which.
        since: (V,) from when, s, on the recordings' clock; minus infinity from the beginning.
        candidates: (V,) of whom.
        odds: (V,) log prior odds of these, dimensionless; those of the variants in ``sets`` are shares of them.
        units: (V,) prior sd of each size, in the first parameter's unit.
        least: (V,) the sd with which it shows as half the noise, likewise.
        products: of the unknowns' columns, then theirs per typical size.
        sets: their evidence.
        log: what makes the sets' evidence comparable with that of other views, nats.
        excess: mean square that the unknowns leave, in noise variances, less one.
    """

    variants: tuple[Variant, ...]
    since: Array
    candidates: tuple[Candidate, ...]
    odds: Array
    units: Array
    least: Array
    products: Products
    sets: Sets
    log: float
    excess: float

    @cached_property
    def names(self) -> list[str]:
        """(V,) names of the candidates."""
        return [c.name for c in self.candidates]

    def firsts(self, order: Iterable[int]) -> list[int]:
        """Of positions in an order the first of each name."""
        found: dict[str, int] = {}
        for i in order:
            found.setdefault(self.names[i], int(i))
        return list(found.values())

    def effects(self, key: Iterable[int], sizes: Iterable[float]) -> list[Effect]:
        """Variants of some sizes from absence, each in its first parameter's unit."""
        return [
            Effect(self.variants[i], float(size), float(self.units[i]), float(self.odds[i]), float(self.least[i]))
            for i, size in zip(key, sizes, strict=True)
        ]


class Painter:
    """Makes pictures of a view; columns and their products are made once.

    Args:
        listed: the variants in every picture.
        probes: share of its typical size that each variant is tried with; found out if left out.
        wanders: positions among the unknowns of sizes that may differ from place to place; by which ``share``.
        since_s: from when the variants are there, on the recordings' clock.
        beside: so many effects are among the view's unknowns.
    """

    def __init__(
        self,
        view: View,
        ground: Ground,
        listed: Sequence[Variant],
        probes: Mapping[Variant, float] | None = None,
        wanders: Sequence[int] = (),
        share: float = WANDERS,
        since_s: float = -np.inf,
        beside: int = 0,
    ) -> None:
        self.view, self.ground, self.listed, self._beside = view, ground, tuple(listed), beside
        self._own, self._mean = view.unknowns(), prior_mean(view)
        self._left = np.arange(len(self._mean))
        if wanders:
            wandering = view.wandering(ground.discrepancy, wanders, share)
            self._own = [np.concatenate((j, w), axis=2) for j, w in zip(self._own, wandering, strict=True)]
            self._mean = np.concatenate((self._mean, np.zeros(wandering[0].shape[2])))
        self.readings = sum(int(np.isfinite(r).sum()) for r in view.residuals)
        if probes is None:
            first = view.of_variants(self.listed, np.full(len(self.listed), FIRST_PROBE))
            shows, *_ = self._shows(self._multiplied(lambda r: first[r]))
            tried = np.clip(SHOWS / np.maximum(shows, 1e-12), LEAST_PROBE, MOST_PROBE)
            probes = dict(zip(self.listed, map(float, tried), strict=True))
        self.probes = probes
        self._probes = np.array([probes[v] for v in self.listed])
        times = [since_s] if since_s > -np.inf else []
        columns = view.of_variants(self.listed, self._probes, times)
        self._since_s, self._columns = since_s, [c[:, :, len(times) :: 1 + len(times)] for c in columns]
        self._products = self._multiplied(lambda r: self._columns[r])
        self._without = np.empty((0, 0))

    def less(self, listed: Sequence[Variant], out: np.ndarray, beside: int) -> Painter:
        """The same view less one of its effects: its unknowns are at their prior's mean.

        Its shape does nothing where it is not. Nothing that begins later can be painted.

        Args:
            listed: those of the variants that are in every picture, in any order.
            out: (k,) positions of the effect's unknowns and of what wanders of it, its size first; none of no effect.
            beside: so many effects are left.
        """
        n, place = len(self._mean), {v: i for i, v in enumerate(self.listed)}
        left, some = np.delete(np.arange(n), out), n + np.array([place[v] for v in listed], dtype=int)
        G, _, _ = self._products.over()
        less = copy(self)
        less.listed, less._beside = tuple(listed), beside
        less._own, less._columns = [], []
        less._products = self._products.some(np.concatenate((left, some)), out[:1], self._mean[out[:1]])
        less._mean, less._left = self._mean[left], left[left < len(self._left)]
        less._probes = np.array([self.probes[v] for v in listed])
        with_it = np.concatenate((left, some, out[:1]))
        less._without = G[np.ix_(with_it, with_it)]
        return less

    def picture(self, since_s: Sequence[float] = (), late: Sequence[int] = ()) -> Picture:
        """All variants, and some that begin at given times.

        Args:
            since_s: the times.
            late: positions of those that may begin then.
        """
        which, since, products = list(range(len(self.listed))), [self._since_s] * len(self.listed), self._products
        if len(late) and len(since_s):
            many = 1 + len(since_s)
            keep = [k for k in range(many * len(late)) if k % many]
            later = [self.listed[i] for i in late], self._probes[list(late)], since_s

            def columns(r: int) -> Array:
                late = self.view.of_variants_in(r, *later)[:, :, keep]
                return np.concatenate((self._columns[r], late), axis=2)

            products = self._multiplied(columns)
            which += [late[k // many] for k in keep]
            since += [since_s[k % many - 1] for k in keep]
        shows, reduced, kept, excess, q = self._shows(products)
        candidates = [self.view.problem.machine.candidates[self.listed[i].candidate] for i in which]
        typicals = _typicals(candidates)
        most = np.array([max(np.abs(_range(c))) for c in candidates]) / typicals
        least = np.minimum(VISIBLE / np.maximum(shows, 1e-12), most)
        sd = np.minimum(max(VISIBLE, np.sqrt(excess)) / np.maximum(shows, 1e-12), most)
        scale = np.concatenate((sd, np.ones(len(self.ground.group))))
        odds = log_odds(self.view.problem.machine)[[self.listed[i].candidate for i in which]]
        names = [c.name for c in candidates]
        forms = [names[: len(self.listed)].count(n) for n in names]
        sets = Sets(
            reduced=Reduced(reduced.G * np.outer(scale, scale), reduced.b * scale, reduced.log),
            group=self.ground.group,
            prior=odds - np.log(forms),
            bounded=np.array([one_way(c) for c in candidates]),
            family=np.array([c.family for c in candidates]),
            usable=kept > PARAMETER,
            s=self.ground.s,
            since=np.array(since),
            late=0.0 if self._beside else late_odds(self.view.problem.tracks),  # those beside begin then already
            beside=self._beside,
            candidates=len(self.view.problem.machine.candidates),
        )
        return Picture(
            tuple(self.listed[i] for i in which),
            np.array(since),
            tuple(candidates),
            odds,
            sd * typicals,
            least * typicals,
            products,
            sets,
            -0.5 * q,
            excess,
        )

    def cosines(self, size: float) -> Array:
        """(V,) squared cosines of each listed column with the effect that was taken out, the unknowns apart.

        Where a size can have one sign only, a column that would need the other is none. The effect itself, which is
        listed first, is like itself however it is shaped.

        Args:
            size: of that effect, from its absence, in its first parameter's unit: its sign counts.
        """
        n, v = len(self._mean), len(self.listed)
        reduced = eliminated(self._without, np.zeros(len(self._without)), np.arange(n), self._mean, np.ones(n)).G
        squares = np.maximum(np.diag(reduced), 1e-150)  # so that no product of two is nothing
        ends = np.array([_range(self.view.problem.machine.candidates[one.candidate]) for one in self.listed])
        upwards = reduced[:v, v] * np.sign(size) > 0.0
        itself = np.array([one.candidate == self.listed[0].candidate for one in self.listed])
        can = itself | np.where(upwards, ends[:, 1] > 0.0, ends[:, 0] < 0.0)
        return np.where(can, reduced[:v, v] ** 2 / (squares[:v] * squares[v]), 0.0)

    def start(self, shown: Picture, key: Sequence[int], s: Array) -> tuple[Array, Array]:
        """Where the view's unknowns go beside some variants, and these themselves: all move together.

        Args:
            shown: a picture of this painter.
            key: positions of the variants in it.
            s: (P,) discrepancy to begin with, per cent.

        Returns:
            The unknowns (K,), each in its own unit; sizes (k,) from absence, each in its first parameter's unit.
        """
        n, some, view = len(self._mean), list(key), self.view
        bounds, z, left, typicals = Bounds.of(view.problem), view.z.copy(), self._left, _typicals(shown.candidates)
        sd = shown.units[some]
        others = n + np.setdiff1d(np.arange(len(shown.variants)), some)
        products = shown.products.less(others, [], np.empty(0)).scaled(np.arange(n, n + len(some)), sd / typicals[some])
        # What wanders, if anything does, stands between the unknowns and the sizes.
        ends = np.array([[size / u for size in _range(shown.candidates[k])] for k, u in zip(some, sd, strict=True)])
        free = np.full(n - len(left), np.inf)
        low, high = (side[left] for side in bounds.around(z))
        low, high = np.concatenate((low, -free, ends[:, 0])), np.concatenate((high, free, ends[:, 1]))
        mean = np.concatenate((self._mean, np.zeros(len(some))))
        step = posterior(products, mean, self.ground, s, low, high).step
        z[left] += step[: len(left)] * bounds.scale[left]
        return z, step[n:] * sd

    def _multiplied(self, columns: Callable[[int], Array]) -> Products:
        """Products of the unknowns' columns, then of variants', which may be made when it is a recording's turn."""
        return self.ground.products_of(self.view, lambda r: np.concatenate((self._own[r], columns(r)), axis=2))

    def _shows(self, products: Products) -> tuple[Array, Reduced, Array, float, float]:
        """How strongly each column shows beside the unknowns, in noise sds (V,); the form without the unknowns.

        Then the share of its square that each column keeps, (V,); the mean square, less one, that is left; and the
        sum of squares of the residuals.
        """
        n = len(self._mean)
        v = products.own.shape[1] - 1 - n
        G, b, q = products.over()
        reduced = eliminated(G, b, np.arange(n), self._mean, np.ones(n))
        kept = np.maximum(np.diag(reduced.G)[:v], 0.0)
        fitted = b[:n] @ np.linalg.solve(G[:n, :n] + np.eye(n), b[:n])
        share = kept / np.maximum(np.diag(G)[n : n + v], 1e-300)
        return np.sqrt(kept / self.readings), reduced, share, max(0.0, float(q - fitted) / self.readings - 1.0), q


def one_way(candidate: Candidate) -> bool:
    """Can its size have one sign only?"""
    v = candidate.mechanism.parameters[0]
    return bool(v.low >= candidate.null[0] or v.high <= candidate.null[0])


def _typicals(candidates: Sequence[Candidate]) -> Array:
    """(C,) how large each typically is, in its first parameter's unit."""
    return np.array([abs(typical(c)) for c in candidates])


def _range(candidate: Candidate) -> tuple[float, float]:
    """Between what its size may be, from absence, in its first parameter's unit."""
    v, null = candidate.mechanism.parameters[0], float(candidate.null[0])
    return min(v.low - null, 0.0), max(v.high - null, 0.0)
