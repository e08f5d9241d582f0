"""The fleet's evidence: sizes of what all machines share are drawn around a mean, what a machine has alone is its own.

A set of shared effects is weighed over all machines. Each machine may also have effects of its own, lack a shared one,
or have it in a size that nothing ties to the others'. A shared effect's mean and scatter are integrated out on a grid;
of several shared effects one after the other, the others at their likeliest.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.special import logsumexp

from twinbench.mismatch.fleet.evidence import Evidence, Known, likeliest
from twinbench.mismatch.naming.answer import shares
from twinbench.physics.simulator import Array

OWN = 0.1
"""Prior probability that a machine has an effect of its own."""
UNTIED = 0.05
"""Prior probability that a machine lacks what the others share, or has it in a size that nothing ties to theirs."""
SCATTERS = (0.01, 0.03, 0.1, 0.3)
"""Scatter of a shared size from machine to machine (sd), as a share of it; each as likely."""
STEPS = (-4.0, -2.0, -1.0, -0.5, 0.0, 0.5, 1.0, 2.0, 4.0)
"""Means that are tried, in sds around the size that each machine says."""
SWEEPS = 3
"""Times that the likeliest means and scatters of several shared effects are found one after the other."""
MOST_SHARED = 3
WIDEST = 4
"""Sets of shared effects that are followed further, of each number of effects."""


class Grid(NamedTuple):
    """Means and scatters that a shared effect may have.

    Attributes:
        mean: (N,) in the effect's unit.
        scatter: (N,) sd of machines around the mean, in the effect's unit.
        prior: (N,) log of their prior probabilities, dimensionless.
    """

    mean: Array
    scatter: Array
    prior: Array


@dataclass(frozen=True)
class Shared:
    """An effect that a set of shared effects holds.

    Attributes:
        mean, low, high: of its size over the fleet, with a 90 % interval, in its unit.
        scatter: of machines around the mean, sd in its unit.
    """

    mean: float
    low: float
    high: float
    scatter: float


@dataclass(frozen=True)
class Pooled:
    """A set of shared effects, weighed over the fleet.

    Attributes:
        log: evidence and prior, nats.
        shared: by name.
        odd: by machine, probability that it has something of its own.
        own: by machine, probability of each effect that it has, lacks or has otherwise alone.
    """

    log: float
    shared: Mapping[str, Shared]
    odd: Mapping[str, float]
    own: Mapping[str, Mapping[str, float]]

    @property
    def names(self) -> frozenset[str]:
        """Of the shared effects."""
        return frozenset(self.shared)


class _Term(NamedTuple):
    """One way in which a machine may be: its evidence and prior, and the sizes that are drawn around the fleet's."""

    log: float
    typical: tuple[str, ...]
    own: tuple[str, ...]
    evidence: Evidence


def pooled(fleet: Mapping[str, Known], candidates: int) -> list[Pooled]:
    """All sets of shared effects that are likely enough to be weighed, the likeliest first.

    Args:
        candidates: how many effects a machine may have.
    """
    counts: dict[str, int] = {}
    for known in fleet.values():
        for name in {name for names in known for name in names}:
            counts[name] = counts.get(name, 0) + 1
    common = [name for name, count in counts.items() if count > 1]
    found = {frozenset[str](): weighed(fleet, (), candidates)}
    last = [frozenset[str]()]
    for _ in range(MOST_SHARED):
        wider = {names | {name} for names, name in itertools.product(last, common) if name not in names}
        for names in wider - set(found):
            found[names] = weighed(fleet, tuple(sorted(names)), candidates)
        ahead = sorted(wider, key=lambda names: -found[names].log)[:WIDEST]
        if not ahead or found[ahead[0]].log < max(found[names].log for names in last):
            break
        last = ahead
    return sorted(found.values(), key=lambda p: -p.log)


