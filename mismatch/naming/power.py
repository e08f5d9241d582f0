"""Which effects would have been named, and at which size, had they been there: simulated on the matrices at hand."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.linalg import solve_triangular

from twinbench.mismatch.naming.answer import PLAIN, SAME
from twinbench.mismatch.naming.decision import CREDIBLE
from twinbench.mismatch.naming.marginal import DISCREPANCY_PCT, UNTOLD, one_sided
from twinbench.mismatch.naming.picture import Picture
from twinbench.mismatch.naming.sets import Sets
from twinbench.mismatch.seed import ENGINE_SEED
from twinbench.physics.simulator import Array

SHOWN = (0.1, 0.3, 1.0, 3.0)
"""Sizes of the table: how strongly an effect shows beside the unknowns, in noise sds."""
WANTED = 0.9
"""Probability of being named that a size is stated for."""
LEAST_SHOWN, MOST_SHOWN = 0.003, 10.0
"""Sizes between which that one is looked for, in noise sds: below, no recording shows it; above, no column holds."""
SIMULATED = 100
"""Draws of readings: a probability of .9 is known to 3 points."""
CLOSE = 1.2
"""Factor to which that size is found; so many draws know it no better."""
LIKE = 0.05
"""Squared cosine with an effect below which another is no rival of it: that gets a twentieth of its evidence."""
RAISED = (0.1, 0.2, 0.4, 0.8)
"""Sizes that the discrepancy at a port may grow to, to explain an effect instead: per cent, up to its prior's sd."""


@dataclass(frozen=True)
class Power:
    """How large an effect has to be to be named.

    Attributes:
        alike: other names for the same thing: if there are any, it is named together with them and never alone.
        size_90: from absence, in the unit: the size named with probability .9; None if none that it may have is.
        shows_90: the same, in noise sds.
        probabilities: of being named where it shows as ``SHOWN``; NaN at sizes that it cannot have.
    """

    name: str
    unit: str
    alike: tuple[str, ...]
    size_90: float | None
    shows_90: float | None
    probabilities: tuple[float, ...]


def power(shown: Picture, rows: int, s: Array) -> tuple[Power, ...]:
    """One for each candidate in a picture, by name, in the shape that the readings speak for most.

    Args:
        shown: around the chosen hypothesis, which is among its unknowns. Effects that begin late do not count.
        rows: readings that it is of.
        s: (P,) size of the discrepancy beside that hypothesis, per cent.
    """
    always = np.flatnonzero(shown.since == -np.inf)
    gains = shown.sets.quick((), s)
    best = shown.firsts(always[np.argsort(-gains[always], kind="stable")])
    usable = [int(i) for i in always if shown.sets.usable[i]]
    draws = Draws(shown.sets, usable, [shown.names[i] for i in usable], s)
    return tuple(_power(shown, draws, i, rows) for i in sorted(best, key=lambda i: shown.names[i]))


def _power(shown: Picture, draws: Draws, i: int, rows: int) -> Power:
    candidate, sd = shown.candidates[i], float(shown.units[i])
    first = candidate.mechanism.parameters[0]
    if i not in draws.usable:
        return Power(candidate.name, first.unit, (), None, None, (0.0,) * len(SHOWN))
    place = draws.usable.index(i)
    per_sd = float(np.sqrt(shown.sets.reduced.G[i, i] / rows))
    most = min(MOST_SHOWN, per_sd / sd * float(max(abs(v - candidate.null[0]) for v in (first.low, first.high))))

    def named(level: float) -> float:
        return draws.named(place, level / per_sd)

    found = [named(level) if level <= most else np.nan for level in SHOWN]
    tried = [(LEAST_SHOWN, 0.0), *((v, p) for v, p in zip(SHOWN, found, strict=True) if v <= most)]
    if max(p for _, p in tried) < WANTED:
        tried.append((most, named(most)))
    shows = None
    enough = next((k for k, (_, p) in enumerate(tried) if p >= WANTED), 0)
    if enough:
        low, shows = tried[enough - 1][0], tried[enough][0]
        while shows > CLOSE * low:
            middle = float(np.sqrt(low * shows))
            low, shows = (low, middle) if named(middle) >= WANTED else (middle, shows)
    size = None if shows is None else shows / per_sd * sd
    return Power(candidate.name, first.unit, draws.alike(place), size, shows, tuple(found))


