"""Which machines and effects are drawn."""

from __future__ import annotations

import itertools
from collections.abc import Iterator

import numpy as np

from twinbench.data.scenario import stream
from twinbench.proof.concealed.generate import Item
from twinbench.proof.concealed.machines import machines

SEVERITIES = 0.5, 2.0
"""Range that severities in the recordings at hand are drawn from, evenly in their logarithm; no unit. It decides how
many draws a set costs: tried on other draws, sets were rare below it, where nothing is found, and above it, where one
name stands alone, or none."""
RANDOM_MACHINES = 8
"""Random machines, two of each domain, beside those written by hand."""
RELATED = (
    "leak", "linear_leak", "quadratic_leak", "overflow", "viscous_friction", "coulomb_friction", "quadratic_friction",
    "cubic_friction", "constant_drop", "linear_loss", "quadratic_loss", "cubic_loss", "loss_to_ambient", "dead_zone",
)  # fmt: skip
"""Laws of which the catalogue has another form at the same place: where little moves, one looks like the other."""
TOO_SLOW = "compressor", "heat_exchanger"
"""Machines on which a verdict takes several times as long: in that time others give more sets."""


def drawn_items(draws: int, seed: int) -> list[Item]:
    """So many items: the machines in turn, each through its effects in mixed order."""
    known = {name: m for name, m in machines(seed, RANDOM_MACHINES).items() if name not in TOO_SLOW}
    related = {name: [e.name for e in m.effects if e.name.partition("@")[0] in RELATED] for name, m in known.items()}
    effects = {name: _endless(name, some, seed) for name, some in related.items() if some}
    rng, found = stream(seed, "designs"), []
    for i, name in zip(range(draws), itertools.cycle(effects), strict=False):
        severity = float(np.round(np.exp(rng.uniform(*np.log(SEVERITIES))), 4))
        found.append(Item(f"{i:04d}", "mechanism", name, (next(effects[name]),), severity))
    return found


def _endless(machine: str, names: list[str], seed: int) -> Iterator[str]:
    for turn in itertools.count():
        yield from (names[i] for i in stream(seed, "designs", machine, turn).permutation(len(names)))
