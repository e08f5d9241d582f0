"""From weighed hypotheses to findings: which effects, what else each could be, and what speaks for it."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from twinbench.mismatch.naming.bounded import Bounds
from twinbench.mismatch.naming.effect import Effect
from twinbench.mismatch.naming.ground import Ground
from twinbench.mismatch.naming.marginal import DISCREPANCY_PCT, LEAST_TRIED_PCT, Reduced, eliminated, learn
from twinbench.mismatch.naming.misfit import squared
from twinbench.mismatch.naming.name import NEAR, Naming
from twinbench.mismatch.naming.picture import Picture
from twinbench.mismatch.naming.settle import Settled, odds_of
from twinbench.mismatch.naming.steady import one_form, one_size, squares_beside
from twinbench.mismatch.naming.whiteness import Coloured, coloured
from twinbench.physics.simulator import Array, Port

PLAIN = np.log(20.0)
"""Nats that the plainest set may lie behind the likeliest: twenty to one."""
SAME = 0.998
"""Squared cosine from which two effects' columns, what else is unknown taken out, are one thing."""
SAME_SQ, SAME_SHARE = 1.0, 0.05
"""So are hypotheses whose readings are nearer than one sd of the noise, if that is also less than this share of what
the effect does to them: forms and phases of their own can make one thing of columns that differ."""
PERIODIC = "periodic@"
SAME_PERIOD = 0.01
"""Share by which two periods may differ and be one: periods are known to a thousandth, and drawn over a decade."""
SOMETHING = 0.2
"""Prior odds of something that no catalogue holds."""


@dataclass(frozen=True)
class Unnamed:
    """Something at a port that no catalogue holds: its evidence against the hypothesis, nats; its size, per cent."""

    port: Port
    log: float
    size_pct: float


@dataclass(frozen=True)
class Found:
    """One finding.

    Attributes:
        effect: as it stands in the chosen hypothesis, ``place`` there.
        weights: probability of each name in its place, all else as it is, likeliest first; they sum to one.
        sets: probability of every set of names that was weighed; they sum to one.
        alike: names that do the same in these recordings.
        unnamed: something unnamed in its place, at each port, the likeliest first.
        evidence: what speaks for it, by name; ``naming.decision`` weighs it.
    """

    effect: Effect
    place: int
    name: str
    weights: Mapping[str, float]
    sets: Mapping[frozenset[str], float]
    alike: frozenset[str]
    unnamed: tuple[Unnamed, ...]
    evidence: Mapping[str, float]

    def marginal(self, names: Collection[str]) -> float:
        """Probability that one of these names is there, over all sets that were weighed."""
        total = sum(p for one, p in self.sets.items() if not one.isdisjoint(names))
        return min(1.0, total)  # a sum of all shares may round above 1

    def credible(self, probability: float) -> tuple[str, ...]:
        """Names that hold the right one with so much probability, likeliest first."""
        names, total = [], 0.0
        for name, p in self.weights.items():
            names.append(name)
            total += p
            if total >= probability:
                break
        return tuple(names)


@dataclass(frozen=True)
class Answer:
    """The plainest hypothesis that is not twenty times less likely than the likeliest, and what it says.

    Attributes:
        left: something unnamed beside it, the likeliest port first.
        coloured: what tells its innovations from white noise.
        inexact: what its equations are inexact by where only one port's were, against nowhere; the likeliest port
            first. It may be as small as in any simulator.
    """

    naming: Naming
    chosen: Settled
    found: tuple[Found, ...]
    left: tuple[Unnamed, ...]
    coloured: Coloured
    inexact: tuple[Unnamed, ...]

    @property
    def more(self) -> bool:
        """Is something unnamed beside it likelier than not?"""
        return bool(self.left) and self.left[0].log > 0.0


def answered(naming: Naming) -> Answer:
    """Read the findings off the hypotheses."""
    best = naming.best
    near = [h for h in naming.hypotheses if h.log > best.log - PLAIN]
    chosen = _plainer(near, min(near, key=lambda h: (len(h.effects), -h.log)))
    left = unnamed_beside(naming.ground, chosen)
    sets = _sets(naming)
    beside, wandering = squares_beside(chosen, naming.ground)
    colour = coloured(chosen, naming.ground)
    left_over = [
        {"beside": beside, "wandering": by_place, "lingers": float(_lingers(chosen, i, colour))}
        for i, by_place in enumerate(wandering)
    ]
    found = tuple(_found(naming, chosen, i, left[0].log, sets, one) for i, one in enumerate(left_over))
    return Answer(naming, chosen, found, left, colour, inexact_beside(naming.ground, chosen))


