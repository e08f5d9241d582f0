"""From weighed hypotheses to findings: which effects, what else each could be, and what speaks for it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from twinbench.mismatch.machine import Machine
from twinbench.mismatch.naming.ground import Ground
from twinbench.mismatch.naming.marginal import DISCREPANCY_PCT, eliminated, learn
from twinbench.mismatch.naming.name import Naming
from twinbench.mismatch.naming.picture import Picture
from twinbench.mismatch.naming.settle import Effect, Settled
from twinbench.physics.simulator import Array, Port

PLAIN = np.log(20.0)
"""Nats that the plainest set may lie behind the likeliest: twenty to one."""
SAME = 0.998
"""Squared cosine from which two effects' columns, what else is unknown taken out, are one thing."""
SOMETHING = 0.2
"""Prior odds of something that no catalogue holds."""


@dataclass(frozen=True)
class Found:
    """One finding.

    Attributes:
        effect: as it stands in the chosen hypothesis, ``place`` there.
        weights: probability of each name in its place, likeliest first; they sum to one.
        alike: names that no record of these could tell from it.
        evidence: what speaks for it, by name; ``naming.decision`` weighs it.
    """

    effect: Effect
    place: int
    name: str
    weights: Mapping[str, float]
    alike: frozenset[str]
    evidence: Mapping[str, float]

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
class Unnamed:
    """Something at a port that no catalogue holds: its evidence against the hypothesis, nats; its size, per cent."""

    port: Port
    log: float
    size_pct: float


@dataclass(frozen=True)
class Answer:
    """The plainest hypothesis that is not twenty times less likely than the likeliest, and what it says.

    Attributes:
        left: something unnamed beside it, the likeliest port first.
    """

    naming: Naming
    chosen: Settled
    found: tuple[Found, ...]
    left: tuple[Unnamed, ...]


def answered(naming: Naming) -> Answer:
    """Read the findings off the hypotheses."""
    best = naming.best
    near = [h for h in naming.hypotheses if h.log > best.log - PLAIN]
    chosen = _plainer(near, min(near, key=lambda h: (len(h.effects), -h.log)))
    found = tuple(_found(naming, chosen, i) for i in range(len(chosen.effects)))
    return Answer(naming, chosen, found, unnamed_beside(naming.ground, chosen))


def _plainer(near: Sequence[Settled], chosen: Settled) -> Settled:
    """The hypothesis with the effects that the chosen one's contain in their place, if it is near too."""
    machine = chosen.problem.machine
    plain = {machine.candidates[e.variant.candidate].family for e in chosen.effects}
    return next((h for h in near if {name_of(machine, e) for e in h.effects} == plain), chosen)


def unnamed_beside(ground: Ground, hypothesis: Settled) -> tuple[Unnamed, ...]:
    """Something unnamed beside a hypothesis, at each port, the likeliest first."""
    G, b, q = hypothesis.products.over()
    n = len(hypothesis.mean)
    inner = eliminated(G, b, np.arange(n), hypothesis.mean, np.ones(n))
    base = inner.log - 0.5 * q + sum(e.prior for e in hypothesis.effects)
    return _unnamed(ground, inner.G, inner.b, base, hypothesis.log)


def _unnamed(ground: Ground, G: Array, b: Array, base: float, against: float) -> tuple[Unnamed, ...]:
    found = []
    for p, port in enumerate(ground.ports):
        start = np.maximum(0.5 * ground.s, 1e-3)
        start[p] = max(5.0, ground.s[p])
        learnt = learn(G, b, ground.group, start, free=p)
        log = base + learnt.log + np.log(SOMETHING / len(ground.ports)) - against
        found.append(Unnamed(port, float(log), float(learnt.s[p])))
    return tuple(sorted(found, key=lambda u: -u.log))


def _found(naming: Naming, chosen: Settled, i: int) -> Found:
    machine = chosen.problem.machine
    name = name_of(machine, chosen.effects[i])
    rest = frozenset(name_of(machine, e) for k, e in enumerate(chosen.effects) if k != i)
    painter = naming.without(chosen, i)
    shown = painter.picture()
    alike = frozenset({name, *_alike(shown, painter.cosines())})
    logs = {name: chosen.log}
    for h in naming.hypotheses:
        names = frozenset(name_of(machine, e) for e in h.effects)
        if len(names) == len(rest) + 1 and rest < names:
            (other,) = names - rest
            logs[other] = max(h.log, logs.get(other, -np.inf))
    for other in alike - set(logs):
        logs[other] = chosen.log  # the same thing under another name
    top = max(logs.values())
    raw = {n: float(np.exp(v - top)) for n, v in sorted(logs.items(), key=lambda t: -t[1])}
    weights = {n: p / sum(raw.values()) for n, p in raw.items()}
    return Found(
        chosen.now[i], i, name, weights, alike, _evidence(naming, chosen, i, shown, {**logs, "": -np.inf}, alike)
    )


def name_of(machine: Machine, effect: Effect) -> str:
    """The candidate's name."""
    return machine.candidates[effect.variant.candidate].name


def _alike(shown: Picture, cosines2: Array) -> list[str]:
    return [name for name, c in zip(shown.names, cosines2, strict=True) if c > SAME]


