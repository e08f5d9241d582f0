"""Does an answer hold on the user's own case? All of it is linear algebra around the hypothesis that was chosen."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import permutations

import numpy as np

from twinbench.mismatch.naming.answer import PLAIN, Answer, name_of
from twinbench.mismatch.naming.decision import CREDIBLE
from twinbench.mismatch.naming.ground import Ground
from twinbench.mismatch.naming.marginal import UNTOLD, eliminated
from twinbench.mismatch.naming.picture import LEAST_PROBE, Painter, Picture, one_way
from twinbench.mismatch.naming.power import RAISED, Power, power
from twinbench.mismatch.naming.sets import PARAMETER, Key, Sets
from twinbench.mismatch.naming.settle import Effect, Settled
from twinbench.mismatch.naming.view import View, scale_of
from twinbench.mismatch.picture import Variant, typical
from twinbench.mismatch.words import count
from twinbench.physics.simulator import Array

DECOYS = 20
"""Things that are certainly not there: one that is named stands for a rate of false names of 5 %."""
ALIEN = 0.5
"""Squared cosine with what may be there from which a shifted column is no decoy."""
SPLITS, HALVED_PIECES = 5, 8
"""Times that the recordings are parted in two halves, each recording in so many pieces of time."""


@dataclass(frozen=True)
class SelfCheck:
    """What an answer is worth on the recordings that it comes from.

    Attributes:
        decoys_named: how many of ``decoys`` effects at the wrong time would have been named.
        named_again: in how many of ``halves`` halves of the recordings the same is the likeliest.
        power: for each candidate that is not named, the size at which it would have been.
    """

    decoys_named: int
    decoys: int
    named_again: int
    halves: int
    power: tuple[Power, ...]

    @property
    def says(self) -> tuple[str, ...]:
        """One sentence each."""
        decoys = f"Of {self.decoys} effects that are certainly not there, {count(self.decoys_named)} would be named."
        if self.decoys_named:
            decoys = f"{decoys[:-1]}: the noise or the discrepancy is not right here."
        again = f"In {self.named_again} of {self.halves} halves of the recordings the same is the likeliest."
        return decoys, again, *(p.says for p in self.power)


def checked(answer: Answer) -> SelfCheck:
    """The decoys, the halves and the sizes of an answer; the same whenever it is asked."""
    naming, chosen, rng = answer.naming, answer.chosen, np.random.default_rng(0)
    candidates = chosen.problem.machine.candidates
    there = {candidates[e.variant.candidate].family for e in chosen.effects}
    others = [v for v in naming.painter.listed if candidates[v.candidate].family not in there]
    view = View.around(chosen.problem, chosen.z)
    shown = Painter(view, naming.ground, others, probes=naming.painter.probes).picture()
    columns = _Columns(view, chosen)
    effects = [columns.of_effect(i) for i in range(len(chosen.effects))]
    keys = columns.of_hypotheses(naming.hypotheses, effects)
    tried = columns.of_decoys(shown, naming.painter.probes, rng)
    pieces = _Pieces.of(columns, naming.ground)
    sets = pieces.sets()
    decoys = _decoys(sets, tried)
    named = sum(_is_named(sets, effects, d) for d in decoys)
    again = sum(_is_again(answer, pieces.sets(half), sets, keys) for half in pieces.halves(rng))
    rows = sum(int(np.isfinite(r).sum()) for r in view.residuals)
    return SelfCheck(named, len(decoys), again, 2 * SPLITS, power(shown, rows, chosen.learnt.s))


class _Columns:
    """Columns (B, ny, V) per recording that sets are made of, in prior sds, around a hypothesis less its effects.

    Attributes:
        prior, bounded: (V,) as of ``Sets``.
        residuals: (B, ny) per recording, as if the effects were absent.
    """

    def __init__(self, view: View, chosen: Settled) -> None:
        self.view, self.chosen = view, chosen
        self._whole = view.unknowns()
        self.unknowns = [w[:, :, : chosen.first] for w in self._whole]
        self._parts: list[list[Array]] = [[] for _ in view.courses]
        self.prior: list[float] = []
        self.bounded: list[bool] = []
        self.residuals = [r.copy() for r in view.residuals]

    @property
    def mean(self) -> Array:
        """(N,) prior mean of the unknowns from where they stand, in prior sds."""
        some = zip(self.view.problem.unknowns, self.view.z, strict=True)
        return np.array([(u.mean - z) / scale_of(u) for u, z in some])

    def of(self, r: int) -> Array:
        """(B, ny, N + V) of a recording: unknowns first."""
        return np.concatenate((self.unknowns[r], *self._parts[r]), axis=2)

    def _add(self, columns: Sequence[Array], prior: Sequence[float], bounded: Sequence[bool]) -> Key:
        for part, c in zip(self._parts, columns, strict=True):
            part.append(c)
        self.prior += prior
        self.bounded += bounded
        return tuple(range(len(self.prior) - len(prior), len(self.prior)))

    def of_effect(self, i: int) -> Key:
        """An effect of the hypothesis: its size and, as they come with it, its shape parameters."""
        effect, at = self.chosen.effects[i], self.chosen.entries(i)
        sign, none = np.sign(self.chosen.sizes[i]) or 1.0, self.mean[at.start]
        for residual, w in zip(self.residuals, self._whole, strict=True):
            residual -= w[:, :, at.start] * none
        shapes = at.stop - at.start - 1
        candidate = self.chosen.problem.machine.candidates[effect.variant.candidate]
        turned = [w[:, :, at] * np.array([sign] + [1.0] * shapes) for w in self._whole]
        return self._add(turned, [effect.prior] + [0.0] * shapes, [one_way(candidate)] + [False] * shapes)

    def of_hypotheses(self, several: Sequence[Settled], own: Sequence[Key]) -> list[Key]:
        """What each hypothesis is made of: its effects, each as it stands there.

        Args:
            own: of the chosen hypothesis's effects.
        """
        chosen = zip(self.chosen.effects, own, strict=True)
        known = {(e.variant.candidate, self.chosen.since_s): key for e, key in chosen}
        made: dict[tuple[Variant, float], Key] = {}
        for h in several:
            for e in h.now:
                if (e.variant.candidate, h.since_s) not in known and (e.variant, h.since_s) not in made:
                    made[e.variant, h.since_s] = self._of_rival(e, h.since_s)
        found = []
        for h in several:
            whole = [known.get((e.variant.candidate, h.since_s)) or made[e.variant, h.since_s] for e in h.now]
            found.append(tuple(k for part in whole for k in part))
        return found

    def _of_rival(self, effect: Effect, since_s: float) -> Key:
        candidate = self.chosen.problem.machine.candidates[effect.variant.candidate]
        plain = abs(typical(candidate))
        times = [since_s] if since_s > -np.inf else []
        columns = self.view.of_variants([effect.variant], np.array([max(abs(effect.size) / plain, LEAST_PROBE)]), times)
        last = [c[:, :, -1:] * effect.sd / plain for c in columns]
        return self._add(last, [effect.prior], [one_way(candidate)])

    def of_decoys(self, shown: Picture, probes: Mapping[Variant, float], rng: np.random.Generator) -> Key:
        """Twice as many as are wanted: columns of candidates, each moved on by a quarter to three quarters of its time.

        What leaves a recording at its end comes in at its beginning.
        """
        there = np.flatnonzero(shown.sets.usable & (shown.since == -np.inf))
        if not len(there):
            return ()
        some = np.resize(rng.permutation(there), 2 * DECOYS)
        variants = [shown.variants[i] for i in some]
        typicals = np.array([abs(typical(shown.candidates[i])) for i in some])
        columns = self.view.of_variants(variants, np.array([probes[v] for v in variants]))
        moved = [np.empty_like(c) for c in columns]
        for out, c in zip(moved, columns, strict=True):
            for k, shift in enumerate(rng.uniform(0.25, 0.75, len(some))):
                out[:, :, k] = np.roll(c[:, :, k], int(shift * len(c)), axis=0) * shown.units[some[k]] / typicals[k]
        prior = [float(p) for p in shown.sets.prior[some]]
        return self._add(moved, prior, [bool(b) for b in shown.sets.bounded[some]])


@dataclass(frozen=True)
class _Pieces:
    """Products of whitened columns, per recording and piece of time.

    Attributes:
        products: (R, P, K, K) of the N unknowns, V columns that sets are made of, F functions of the discrepancy, and
            residuals.
        mean: (N,) prior mean of the unknowns.
        prior, bounded: (V,) as of ``Sets``.
        group, s: (F,) and (P,) of the discrepancy beside the hypothesis.
    """

    products: Array
    mean: Array
    prior: Array
    bounded: np.ndarray
    group: np.ndarray
    s: Array

    @classmethod
    def of(cls, columns: _Columns, ground: Ground) -> _Pieces:
        """Whiten, and multiply piece by piece; functions of which nothing shows are left out."""
        s = columns.chosen.learnt.s
        largest = RAISED * np.maximum(s, ground.s)[ground.group]
        some = np.flatnonzero(largest**2 * np.diag(ground.FF.sum(axis=0)) > UNTOLD)
        products = []
        for r, residual in enumerate(columns.residuals):
            white = ground.whitened(r, columns.of(r), residual)
            white = np.concatenate((white[:, :-1], ground.white[r][:, some], white[:, -1:]), axis=1)
            products.append([part.T @ part for part in np.array_split(white, HALVED_PIECES)])
        mean = columns.mean[: columns.chosen.first]
        prior, bounded = np.array(columns.prior), np.array(columns.bounded, dtype=bool)
        return cls(np.array(products), mean, prior, bounded, ground.group[some], s)

    def sets(self, which: np.ndarray | None = None) -> Sets:
        """Evidence on some pieces, (R, P) bool, or on all."""
        G = self.products.sum(axis=(0, 1)) if which is None else self.products[which].sum(axis=0)
        n, v = len(self.mean), len(self.prior)
        reduced = eliminated(G[:-1, :-1], G[:-1, -1], np.arange(n), self.mean, np.ones(n))
        usable = np.diag(reduced.G)[:v] > PARAMETER * np.diag(G)[n : n + v]
        always = np.full(v, -np.inf)
        return Sets(reduced, self.group, self.prior, self.bounded, np.arange(v), usable, self.s, always)

    def halves(self, rng: np.random.Generator) -> Iterator[np.ndarray]:
        """Halves (R, P) bool: half of each recording's pieces, then the other half."""
        for _ in range(SPLITS):
            first = np.array([rng.permutation(HALVED_PIECES) < HALVED_PIECES // 2 for _ in self.products])
            yield first
            yield ~first


def _decoys(sets: Sets, tried: Key) -> Key:
    """Those of the tried that are no parameter and like nothing that may be there."""
    known, squares = np.arange(len(sets.prior) - len(tried)), np.maximum(np.diag(sets.reduced.G), 1e-300)
    like = sets.reduced.G[np.ix_(tried, known)] ** 2 / np.outer(squares[list(tried)], squares[known])
    fit = [d for d, c in zip(tried, like, strict=True) if sets.usable[d] and c.max(initial=0.0) < ALIEN]
    return tuple(fit[:DECOYS])


def _is_named(sets: Sets, effects: Sequence[Key], decoy: int) -> bool:
    """Would it be named beside the effects, or in the place of one?"""
    key = [k for part in effects for k in part]
    best = sets.score(key).log
    if sets.score([*key, decoy]).log > best + PLAIN:
        return True
    return any(sets.score([*(k for k in key if k not in part), decoy]).log > best for part in effects)


def _is_again(answer: Answer, half: Sets, whole: Sets, keys: Sequence[Key]) -> bool:
    """Is what was said the likeliest of the known hypotheses in a half?

    A hypothesis at its own fixed point is likelier than it looks from here, and half as much so in a half. One of more
    effects has to be twenty times as likely.
    """
    machine, effects = answer.chosen.problem.machine, len(answer.chosen.effects)

    def log(h: Settled, key: Key) -> float:
        nearer = 0.5 * (h.log - whole.score(key).log)
        return half.score(key).log + nearer - PLAIN * (len(h.effects) > effects)

    hypotheses = answer.naming.hypotheses
    best, _ = max(zip(hypotheses, keys, strict=True), key=lambda pair: log(*pair))
    names = [name_of(machine, e) for e in best.effects]
    said = [{*f.credible(CREDIBLE), *f.alike} for f in answer.found]
    orders = permutations(names) if len(names) == len(said) else ()
    return any(all(n in some for n, some in zip(order, said, strict=True)) for order in orders)