class _Beside(NamedTuple):
    """D draws with the discrepancy of one size integrated out.

    Attributes:
        C: (V, V) products of the effects' columns, in their prior sds.
        right: (D, V) of them with the readings.
        white: (D,) square of what the readings show of the discrepancy, ``lean`` (D, V) its product with what a
            column shows of it, ``own`` (V,) the square of that.
        log: evidence of nothing, less what the readings contribute, nats.
    """

    C: Array
    right: Array
    white: Array
    lean: Array
    own: Array
    log: float

    def nothing(self, i: int, size: float) -> Array:
        """(D,) evidence of nothing where effect i has a size, in prior sds."""
        return self.log + 0.5 * (self.white + 2.0 * size * self.lean[:, i] + size**2 * self.own[i])

    def gains(self, i: int, size: float, widened: float, some: np.ndarray, bounded: np.ndarray) -> Array:
        """(D, W) evidence over that of some effects (W,), those bounded (W,) of one sign, with wider priors."""
        right = self.right[:, some] + size * self.C[i, some]
        variance = 1.0 / (self.C[some, some] + widened**-2.0)
        mean = variance * right
        found = 0.5 * (mean * right + np.log(variance) - 2.0 * np.log(widened))
        found[:, bounded] += one_sided(mean[:, bounded], np.sqrt(variance[bounded]), bounded[bounded])
        return found


class Draws:
    """Readings as they would be with nothing beside the unknowns but noise and discrepancy, and what they speak for.

    Args:
        sets: effects in one view.
        usable: positions in them of the V effects that can be named.
        names: theirs; one name may have several shapes.
        s: (P,) size of the discrepancy, per cent.
    """

    def __init__(self, sets: Sets, usable: Sequence[int], names: Sequence[str], s: Array) -> None:
        order = np.argsort(names, kind="stable")
        self.usable = [usable[k] for k in order]
        self.names = np.unique([names[k] for k in order])
        self._of = np.searchsorted(self.names, [names[k] for k in order])
        self._prior, self._bounded = sets.prior[self.usable], sets.bounded[self.usable]
        v, functions = len(self.usable), sets.many + np.arange(len(sets.group))
        some = np.array([*self.usable, *functions], dtype=int)
        G, rng = sets.reduced.G[np.ix_(some, some)], np.random.default_rng(ENGINE_SEED)
        values, vectors = np.linalg.eigh(G)
        seen = rng.normal(size=(SIMULATED, len(G))) @ (vectors * np.sqrt(np.maximum(values, 0.0))).T
        seen += (rng.normal(size=(SIMULATED, len(G) - v)) * s[sets.group]) @ G[v:]
        self._unexplained = G[:v, :v]
        raised = [np.where(np.arange(len(s)) == p, to, s) for p in range(len(s)) for to in RAISED if to > s[p]]
        self._beside = [_beside(G, seen, sets.group, each) for each in (s, *raised)]

    def alike(self, i: int) -> tuple[str, ...]:
        """Other names of what effect i does."""
        G = self._unexplained
        same = G[i] ** 2 > SAME * np.diag(G) * G[i, i]
        same &= (G[i] > 0.0) | ~(self._bounded & self._bounded[i])
        return tuple(str(n) for n in self.names[np.unique(self._of[same])] if n != self.names[self._of[i]])

    def named(self, i: int, size: float) -> float:
        """Share of draws in which effect i, of a size in prior sds, is named, alone or together with what is alike."""
        first, *raised = self._beside
        instead = max(raised, key=lambda b: float(b.nothing(i, size).mean()), default=first)
        norms = np.sqrt(np.diag(self._unexplained))
        widened = max(1.0, size * norms[i] / norms.max())  # a prior reaches to what there is to explain
        squares = np.diag(first.C)
        some = np.flatnonzero(first.C[i] ** 2 >= LIKE * squares[i] * squares)
        bounded, both = self._bounded[some], (first, instead)
        nothing = [b.nothing(i, size) for b in both]
        logs = [n[:, None] + b.gains(i, size, widened, some, bounded) for n, b in zip(nothing, both, strict=True)]
        names, starts = np.unique(self._of[some], return_index=True)
        each = np.maximum.reduceat(np.maximum(*logs) + self._prior[some], starts, axis=1)
        mine = np.isin(self.names[names], [self.names[self._of[i]], *self.alike(i)])
        weights = np.exp(each - each.max(axis=1, keepdims=True))
        sure = weights[:, mine].sum(axis=1) >= CREDIBLE * weights.sum(axis=1)
        return float(np.mean(sure & (each[:, mine].max(axis=1) - np.maximum(*nothing) > PLAIN)))


def _beside(G: Array, seen: Array, group: np.ndarray, s: Array) -> _Beside:
    """The discrepancy of sizes s (P,) integrated out of V + F columns and the draws (D, V + F) of their products."""
    v = len(G) - len(group)
    telling = np.flatnonzero(s[group] ** 2 * np.diag(G)[v:] > UNTOLD)
    at, d = v + telling, s[group[telling]]
    L = np.linalg.cholesky(np.eye(len(at)) + d[:, None] * G[np.ix_(at, at)] * d)
    lean = solve_triangular(L, d[:, None] * G[at, :v], lower=True)
    white = solve_triangular(L, d[:, None] * seen[:, at].T, lower=True).T
    log = -float(np.log(np.diag(L)).sum()) - 0.5 * float(np.sum((s / DISCREPANCY_PCT) ** 2))
    both = white @ lean
    squares, own = np.sum(white**2, axis=1), np.sum(lean**2, axis=0)
    return _Beside(G[:v, :v] - lean.T @ lean, seen[:, :v] - both, squares, both, own, log)