def _plainer(near: Sequence[Settled], chosen: Settled) -> Settled:
    """The hypothesis with the effects that the chosen one's contain in their place, if it is near too."""
    machine = chosen.problem.machine
    plain = {machine.candidates[e.variant.candidate].family for e in chosen.effects}
    return next((h for h in near if set(h.names) == plain), chosen)


def unnamed_beside(ground: Ground, hypothesis: Settled) -> tuple[Unnamed, ...]:
    """Something unnamed beside a hypothesis, at each port, the likeliest first."""
    inner = _known(hypothesis)
    return _unnamed(ground, inner.G, inner.b, 0.0, learn(inner.G, inner.b, ground.group, hypothesis.learnt.s).log)


def inexact_beside(ground: Ground, hypothesis: Settled) -> tuple[Unnamed, ...]:
    """The usual discrepancy of a hypothesis at each port alone, against none at all, the likeliest first."""
    inner, found = _known(hypothesis), []
    for p, port in enumerate(ground.ports):
        mine = ground.group == p
        G, b, one = inner.G[np.ix_(mine, mine)], inner.b[mine], np.zeros(int(mine.sum()), dtype=int)
        learnt = learn(G, b, one, np.array([DISCREPANCY_PCT]))
        found.append(Unnamed(port, learnt.log, float(learnt.s[0])))
    return tuple(sorted(found, key=lambda u: -u.log))


def _known(hypothesis: Settled) -> Reduced:
    """The discrepancy's functions with the unknowns of a hypothesis integrated out; what a bound holds stays there."""
    G, b, _ = hypothesis.products.over()
    low, high = Bounds.of(hypothesis.problem).around(hypothesis.z)
    held = np.flatnonzero((low >= 0.0) | (high <= 0.0))
    left, mean = np.delete(np.arange(len(b)), held), np.delete(hypothesis.mean, held)
    return eliminated(G[np.ix_(left, left)], b[left], np.arange(len(mean)), mean, np.ones(len(mean)))


def _unnamed(ground: Ground, G: Array, b: Array, base: float, against: float) -> tuple[Unnamed, ...]:
    found = []
    for p, port in enumerate(ground.ports):
        start = np.maximum(0.5 * ground.s, LEAST_TRIED_PCT)
        start[p] = max(5.0, ground.s[p])
        learnt = learn(G, b, ground.group, start, free=p)
        log = base + learnt.log + np.log(SOMETHING / len(ground.ports)) - against
        found.append(Unnamed(port, float(log), float(learnt.s[p])))
    return tuple(sorted(found, key=lambda u: -u.log))


def _found(
    naming: Naming,
    chosen: Settled,
    i: int,
    left: float,
    sets: Mapping[frozenset[str], float],
    left_over: Mapping[str, float],
) -> Found:
    name, rest = chosen.names[i], frozenset(n for k, n in enumerate(chosen.names) if k != i)
    painter = naming.without(chosen, i)
    shown = painter.picture()
    logs, same, reads_the_same = {name: chosen.log}, {name}, _same_readings(naming.ground, chosen, i)
    for h in naming.hypotheses:
        names = frozenset(h.names)
        if len(names) == len(rest) + 1 and rest < names:
            (other,) = names - rest
            logs[other] = max(h.log, logs.get(other, -np.inf))
            if h.log > chosen.log - NEAR and reads_the_same(h):
                same.add(other)
    for other, square in zip(shown.names, painter.cosines(chosen.sizes[i]), strict=True):
        # The same thing under another name; but what was settled and is far less likely is not.
        if square > SAME and logs.setdefault(other, chosen.log) > chosen.log - PLAIN:
            same.add(other)
    weights = dict(sorted(zip(logs, shares(logs.values()), strict=True), key=lambda t: -t[1]))
    none, unnamed = _instead(naming, chosen, i, shown)
    evidence = {
        "against_nothing": chosen.log - none,
        # With something unnamed beside it or without, whichever is likelier.
        "against_unnamed": chosen.log + max(left, 0.0) - unnamed[0].log,
        **left_over,
        **_evidence(naming.ground, chosen, i),
    }
    return Found(chosen.now[i], i, name, weights, sets, frozenset(same), unnamed, evidence)


