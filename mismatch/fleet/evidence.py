"""What one machine's recordings say of each set of effects: its evidence, and its sizes as a Gaussian."""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
from scipy.special import log_ndtr

from twinbench.mismatch.began import late_odds
from twinbench.mismatch.naming.bounded import Bounds
from twinbench.mismatch.naming.name import Naming
from twinbench.mismatch.naming.onset import likeliest_forms
from twinbench.physics.simulator import Array

LEAST_BEGUN = 1e-3
"""Share of its prior sd that a size begins with at least: an effect of no size has no shape to move along."""


class Size(NamedTuple):
    """An effect's size from absence on one machine, in its first parameter's unit.

    Attributes:
        mean, sd: of the posterior.
        prior_sd: of the prior around nothing.
        one_way: can it have one sign only?
    """

    mean: float
    sd: float
    prior_sd: float
    one_way: bool

    def instead(self, mean: Array, sd: Array) -> Array:
        """Nats that other priors, which are normal, make of the size's own.

        Args:
            mean: (N,) of these priors, in the size's unit.
            sd: (N,) of these priors, in the size's unit.
        """
        own, old, new = self.sd**2, self.prior_sd**2, sd**2
        # What the readings say without any prior; nothing, where the posterior is as wide as the prior.
        told = max(1.0 / own - 1.0 / old, 1e-9 / old)
        at = self.mean / own / told
        apart = new + 1.0 / told
        log = -0.5 * (at - mean) ** 2 / apart - 0.5 * np.log(apart)
        before = -0.5 * at**2 / (old + 1.0 / told) - 0.5 * np.log(old + 1.0 / told)
        half = np.log(2.0) + log_ndtr(abs(self.mean) / self.sd) if self.one_way else 0.0
        return np.asarray(log - before - half)


class Evidence(NamedTuple):
    """A set of effects on one machine.

    Attributes:
        log: against nothing missing, in nats, without prior odds.
        sizes: by the effects' names.
        shapes: their other parameters, each in its unit; of an effect that has none they are empty.
    """

    log: float
    sizes: dict[str, Size]
    shapes: dict[str, tuple[float, ...]]

    def same(self, other: Evidence) -> bool:
        """Is it where another of the same set is, up to what the readings leave open?"""
        return all(
            abs(other.sizes[name].mean - s.mean) < max(other.sizes[name].sd, s.sd) for name, s in self.sizes.items()
        )


Known = dict[frozenset[str], tuple[Evidence, ...]]
"""All sets that were weighed on one machine, each with all places at which it came to rest, the likeliest first."""


def evidence(naming: Naming) -> Known:
    """Of all hypotheses."""
    found: Known = {}
    null = naming.null.log - naming.null.odds
    for h in naming.hypotheses:
        late = late_odds(h.problem.tracks) if h.since_s > -np.inf else 0.0
        log, one_way = h.log - h.odds + late - null, Bounds.of(h.problem).one_way
        at = [int(h.entries(i)[0]) for i in range(len(h.effects))]
        sizes = {
            name: Size(float(size), float(sd), h.problem.unknowns[k].spread, bool(one_way[k]))
            for name, size, sd, k in zip(h.names, h.sizes, h.sds, at, strict=True)
        }
        shapes = {name: e.variant.shape for name, e in zip(h.names, h.now, strict=True)}
        found = merged((found, {frozenset(h.names): (Evidence(log, sizes, shapes),)}))
    return found


def merged(several: Iterable[Known]) -> Known:
    """What was weighed several times on one machine; of several in one place the likeliest counts."""
    found: dict[frozenset[str], list[Evidence]] = {}
    for known in several:
        for names, those in known.items():
            found.setdefault(names, []).extend(those)
    return {names: _apart(those) for names, those in found.items()}


def _apart(those: Iterable[Evidence]) -> tuple[Evidence, ...]:
    kept: list[Evidence] = []
    for one in sorted(those, key=lambda e: -e.log):
        if not any(one.same(other) for other in kept):
            kept.append(one)
    return tuple(kept)


def likeliest(known: Known, name: str) -> Evidence | None:
    """The likeliest set that holds an effect; None if it was never weighed there."""
    having = [those[0] for names, those in known.items() if name in names]
    return max(having, key=lambda one: one.log, default=None)


def weigh_all(naming: Naming, wanted: Iterable[frozenset[str]]) -> None:
    """Bring sets of effects to their own fixed points that the search passed over: here nothing is too unlikely."""
    shown, null = naming.picture, naming.null
    forms = {shown.names[i]: i for i in reversed(likeliest_forms(shown))}
    known = {frozenset(h.names) for h in naming.hypotheses}
    for names in wanted:
        if names in known or not names <= set(forms):
            continue
        key = [forms[name] for name in sorted(names)]
        there, sizes = naming.painter.start(shown, key, null.learnt.s)
        least = LEAST_BEGUN * shown.units[key]
        sizes = np.where(np.abs(sizes) < least, least, sizes)
        naming.settle(null.problem, there, shown.effects(key, sizes), null.learnt.s)