def _evidence(
    naming: Naming, chosen: Settled, i: int, shown: Picture, logs: Mapping[str, float], alike: frozenset[str]
) -> dict[str, float]:
    """What speaks for an effect, and against it."""
    ground, sets = naming.ground, shown.sets
    v = sets.many
    prior = sum(e.prior for k, e in enumerate(chosen.effects) if k != i)
    base = sets.reduced.log + shown.log + prior
    G, b = sets.reduced.G[v:, v:], sets.reduced.b[v:]
    none = base + learn(G, b, ground.group, np.maximum(ground.s, 1e-3)).log
    other = _unnamed(ground, G, b, base, 0.0)[0].log
    rival = max(log for name, log in logs.items() if name not in alike)
    per_recording = _left_out(chosen, i, ground)
    effect, size, sd = chosen.effects[i], chosen.sizes[i], chosen.sds[i]
    left = unnamed_beside(ground, chosen)[0]
    machine = chosen.problem.machine
    rows = sum(int(np.isfinite(t.means).sum()) for t in chosen.problem.tracks)
    return {
        "against_nothing": chosen.log - max(none, _known_without(naming, chosen, i)),
        "against_rival": float(np.clip(chosen.log - rival, -50.0, 50.0)),
        "against_unnamed": chosen.log - other,
        "least_recording": float(min(per_recording)),
        "all_recordings": float(sum(per_recording)),
        "unnamed_beside": left.log,
        "discrepancy": float(np.sqrt(np.sum((chosen.learnt.s / DISCREPANCY_PCT) ** 2))),
        "sds": float(abs(size) / max(sd, 1e-300)),
        "shows": float(np.sqrt(_square(chosen, i, ground) / rows)),
        "effects": float(len(chosen.effects)),
        "fault": float(machine.candidates[effect.variant.candidate].mechanism.kind != "physics"),
        "late": float(chosen.since_s > -np.inf),
        "left": _left(chosen, ground, rows),
        "rivals": float(sum(np.exp(min(log - chosen.log, 0.0)) for n, log in logs.items() if n not in alike)),
        "at_bound": float(_at_bound(chosen, i)),
    }


def _known_without(naming: Naming, chosen: Settled, i: int) -> float:
    """Evidence of the same set less an effect, where that was weighed at its own fixed point."""
    rest = {e.variant.candidate for k, e in enumerate(chosen.effects) if k != i}
    return max((h.log for h in naming.hypotheses if {e.variant.candidate for e in h.effects} == rest), default=-np.inf)


def _left_out(chosen: Settled, i: int, ground: Ground) -> list[float]:
    """Nats by which each recording, the others known, is better predicted with an effect than without."""
    n, out = len(chosen.mean), np.arange(len(chosen.mean))[chosen.entries(i)]
    precision = np.concatenate((np.ones(n), 1.0 / np.maximum(chosen.learnt.s[ground.group], 1e-4) ** 2))
    mean = np.concatenate((chosen.mean, np.zeros(len(ground.group))))
    fixed = precision.copy()
    fixed[out] = 1e12  # held at its prior's mean: absent
    every = list(range(len(chosen.products.own)))

    def log(which: Sequence[int], weights: Array) -> float:
        G, b, q = chosen.products.over(which)
        return eliminated(G, b, np.arange(len(mean)), mean, weights).log - 0.5 * q

    whole, without_it = log(every, precision), log(every, fixed)
    found = []
    for r in every:
        others = [k for k in every if k != r]
        found.append((whole - log(others, precision)) - (without_it - log(others, fixed)))
    return found


def _square(chosen: Settled, i: int, ground: Ground) -> float:
    """Square of what an effect does to the whitened readings, what the other unknowns can imitate taken out."""
    G, b, _ = chosen.products.over()
    n, at = len(chosen.z), chosen.entries(i).start
    keep = np.array([k for k in range(n) if not chosen.entries(i).start <= k < chosen.entries(i).stop], dtype=int)
    some = np.array([*keep, at])
    inner = eliminated(G[np.ix_(some, some)], b[some], np.arange(len(keep)), np.zeros(len(keep)), np.ones(len(keep)))
    return float(max(inner.G[0, 0], 0.0) * chosen.mean[at] ** 2)


def _left(chosen: Settled, ground: Ground, rows: int) -> float:
    """Mean square of the whitened residuals at the posterior mean, less one."""
    G, b, q = chosen.products.over()
    precision = np.concatenate((np.ones(len(chosen.mean)), 1.0 / np.maximum(chosen.learnt.s[ground.group], 1e-4) ** 2))
    mean = np.concatenate((chosen.mean, np.zeros(len(ground.group))))
    w = np.linalg.solve(G + np.diag(precision), b + precision * mean)
    return float(q - 2.0 * b @ w + w @ G @ w) / rows - 1.0


def _at_bound(chosen: Settled, i: int) -> bool:
    at = chosen.entries(i)
    some = zip(chosen.problem.unknowns[at], chosen.z[at], strict=True)
    return any(v in (u.low, u.high) and u.low < u.high for u, v in some)