def _instead(naming: Naming, chosen: Settled, i: int, shown: Picture) -> tuple[float, tuple[Unnamed, ...]]:
    """Evidence of the set less an effect, nats; and something unnamed in its place, its evidence in nats too.

    Both are told from where the set less the effect settled, if it was brought there: what a picture promises from
    afar need not come true.
    """
    rest = sorted(c for k, c in enumerate(chosen.candidates) if k != i)
    weighed = [h for h in naming.hypotheses if not h.given_up and sorted(h.candidates) == rest]
    if weighed:
        best = max(weighed, key=lambda h: h.log)
        beside = unnamed_beside(naming.ground, best)
        return best.log, tuple(replace(u, log=u.log + best.log) for u in beside)
    ground, sets = naming.ground, shown.sets
    v = sets.many
    odds = odds_of(chosen.problem, [e for k, e in enumerate(chosen.effects) if k != i])
    base = sets.reduced.log + shown.log + odds
    G, b = sets.reduced.G[v:, v:], sets.reduced.b[v:]
    none = base + learn(G, b, ground.group, np.maximum(ground.s, LEAST_TRIED_PCT)).log
    return none, _unnamed(ground, G, b, base, 0.0)


def _sets(naming: Naming) -> dict[frozenset[str], float]:
    """Probability of each set of names that was weighed."""
    logs: dict[frozenset[str], float] = {}
    for h in naming.hypotheses:
        names = frozenset(h.names)
        logs[names] = max(h.log, logs.get(names, -np.inf))
    return dict(zip(logs, shares(logs.values()), strict=True))


def shares(logs: Collection[float]) -> list[float]:
    """Evidence in nats as probabilities that sum to one."""
    raw = np.exp(np.array([*logs]) - max(logs))
    return list((raw / raw.sum()).tolist())


def _same_readings(ground: Ground, chosen: Settled, i: int) -> Callable[[Settled], bool]:
    """Does another hypothesis, where it settled, say the same readings, up to little of what an effect does to them?"""
    own, square = chosen.problem.residuals(chosen.at), squared(ground, chosen.learnt.s)
    seen = (chosen.sizes[i] / chosen.sds[i]) ** 2
    least = max(min(SAME_SQ, SAME_SHARE * seen), (1.0 - SAME) * seen)

    def of(other: Settled) -> bool:
        return square([a - b for a, b in zip(own, other.problem.residuals(other.at), strict=True)]) < least

    return of


def _evidence(ground: Ground, chosen: Settled, i: int) -> dict[str, float]:
    """What else speaks for an effect, and against it: how it is itself."""
    size, sd = chosen.sizes[i], chosen.sds[i]
    return {
        "sds": float(abs(size) / max(sd, 1e-300)),
        "echo": float(_echoes(chosen, i)),
        "one_size": one_size(chosen, i, ground),
        "one_form": one_form(chosen, i, ground),
    }


def _lingers(chosen: Settled, i: int, colour: Coloured) -> bool:
    """Is it a periodic force that leaves its period in the readings? The period is right then, and the place is not."""
    return chosen.names[i].startswith(PERIODIC) and colour.swings_with(chosen.now[i].variant.shape[0])


def _echoes(chosen: Settled, i: int) -> bool:
    """Is it one of several effects of the set that draw one thing, which is none of them?

    Two periodic forces of one period are one, somewhere else. Several faults of one channel draw its curve, or that of
    what acts there.
    """
    effects, me = chosen.now, chosen.problem.machine.candidates[chosen.now[i].variant.candidate]

    def draws_one_thing(other: Effect) -> bool:
        it = chosen.problem.machine.candidates[other.variant.candidate]
        if me.name.startswith(PERIODIC) and it.name.startswith(PERIODIC):
            return abs(other.variant.shape[0] / effects[i].variant.shape[0] - 1.0) < SAME_PERIOD
        both_faults = "physics" not in (me.mechanism.kind, it.mechanism.kind)
        return both_faults and me.mechanism.port == it.mechanism.port

    return any(draws_one_thing(e) for k, e in enumerate(effects) if k != i)