def weighed(fleet: Mapping[str, Known], names: Sequence[str], candidates: int) -> Pooled:
    """One set of shared effects.

    Args:
        names: of these effects.
        candidates: how many effects a machine may have.
    """
    terms = {machine: _terms(known, names, candidates) for machine, known in fleet.items()}
    grids = {name: _grid(fleet, name) for name in names}
    at = {name: len(grid.mean) // 2 for name, grid in grids.items()}
    logs: dict[str, Array] = {}
    for _ in range(SWEEPS if len(names) > 1 else 1):
        for name, grid in grids.items():
            others = {n: (grids[n].mean[at[n]], grids[n].scatter[at[n]]) for n in names if n != name}
            each = [_over(several, name, grid, others) for several in terms.values()]
            logs[name] = np.sum(each, axis=0) + grid.prior
            at[name] = int(np.argmax(logs[name]))
    likeliest = {n: (grids[n].mean[at[n]], grids[n].scatter[at[n]]) for n in names}
    by_machine = {machine: _ways(several, likeliest) for machine, several in terms.items()}
    log = sum(float(logsumexp(logs_of)) for logs_of, _ in by_machine.values())
    log += sum(float(grids[n].prior[at[n]] + logsumexp(logs[n] - logs[n].max())) for n in names)
    log -= len(names) * float(np.log(candidates))
    odd, own = {}, {}
    for machine, (logs_of, several) in by_machine.items():
        p = shares(list(logs_of))
        odd[machine] = min(1.0, sum(q for q, term in zip(p, several, strict=True) if term.own))
        mine: dict[str, float] = {}
        for q, term in zip(p, several, strict=True):
            for name in term.own:
                mine[name] = min(1.0, mine.get(name, 0.0) + q)
        own[machine] = mine
    return Pooled(log, {n: _shared(grids[n], logs[n]) for n in names}, odd, own)


def _terms(known: Known, names: Sequence[str], candidates: int) -> list[_Term]:
    found = []
    for have, one in ((have, one) for have, those in known.items() for one in those):
        alone = [n for n in have if n not in names]
        there = [n for n in names if n in have]
        log = one.log + len(alone) * np.log(OWN / candidates)
        log += (len(names) - len(there)) * np.log(UNTIED / 2.0)
        lacks = [n for n in names if n not in have]
        for k in range(len(there) + 1):
            for typical in itertools.combinations(there, k):
                other = [n for n in there if n not in typical]
                prior = k * np.log(1.0 - UNTIED) + len(other) * np.log(UNTIED / 2.0)
                found.append(_Term(float(log + prior), typical, (*alone, *lacks, *other), one))
    return found


def _over(terms: Sequence[_Term], name: str, grid: Grid, others: Mapping[str, tuple[float, float]]) -> Array:
    """(N,) evidence of a machine over a grid of one shared effect's means and scatters, nats."""
    logs = []
    for term in terms:
        log = np.full(len(grid.mean), term.log)
        for n in term.typical:
            mean, scatter = (grid.mean, grid.scatter) if n == name else (np.array(v) for v in others[n])
            log = log + term.evidence.sizes[n].instead(mean, scatter)
        logs.append(log)
    return np.asarray(logsumexp(np.array(logs), axis=0))


def _ways(terms: Sequence[_Term], at: Mapping[str, tuple[float, float]]) -> tuple[Array, Sequence[_Term]]:
    """Evidence of each way in which a machine may be, nats, where shared effects have these means and scatters."""
    logs = []
    for term in terms:
        instead = [float(term.evidence.sizes[n].instead(*map(np.array, at[n]))) for n in term.typical]
        logs.append(term.log + sum(instead))
    return np.array(logs), terms


def _grid(fleet: Mapping[str, Known], name: str) -> Grid:
    """Means around the sizes that machines say, by the widest prior of any of them, and scatters.

    Means stand the closer, the better a machine knows its size.
    """
    said = [one.sizes[name] for known in fleet.values() if (one := likeliest(known, name)) is not None]
    means = np.unique([s.mean + step * s.sd for s in said for step in STEPS])
    wide = max(s.prior_sd for s in said)
    mean, share = np.meshgrid(means, SCATTERS, indexing="ij")
    scatter = np.maximum(share * np.abs(mean), min(SCATTERS) * min(s.sd for s in said))
    one_way = np.log(2.0) if all(s.one_way for s in said) else 0.0
    prior = -0.5 * (mean / wide) ** 2 - 0.5 * np.log(2.0 * np.pi * wide**2) + one_way
    prior += np.log(np.gradient(means) / len(SCATTERS))[:, None]
    return Grid(mean.ravel(), scatter.ravel(), prior.ravel())


def _shared(grid: Grid, logs: Array) -> Shared:
    p = np.exp(logs - logs.max())
    p /= p.sum()
    order = np.argsort(grid.mean, kind="stable")
    sums = np.cumsum(p[order])
    low, high = (float(grid.mean[order][min(int(np.searchsorted(sums, q)), len(sums) - 1)]) for q in (0.05, 0.95))
    return Shared(float(p @ grid.mean), low, high, float(p @ grid.scatter))
