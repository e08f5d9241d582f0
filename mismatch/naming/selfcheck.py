"""Does an answer hold on the user's own case? All of it is linear algebra around the hypothesis that was chosen."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import maximum_bipartite_matching

from twinbench.mismatch.naming.answer import PLAIN, Answer
from twinbench.mismatch.naming.decision import CREDIBLE
from twinbench.mismatch.naming.effect import Effect
from twinbench.mismatch.naming.ground import Ground
from twinbench.mismatch.naming.marginal import DISCREPANCY_PCT, LEAST_TRIED_PCT, UNTOLD, Reduced, eliminated, one_sided
from twinbench.mismatch.naming.name import SINGLES
from twinbench.mismatch.naming.odds import of_number, one_more
from twinbench.mismatch.naming.picture import LEAST_PROBE, Painter, Picture, one_way
from twinbench.mismatch.naming.power import Power, power
from twinbench.mismatch.naming.sets import PARAMETER, Key, Sets
from twinbench.mismatch.naming.settle import HOPELESS, Settled
from twinbench.mismatch.naming.view import View, prior_mean
from twinbench.mismatch.proof import RESAMPLED_PIECES
from twinbench.mismatch.seed import ENGINE_SEED
from twinbench.mismatch.variants import Variant, typical
from twinbench.mismatch.words import count
from twinbench.physics.simulator import Array

DECOYS = 20
"""Things that are certainly not there: one that is named stands for a rate of false names of 5 %."""
ALIEN = 0.5
"""Squared cosine with what may be there from which a shifted column is no decoy."""
SPLITS = 5
"""Times that the recordings are parted in two halves, each recording in pieces of time."""
GROWN = 3.0
"""Times that the discrepancy may be larger than it is beside the answer, or beside nothing."""
BLURRED = 10.0
"""Nats by which a hypothesis may be likelier where it stands than it looks from the answer, or less likely: farther
off, what it says of single pieces is not known."""


@dataclass(frozen=True)
class SelfCheck:
    """What an answer is worth on the recordings that it comes from.

    Attributes:
        decoys_named: how many of ``decoys`` effects at the wrong time would have been named.
        named_again: in how many of ``halves`` halves of the recordings the same is the likeliest.
        each_again: for each finding, in how many of them one of its names is in the likeliest set.
        power: for each candidate that is not named, the size at which it would have been.
    """

    decoys_named: int
    decoys: int
    named_again: int
    each_again: tuple[int, ...]
    halves: int
    power: tuple[Power, ...]

    @property
    def again(self) -> tuple[float, ...]:
        """For each finding, share of the halves in which one of its names is in the likeliest set."""
        return tuple(times / self.halves for times in self.each_again)

    @property
    def says(self) -> tuple[str, str]:
        """One sentence each."""
        named = count(self.decoys_named) if self.decoys_named else "none"
        decoys = f"Of {self.decoys} effects that are certainly not there, {named} would be named"
        decoys += ": the noise or the discrepancy is not right here." if self.decoys_named else "."
        again = f"The same is the likeliest in {self.named_again} of {self.halves} halves of the recordings."
        return decoys, again


class Rival(NamedTuple):
    """A hypothesis among columns.

    Attributes:
        names: of its effects; ``key``, the positions of their columns.
        s: (P,) the discrepancy beside it, per cent.
        log: its evidence at its own fixed point, nats; NaN if it was never brought there.
    """

    names: tuple[str, ...]
    key: Key
    s: Array
    log: float


def checked(answer: Answer) -> SelfCheck:
    """The decoys, the halves and the sizes of an answer; the same whenever it is asked."""
    naming, chosen, rng = answer.naming, answer.chosen, np.random.default_rng(ENGINE_SEED)
    view, others = naming.around(chosen), naming.beside(chosen.problem.machine, chosen.candidates)
    shown = Painter(view, naming.ground, others, probes=naming.painter.probes).picture()
    columns = Columns(view, chosen)
    effects = [columns.of_effect(i) for i in range(len(chosen.effects))]
    # By chance what is hopeless on all pieces is ahead on half of them once in ten thousand halves.
    several = [chosen, *(h for h in naming.hypotheses if h is not chosen and h.log > chosen.log - HOPELESS)]
    rivals = [*columns.of_hypotheses(several, effects), *columns.of_more(shown, effects)]
    tried = columns.of_decoys(shown, naming.painter.probes, rng)
    pieces = Pieces.of(columns, naming.ground)
    sets = pieces.sets()
    decoys = unlike(sets, tried)
    said = [{*f.credible(CREDIBLE), *f.alike} for f in answer.found]
    ahead = nearer(pieces, rivals)
    best = [likeliest(pieces, rivals, half, ahead) for half in pieces.halves(rng)]
    rows = sum(int(np.isfinite(r).sum()) for r in view.residuals)
    return SelfCheck(
        decoys_named=len(named_decoys(sets, effects, decoys, one_more(len(effects), pieces.candidates))),
        decoys=len(decoys),
        named_again=sum(is_said(names, said) for names in best),
        each_again=tuple(sum(not some.isdisjoint(names) for names in best) for some in said),
        halves=len(best),
        power=power(shown, rows, chosen.learnt.s),
    )


class Columns:
    """Columns that sets are made of, in prior sds, around a hypothesis less its effects.

    Attributes:
        prior, bounded: of V columns, as of ``Sets``.
        mean: (N,) prior mean of the unknowns that are no effect's, from where they stand, in prior sds.
        residuals: (B, ny) per recording, in the outputs' units, as if the effects were absent.
    """

    def __init__(self, view: View, chosen: Settled) -> None:
        self.view, self.chosen = view, chosen
        self.prior: list[float] = []
        self.bounded: list[bool] = []
        self._means = prior_mean(view)
        self.mean = self._means[: chosen.first]
        self.residuals = [r.copy() for r in view.residuals]
        self._unknowns = view.unknowns()
        self._parts = [[u[:, :, : chosen.first]] for u in self._unknowns]

    def of(self, r: int) -> Array:
        """(B, ny, N + V) of a recording, in the outputs' units: unknowns first."""
        return np.concatenate(self._parts[r], axis=2)

    def of_effect(self, i: int) -> Key:
        """An effect of the hypothesis: its size, and what shapes it comes with it."""
        effect, at = self.chosen.effects[i], self.chosen.entries(i)
        shapes = len(at) - 1
        turn = np.array([np.sign(self.chosen.sizes[i]) or 1.0] + [1.0] * shapes)
        for residual, u in zip(self.residuals, self._unknowns, strict=True):
            residual -= u[:, :, at[0]] * self._means[at[0]]
        one = one_way(self.chosen.problem.machine.candidates[effect.variant.candidate])
        columns = [u[:, :, at] * turn for u in self._unknowns]
        return self._add(columns, [effect.prior] + [0.0] * shapes, [one] + [False] * shapes)

    def of_hypotheses(self, several: Sequence[Settled], own: Sequence[Key]) -> list[Rival]:
        """What each hypothesis is made of: its effects, each as it stands there.

        Args:
            own: positions of the chosen hypothesis's effects.
        """
        since_s = self.chosen.since_s
        known = {(e.variant.candidate, since_s): key for e, key in zip(self.chosen.effects, own, strict=True)}
        new: dict[tuple[Variant, float], Effect] = {}
        for h in several:
            new |= {(e.variant, h.since_s): e for e in h.now if (e.variant.candidate, h.since_s) not in known}
        made: dict[tuple[Variant, float], Key] = {}
        for late in {since for _, since in new}:
            effects = [e for (_, since), e in new.items() if since == late]
            made |= {(e.variant, late): (k,) for e, k in zip(effects, self._of(effects, late), strict=True)}
        found = []
        for h in several:
            parts = [known.get((e.variant.candidate, h.since_s)) or made[e.variant, h.since_s] for e in h.now]
            found.append(Rival(h.names, _joined(parts), h.learnt.s, h.log))
        return found

    def of_more(self, shown: Picture, own: Sequence[Key]) -> list[Rival]:
        """The chosen hypothesis with one effect more: those of a picture around it that add most."""
        gains = shown.sets.quick((), self.chosen.learnt.s)
        order = np.argsort(-gains)
        best = shown.firsts(order[np.isfinite(gains[order]) & (shown.since[order] == -np.inf)])[:SINGLES]
        keys, s = self._of(shown.effects(best, shown.units[best]), -np.inf), self.chosen.learnt.s
        beside = zip(best, keys, strict=True)
        return [Rival((*self.chosen.names, shown.names[i]), _joined([*own, (k,)]), s, np.nan) for i, k in beside]

    def of_decoys(self, shown: Picture, probes: Mapping[Variant, float], rng: np.random.Generator) -> Key:
        """Twice as many as are wanted: columns of candidates, moved on by a quarter to three quarters of a recording.

        What leaves it at its end comes in at its beginning.

        Args:
            probes: share of its typical size that each variant is tried with.
        """
        there = np.flatnonzero(shown.sets.usable & (shown.since == -np.inf))
        if not len(there):
            return ()
        some = np.resize(rng.permutation(there), 2 * DECOYS)
        variants = [shown.variants[i] for i in some]
        units = shown.units[some] / [abs(typical(shown.candidates[i])) for i in some]
        columns = self.view.of_variants(variants, np.array([probes[v] for v in variants]))
        moved = []
        for c in columns:
            shifts = (rng.uniform(0.25, 0.75, len(some)) * len(c)).astype(int)
            moved.append(np.stack([np.roll(c[:, :, k], s, axis=0) * units[k] for k, s in enumerate(shifts)], axis=2))
        return self._add(moved, shown.sets.prior[some], shown.sets.bounded[some])

    def _of(self, effects: Sequence[Effect], since_s: float) -> Key:
        """Effects that are absent here, one column each, from a time on."""
        if not effects:
            return ()
        candidates = [self.chosen.problem.machine.candidates[e.variant.candidate] for e in effects]
        plain = np.array([abs(typical(c)) for c in candidates])
        probes = np.maximum(np.abs([e.size for e in effects]) / plain, LEAST_PROBE)
        times = [since_s] if since_s > -np.inf else []
        columns = self.view.of_variants([e.variant for e in effects], probes, times)
        units, step = np.array([e.sd for e in effects]) / plain, 1 + len(times)
        last = [c[:, :, step - 1 :: step] * units for c in columns]
        return self._add(last, [e.prior for e in effects], [one_way(c) for c in candidates])

    def _add(self, columns: Sequence[Array], prior: Iterable[float], bounded: Iterable[bool]) -> Key:
        first = len(self.prior)
        for parts, c in zip(self._parts, columns, strict=True):
            parts.append(c)
        self.prior += map(float, prior)
        self.bounded += map(bool, bounded)
        return tuple(range(first, len(self.prior)))


