"""Which cases a suite of n consists of."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping

import numpy as np

from twinbench.data.scenario import stream
from twinbench.proof.concealed.faults import faults
from twinbench.proof.concealed.generate import CELLS, Item
from twinbench.proof.concealed.machine import Machine
from twinbench.proof.concealed.machines import machines as machines_of

SEVERITIES = (0.1, 3.0)
"""Range that severities are drawn from, evenly in their logarithm: from a tenth of the noise to three times it."""
FULL = {
    "clean": 60, "parameters": 65, "poor_excitation": 65, "mechanism": 150, "onset": 50, "two_effects": 290,
    "sensor": 200, "left_out": 120, "foreign": 80,
}  # fmt: skip
"""Cases of each cell in a suite that can tell better from luck. 196 singles put a rate of .85 within 5 points, 286
pairs one of .75. 189 sound machines without a false name bound their rate at 2 %."""
assert tuple(FULL) == CELLS


def cases(n: int, seed: int, machines: Mapping[str, Machine] | None = None) -> list[Item]:
    """n cases, every cell with its share and at least one; a cell goes through all it has before it repeats.

    The order is such that a suite cut short has seen every cell, and each in nearly its share.

    Args:
        machines: in place of the seed's own.
    """
    machines = machines_of(seed) if machines is None else machines
    counts = {cell: max(1, round(n * full / sum(FULL.values()))) for cell, full in FULL.items()}
    counts["two_effects"] += max(0, n - sum(counts.values()))
    # Each cell's cases are spread evenly over the whole.
    order = sorted((k / count, i, cell) for i, (cell, count) in enumerate(counts.items()) for k in range(count))
    endless = {cell: _endless(cell, seed, machines) for cell in counts}
    return [Item(f"{i:04d}", *next(endless[cell])) for i, (*_, cell) in enumerate(order[:n])]


_Row = tuple[str, str, tuple[str, ...], float]


def _endless(cell: str, seed: int, machines: Mapping[str, Machine]) -> Iterator[_Row]:
    """Rows (cell, machine, effects, severity) of a cell: the machines in turn, each through all that it has.

    Random machines take a third of the turns, those written by hand the rest.
    """
    lists = {name: _own(cell, seed, machine) for name, machine in machines.items()}
    at_random = [name for name, machine in machines.items() if machine.kind == "random"]
    by_hand = [name for name in machines if name not in at_random]
    endless = itertools.cycle(at_random[i] for i in stream(seed, "plan", cell, "random").permutation(len(at_random)))
    share = min(len(at_random), max(1, len(by_hand) // 2))
    for turn in itertools.count():
        rng = stream(seed, "plan", cell, turn)
        names = [*by_hand, *itertools.islice(endless, share)]
        for i in rng.permutation(len(names)):
            name = names[i]
            severity = float(np.round(np.exp(rng.uniform(*np.log(SEVERITIES))), 4))
            effects = next(lists[name])
            yield cell, name, effects, severity if effects else 0.0


def _own(cell: str, seed: int, machine: Machine) -> Iterator[tuple[str, ...]]:
    """Effects of a machine's cases in a cell, shuffled, round after round."""
    for turn in itertools.count():
        listed = _of(cell, machine)
        yield from (listed[i] for i in stream(seed, "plan", cell, machine.name, turn).permutation(len(listed)))


def _of(cell: str, machine: Machine) -> list[tuple[str, ...]]:
    """Everything that a cell can hold on one machine."""
    if cell in ("clean", "parameters", "poor_excitation"):
        return [()]
    names = [e.name for e in machine.effects]
    if cell == "two_effects":
        return list(itertools.combinations(names, 2))
    if cell == "sensor":
        names = [f.name for f in faults(machine)]
    if cell == "foreign":
        names = [e.name for e in machine.foreign]
    return [(name,) for name in names]
