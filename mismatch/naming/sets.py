"""Evidence for sets of candidates in one view, and the search for the likeliest."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy.linalg import solve_triangular

from twinbench.mismatch.naming.marginal import LEAST_TRIED_PCT, Learnt, Reduced, eliminated, learn, one_sided
from twinbench.mismatch.naming.odds import of_number, one_more
from twinbench.mismatch.naming.settle import SETTLED
from twinbench.physics.simulator import Array

Key = tuple[int, ...]
MOST = 3
"""Effects of a set that one view shows at most: with each more the machine is farther from where it was linearised."""
BEAM, TRIED_FIRST, TRIED_LATER, OF_A_FAMILY = 5, 24, 10, 2
"""Sets of a size that the search goes on with; single effects that it tries, and effects beside each set, those of one
family so often at most."""
LEFT_SHARE = 0.15
"""Share of a discrepancy that is left beside an effect which explains most of it."""
PARAMETER = 3e-4
"""Share of its square that a column must keep beside the unknowns: below it is a parameter under another name."""


@dataclass(frozen=True)
class Scored:
    """A set in a view: its evidence, and the discrepancy beside it."""

    key: Key
    log: float
    learnt: Learnt


@dataclass
class Sets:
    """Columns of V candidates' variants and F functions, the unknowns integrated out.

    Attributes:
        reduced: over the V variants, in prior sds, then the F functions.
        group: (F,) positions of each function's port.
        prior: (V,) log prior odds of each variant, dimensionless.
        bounded: (V,) bool, can its size have one sign only?
        family: (V,) labels, which have no unit; one of a family is enough.
        usable: (V,) bool, is it more than a parameter?
        s: (P,) size of the discrepancy with nothing named, per cent.
        since: (V,) time from which it is there, s, on the recordings' clock; those of a set begin together.
        late: log prior odds of beginning at such a time; once per set.
        beside: so many effects are there anyway, of so many ``candidates``.
    """

    reduced: Reduced
    group: np.ndarray
    prior: Array
    bounded: np.ndarray
    family: np.ndarray
    usable: np.ndarray
    s: Array
    since: Array
    late: float = 0.0
    beside: int = 0
    candidates: int = 1
    known: dict[Key, Scored] = field(default_factory=dict)

    @property
    def many(self) -> int:
        """How many variants there are."""
        return len(self.prior)

    def score(self, key: Iterable[int]) -> Scored:
        """A set's evidence with the discrepancy learnt beside it; each is asked once."""
        key = tuple(sorted(int(i) for i in key))
        if key not in self.known:
            self.known[key] = self._score(key)
        return self.known[key]

    def _score(self, key: Key) -> Scored:
        k, functions = len(key), np.arange(len(self.group))
        some = np.array([*key, *(self.many + functions)], dtype=int)
        G, b = self.reduced.G[np.ix_(some, some)], self.reduced.b[some]
        if not k:
            learnt = learn(G, b, self.group, self.s, rounds=30)
            return Scored(key, learnt.log, learnt)
        inner = eliminated(G, b, np.arange(k), np.zeros(k), np.ones(k))
        learnt = learn(inner.G, inner.b, self.group, np.maximum(0.5 * self.s, LEAST_TRIED_PCT), rounds=8)
        log = inner.log + learnt.log + float(self.prior[list(key)].sum()) + self._odds(key)
        outer = eliminated(G, b, k + functions, np.zeros(len(functions)), 1.0 / learnt.s[self.group] ** 2)
        cov = np.linalg.inv(outer.G + np.eye(k))
        log += float(one_sided(cov @ outer.b, np.sqrt(np.diag(cov)), self.bounded[list(key)]).sum())
        return Scored(key, log, learnt)

    def _odds(self, key: Key) -> float:
        """Log prior odds of a set as a whole: when it begins, and how many it makes."""
        late = self.late if self.since[key[0]] > -np.inf else 0.0
        return late + of_number(self.beside + len(key), self.candidates) - of_number(self.beside, self.candidates)

    def quick(self, key: Key, s: Array) -> Array:
        """(V,) log evidence that each variant would add to a set, the discrepancy's size as it is.

        Args:
            s: (P,) this size at each port, per cent; ``LEAST_TRIED_PCT`` where it is less.
        """
        G, b, v = self.reduced.G, self.reduced.b, self.many
        block = np.array([*key, *(v + np.arange(len(self.group)))], dtype=int)
        precision = np.concatenate((np.ones(len(key)), 1.0 / np.maximum(s, LEAST_TRIED_PCT)[self.group] ** 2))
        A = G[np.ix_(block, block)] + np.diag(precision)
        scale = 1.0 / np.sqrt(np.diag(A))
        L = np.linalg.cholesky(A * np.outer(scale, scale) + 1e-10 * np.eye(len(A)))
        X = solve_triangular(L, scale[:, None] * np.column_stack((G[block, :v], b[block])), lower=True)
        g = np.maximum(np.diag(G)[:v] - np.sum(X[:, :v] ** 2, axis=0), 0.0)
        right = b[:v] - X[:, :v].T @ X[:, v]
        variance = 1.0 / (g + 1.0)
        mean = variance * right
        gain = 0.5 * np.log(variance) + 0.5 * mean * right + one_sided(mean, np.sqrt(variance), self.bounded)
        start = 0.0 if key else np.where(self.since > -np.inf, self.late, 0.0)
        another = one_more(self.beside + len(key), self.candidates)
        return np.where(self.usable, gain + self.prior + start + another, -np.inf)

    def gains(self, base: Scored) -> Array:
        """(V,) as ``quick`` beside a set, with its discrepancy as it is or as an effect would leave it, nats."""
        return np.maximum(*(self.quick(base.key, base.learnt.s * share) for share in (1.0, LEFT_SHARE)))

    def search(self, depth: int = MOST) -> Scored:
        """The likeliest set: all single ones, then a beam."""
        best = self.score(())
        beam: Sequence[Scored] = [best]
        for d in range(depth):
            fresh: dict[Key, Scored] = {}
            for base in beam:
                gains = self.gains(base)
                used = {self.family[i] for i in base.key}
                gains[[f in used for f in self.family]] = -np.inf
                if base.key:
                    gains[self.since != self.since[base.key[0]]] = -np.inf
                count: dict[object, int] = {}
                picked = 0
                for i in np.argsort(-gains):
                    if not np.isfinite(gains[i]) or picked == (TRIED_FIRST if d == 0 else TRIED_LATER):
                        break
                    if count.get(self.family[i], 0) < OF_A_FAMILY:
                        count[self.family[i]] = count.get(self.family[i], 0) + 1
                        scored = self.score((*base.key, int(i)))
                        fresh[scored.key] = scored
                        picked += 1
            beam = sorted(fresh.values(), key=lambda s: -s.log)[:BEAM]
            if not beam or beam[0].log < best.log + SETTLED:
                break
            best = beam[0]
        return self.best()

    def best(self) -> Scored:
        """The likeliest of those asked."""
        return max(self.known.values(), key=lambda s: s.log)
