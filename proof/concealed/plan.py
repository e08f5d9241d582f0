"""Which cases a suite of n consists of."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping

import numpy as np

from twinbench.data.scenario import stream
from twinbench.proof.concealed.faults import faults
from twinbench.proof.concealed.generate import CELLS, Item
from twinbench.proof.concealed.machine import Machine
from twinbench.proof.concealed.machines import MACHINES

SEVERITIES = (0.03, 0.1, 0.3, 1.0)
PLAIN = (0.3, 1.0)
SHARES = {
    "clean": 0.13, "parameters": 0.08, "sensor": 0.12, "mechanism": 0.28, "confusable": 0.06, "two_effects": 0.08,
    "left_out": 0.08, "foreign": 0.05, "poor_excitation": 0.06, "onset": 0.06,
}  # fmt: skip
assert tuple(SHARES) == CELLS


def cases(n: int, seed: int, machines: Mapping[str, Machine] = MACHINES) -> list[Item]:
    """n cases, every cell with its share and at least one; a cell goes through all it has before it repeats.

    The order is such that a suite cut short has seen every cell.
    """
    counts = {cell: max(1, round(n * share)) for cell, share in SHARES.items()}
    listed = {cell: itertools.islice(_endless(cell, seed, machines), count) for cell, count in counts.items()}
    rows = [row for row in itertools.zip_longest(*listed.values()) for row in row if row is not None]
    return [Item(f"{i:04d}", *row) for i, row in enumerate(rows[:n])]


_Row = tuple[str, str, tuple[str, ...], float]


def _endless(cell: str, seed: int, machines: Mapping[str, Machine]) -> Iterator[_Row]:
    """Rows (cell, machine, effects, severity) of a cell, round after round, shuffled, machines in turn."""
    for turn in itertools.count():
        rng = stream(seed, "plan", cell, turn)
        shuffled = []
        for machine in machines.values():
            own = [(cell, machine.name, effects, severity) for effects, severity in _of(cell, machine, rng)]
            shuffled.append([own[i] for i in rng.permutation(len(own))])
        for row in itertools.zip_longest(*shuffled):
            yield from (r for r in row if r is not None)


def _of(cell: str, machine: Machine, rng: np.random.Generator) -> list[tuple[tuple[str, ...], float]]:
    """Everything that a cell can hold on one machine."""
    names = [e.name for e in machine.effects]
    if cell in ("clean", "parameters"):
        return [((), 0.0)]
    if cell == "sensor":
        all_faults = [f.name for f in faults(machine)]
        return [((name,), s) for name in all_faults for s in PLAIN]
    if cell == "mechanism":
        return [((name,), s) for name in names for s in SEVERITIES]
    if cell == "confusable":
        return [((name,), s) for pair in machine.confusable for name in pair for s in PLAIN]
    if cell == "two_effects":
        pairs = list(itertools.combinations(names, 2))
        chosen = [pairs[i] for i in rng.permutation(len(pairs))[: len(names)]]
        return [(pair, s) for pair in chosen for s in PLAIN]
    if cell == "foreign":
        return [((e.name,), s) for e in machine.foreign for s in PLAIN]
    if cell == "poor_excitation":
        # What moves the machine by itself shows however little the machine is moved.
        return [((name,), 0.0) for name in names if not name.startswith("periodic")]
    return [((name,), s) for name in names for s in PLAIN]  # left_out, onset