@dataclass(frozen=True)
class Pieces:
    """Products of whitened columns, per recording and piece of time.

    Attributes:
        products: (R, P, K, K) of whitened columns: of N unknowns, of V that sets are made of, of F functions of the
            discrepancy, and of residuals.
        mean: (N,) prior mean of the unknowns, standardised: in prior sds.
        prior: (V,) log prior odds of each column, dimensionless.
        bounded: (V,) bool, can its size have one sign only?
        group: (F,) positions of each function's port.
        s: (P,) the discrepancy beside the chosen hypothesis, per cent.
        candidates: how many the machine has.
    """

    products: Array
    mean: Array
    prior: Array
    bounded: np.ndarray
    group: np.ndarray
    s: Array
    candidates: int

    @classmethod
    def of(cls, columns: Columns, ground: Ground) -> Pieces:
        """Whiten, and multiply piece by piece; functions of which nothing shows are left out."""
        s = columns.chosen.learnt.s
        largest = GROWN * np.maximum(s, ground.s)[ground.group]
        telling = largest**2 * np.diag(ground.FF.sum(axis=0))
        some = np.flatnonzero(telling >= min(UNTOLD, telling.max(initial=0.0)))
        products = []
        for r, residual in enumerate(columns.residuals):
            white = ground.whitened(r, columns.of(r), residual)
            white = np.concatenate((white[:, :-1], ground.white[r][:, some], white[:, -1:]), axis=1)
            products.append([part.T @ part for part in np.array_split(white, RESAMPLED_PIECES)])
        prior, bounded = np.array(columns.prior), np.array(columns.bounded, dtype=bool)
        many = len(columns.view.problem.machine.candidates)
        return cls(np.array(products), columns.mean, prior, bounded, ground.group[some], s, many)

    def _reduced(self, G: Array) -> Reduced:
        n = len(self.mean)
        return eliminated(G[:-1, :-1], G[:-1, -1], np.arange(n), self.mean, np.ones(n))

    def sets(self) -> Sets:
        """Evidence on all of them, the discrepancy's size to be learnt."""
        G, n, v = self.products.sum(axis=(0, 1)), len(self.mean), len(self.prior)
        reduced, always = self._reduced(G), np.full(v, -np.inf)
        usable = np.diag(reduced.G)[:v] > PARAMETER * np.diag(G)[n : n + v]
        return Sets(reduced, self.group, self.prior, self.bounded, np.arange(v), usable, self.s, always)

    def halves(self, rng: np.random.Generator) -> Iterator[np.ndarray]:
        """Halves (R, P) bool: half of each recording's pieces, then the other half."""
        for _ in range(SPLITS):
            first = np.array([rng.permutation(RESAMPLED_PIECES) < RESAMPLED_PIECES // 2 for _ in self.products])
            yield first
            yield ~first

    def logs(self, which: np.ndarray, rivals: Sequence[Rival]) -> Array:
        """(K,) evidence of each on some pieces, nats; the discrepancy as large as on all of them.

        Args:
            which: (R, P) bool, the pieces.
        """
        reduced = self._reduced(self.products[which].sum(axis=0))
        return np.array([self._log(reduced, r) for r in rivals])

    def _log(self, reduced: Reduced, rival: Rival) -> float:
        key, v = list(rival.key), len(self.prior)
        precision = 1.0 / np.maximum(rival.s[self.group], LEAST_TRIED_PCT) ** 2
        telling = np.flatnonzero(np.diag(reduced.G)[v:] > UNTOLD * precision)
        some, k = np.array([*key, *(v + telling)], dtype=int), len(key)
        G, b = reduced.G[np.ix_(some, some)], reduced.b[some]
        beside = eliminated(G, b, k + np.arange(len(telling)), np.zeros(len(telling)), precision[telling])
        cov = np.linalg.inv(beside.G + np.eye(k))
        mean = cov @ beside.b
        log = beside.log - 0.5 * float(np.sum((rival.s / DISCREPANCY_PCT) ** 2)) + float(self.prior[key].sum())
        log += of_number(len(rival.names), self.candidates)
        log += 0.5 * float(beside.b @ mean) + 0.5 * float(np.linalg.slogdet(cov)[1])
        return log + float(one_sided(mean, np.sqrt(np.diag(cov)), self.bounded[key]).sum())


def unlike(sets: Sets, tried: Key) -> Key:
    """Columns, the last of a view, that are no parameter and like nothing that may be there; as many as are wanted.

    A column of zeros is none of them: nothing that recordings cannot show is ever named.
    """
    at, known = np.array(tried, dtype=int), np.arange(sets.many - len(tried))
    squares = np.diag(sets.reduced.G)
    room = np.maximum(squares, 1e-150)  # a product of two of them is no zero
    like = sets.reduced.G[np.ix_(at, known)] ** 2 / np.outer(room[at], room[known])
    alien = sets.usable[at] & (squares[at] > 0.0) & (like.max(axis=1, initial=0.0) < ALIEN)
    return tuple(int(d) for d in at[alien][:DECOYS])


def named_decoys(sets: Sets, effects: Sequence[Key], decoys: Key, another: float = 0.0) -> set[int]:
    """Decoys that would be named beside the effects, or in the place of one.

    Args:
        another: log odds of one effect more, beside that effect's own.
    """
    best, found = sets.score(_joined(effects)), set()
    for out in (None, *range(len(effects))):
        rest = sets.score(_joined(key for i, key in enumerate(effects) if i != out))
        wanted = best.log + (PLAIN - another if out is None else 0.0)
        gains = sets.gains(rest)
        near = [d for d in decoys if rest.log + gains[d] > wanted - PLAIN]
        found |= {d for d in near if sets.score((*rest.key, d)).log > wanted}
    return found


def nearer(pieces: Pieces, rivals: Sequence[Rival]) -> Array:
    """(K,) nats by which each is likelier at its own fixed point than it looks from the first's.

    One that was never brought there counts as the first does.
    """
    every = np.ones(pieces.products.shape[:2], dtype=bool)
    found = np.array([r.log for r in rivals]) - pieces.logs(every, rivals)
    return np.where(np.isnan(found), found[0], found)


def likeliest(pieces: Pieces, rivals: Sequence[Rival], half: np.ndarray, ahead: Array) -> tuple[str, ...]:
    """Names of the likeliest hypothesis in a half.

    One with more effects than the first has to be twenty times likelier, as in the answer.

    Args:
        half: (R, P) bool.
        ahead: (K,) nats, dimensionless, that each is likelier than it looks, on all pieces; on half of them half as
            many.
    """
    logs = pieces.logs(half, rivals) + 0.5 * ahead
    logs -= PLAIN * np.array([len(r.names) > len(rivals[0].names) for r in rivals])
    logs[np.abs(ahead - ahead[0]) > BLURRED] = -np.inf
    return rivals[int(np.argmax(logs))].names


def is_said(names: tuple[str, ...], said: Sequence[set[str]]) -> bool:
    """Are these, one for one, among what was said of each effect?"""
    if len(names) != len(said):
        return False
    fits = csr_array(np.array([[n in some for some in said] for n in names]).reshape(len(names), len(said)))
    return bool((maximum_bipartite_matching(fits) >= 0).all())


def _joined(keys: Iterable[Key]) -> Key:
    return tuple(k for key in keys for k in key)
