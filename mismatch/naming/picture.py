"""All candidates in one view: what each would do to the readings, tried where it shows as half the noise."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from twinbench.mismatch.machine import Candidate
from twinbench.mismatch.naming.ground import Ground
from twinbench.mismatch.naming.marginal import Reduced, eliminated
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
BEGINS_LATE = 0.15
"""Prior probability that an effect begins while it is watched."""


@dataclass(frozen=True)
class Picture:
    """Candidates' variants around a view, each from the beginning, then the late ones.

    Attributes:
        variants: (V,) which.
        since: (V,) from when, s, on the recordings' clock; minus infinity from the beginning.
        candidates: (V,) of whom.
        units: (V,) prior sd of each size, in the first parameter's unit.
        sets: their evidence.
        log: what makes the sets' evidence comparable with that of other views, nats.
        excess: mean square that the unknowns leave, in noise variances, less one.
    """

    variants: tuple[Variant, ...]
    since: Array
    candidates: tuple[Candidate, ...]
    units: Array
    sets: Sets
    log: float
    excess: float

    @property
    def names(self) -> list[str]:
        """(V,) names of the candidates."""
        return [c.name for c in self.candidates]


class Painter:
    """Makes pictures of a view; columns are made once.

    Args:
        listed: the variants in every picture.
        without: (k,) positions of an effect's unknowns that are taken out of the view: they are at their prior's mean.
        probes: share of its typical size that each variant is tried with; found out if left out.
        wanders: positions among the unknowns of sizes that may differ from place to place; by which ``share``.
    """

    def __init__(
        self,
        view: View,
        ground: Ground,
        listed: Sequence[Variant],
        without: Sequence[int] | np.ndarray = (),
        probes: Mapping[Variant, float] | None = None,
        wanders: Sequence[int] = (),
        share: float = WANDERS,
    ) -> None:
        mean = prior_mean(view)
        whole, out = view.unknowns(), np.array(without, dtype=int)
        self.removed = [columns[:, :, out] for columns in whole]
        size = out[:1]  # its shape does nothing where it is not
        residuals = [r - c[:, :, size] @ mean[size] for r, c in zip(view.residuals, whole, strict=True)]
        self.view, self.ground, self.listed = replace(view, residuals=tuple(residuals)), ground, tuple(listed)
        self._own = [np.delete(columns, out, axis=2) for columns in whole]
        self._mean = np.delete(mean, out)
        if wanders:
            wandering = view.wandering(ground.discrepancy, wanders, share)
            self._own = [np.concatenate((j, w), axis=2) for j, w in zip(self._own, wandering, strict=True)]
            self._mean = np.concatenate((self._mean, np.zeros(wandering[0].shape[2])))
        self._rows = sum(int(np.isfinite(r).sum()) for r in view.residuals)
        if probes is None:
            shows = self._shows(view.of_variants(self.listed, np.full(len(self.listed), FIRST_PROBE)))[0]
            tried = np.clip(SHOWS / np.maximum(shows, 1e-12), LEAST_PROBE, MOST_PROBE)
            probes = dict(zip(self.listed, map(float, tried), strict=True))
        self.probes = probes
        self._probes = np.array([probes[v] for v in self.listed])
        self._columns = view.of_variants(self.listed, self._probes)

    def picture(self, since_s: Sequence[float] = (), late: Sequence[int] = (), grid: int = 0) -> Picture:
        """All variants from the beginning, and some that begin at given times.

        Args:
            since_s: the times.
            late: positions of those that may begin then.
            grid: among how many times these were chosen; as many as there are if 0.
        """
        which, since, columns = list(range(len(self.listed))), [-np.inf] * len(self.listed), self._columns
        if len(late) and len(since_s):
            many = 1 + len(since_s)
            later = self.view.of_variants([self.listed[i] for i in late], self._probes[list(late)], since_s)
            keep = [k for k in range(many * len(late)) if k % many]
            columns = [np.concatenate((c, x[:, :, keep]), axis=2) for c, x in zip(columns, later, strict=True)]
            which += [late[k // many] for k in keep]
            since += [since_s[k % many - 1] for k in keep]
        shows, reduced, kept, excess, q = self._shows(columns)
        candidates = [self.view.problem.machine.candidates[self.listed[i].candidate] for i in which]
        typicals = np.array([abs(typical(c)) for c in candidates])
        most = np.array([_most(c) for c in candidates]) / typicals
        sd = np.minimum(max(VISIBLE, np.sqrt(excess)) / np.maximum(shows, 1e-12), most)
        scale = np.concatenate((sd, np.ones(len(self.ground.group))))
        prior = self._prior(candidates)
        prior[len(self.listed) :] += np.log(BEGINS_LATE / max(grid or len(since_s), 1))
        sets = Sets(
            reduced=Reduced(reduced.G * np.outer(scale, scale), reduced.b * scale, reduced.log),
            group=self.ground.group,
            prior=prior,
            bounded=np.array([one_way(c) for c in candidates]),
            family=np.array([c.family for c in candidates]),
            usable=kept > PARAMETER,
            s=self.ground.s,
            since=np.array(since),
        )
        return Picture(
            tuple(self.listed[i] for i in which),
            np.array(since),
            tuple(candidates),
            sd * typicals,
            sets,
            -0.5 * q,
            excess,
        )

    def cosines(self) -> Array:
        """(V,) squared cosines of each listed column with what was taken out of the view, the unknowns apart.

        Where a size can have one sign only, a column of the other sign is none.
        """
        n, v = self._own[0].shape[2], len(self.listed)
        both = [
            np.concatenate((j, c, x[:, :, :1]), axis=2)
            for j, c, x in zip(self._own, self._columns, self.removed, strict=True)
        ]
        G, b, _ = self.ground.products(self.view, both).over()
        G, b = G[: n + v + 1, : n + v + 1], b[: n + v + 1]
        reduced = eliminated(G, b, np.arange(n), self._mean, np.ones(n)).G
        squares = np.maximum(np.diag(reduced), 1e-300)
        return np.asarray(reduced[:v, v] ** 2 / (squares[:v] * squares[v]))

    def _prior(self, candidates: Sequence[Candidate]) -> Array:
        listed = [c.name for c in candidates][: len(self.listed)]
        common = 1.0 / max(len(set(listed)), 1)
        odds = np.array([common if c.odds is None else c.odds for c in candidates])
        return np.log(odds) - np.log([listed.count(c.name) for c in candidates])

    def _shows(self, columns: Sequence[Array]) -> tuple[Array, Reduced, Array, float, float]:
        """How strongly each column shows beside the unknowns, in noise sds (V,); the form without the unknowns.

        Then the share of its square that each column keeps, (V,); the mean square, less one, that is left; and the
        sum of squares of the residuals.
        """
        n, v = self._own[0].shape[2], columns[0].shape[2]
        both = [np.concatenate((j, c), axis=2) for j, c in zip(self._own, columns, strict=True)]
        G, b, q = self.ground.products(self.view, both).over()
        reduced = eliminated(G, b, np.arange(n), self._mean, np.ones(n))
        kept = np.maximum(np.diag(reduced.G)[:v], 0.0)
        fitted = b[:n] @ np.linalg.solve(G[:n, :n] + np.eye(n), b[:n])
        share = kept / np.maximum(np.diag(G)[n : n + v], 1e-300)
        return np.sqrt(kept / self._rows), reduced, share, max(0.0, float(q - fitted) / self._rows - 1.0), q


def one_way(candidate: Candidate) -> bool:
    """Can its size have one sign only?"""
    v = candidate.mechanism.parameters[0]
    return bool(v.low >= candidate.null[0] or v.high <= candidate.null[0])


def _most(candidate: Candidate) -> float:
    """The largest that its size may be, from absence."""
    v = candidate.mechanism.parameters[0]
    return float(max(abs(v.high - candidate.null[0]), abs(v.low - candidate.null[0])))
