"""Which machines and effects are drawn."""

from __future__ import annotations

import itertools
from collections.abc import Iterator

import numpy as np

from twinbench.data.scenario import stream
from twinbench.proof.concealed.generate import Item
from twinbench.proof.concealed.machines import machines

PLAIN_SEVERITIES = 1.0, 10.0
"""Range that severities on ordinary recordings are drawn from, evenly in their logarithm: what is left of it in narrow
ones has to be seen."""
RANDOM_MACHINES = 8
"""Random machines, two of each domain, beside those written by hand."""


def drawn_items(draws: int, seed: int) -> list[Item]:
    """So many items: the machines in turn, each through its effects in mixed order."""
    known = machines(seed, RANDOM_MACHINES)
    effects = {name: _endless(name, [e.name for e in m.effects], seed) for name, m in known.items()}
    rng, found = stream(seed, "designs"), []
    for i, name in zip(range(draws), itertools.cycle(known), strict=False):
        severity = float(np.round(np.exp(rng.uniform(*np.log(PLAIN_SEVERITIES))), 4))
        found.append(Item(f"{i:04d}", "mechanism", name, (next(effects[name]),), severity))
    return found


def _endless(machine: str, names: list[str], seed: int) -> Iterator[str]:
    for turn in itertools.count():
        yield from (names[i] for i in stream(seed, "designs", machine, turn).permutation(len(names)))
