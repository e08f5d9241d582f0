"""The explanations that were fitted, in order of merit, and how each stands to the one that was accepted."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from twinbench.mismatch.diagnosis import Diagnosis

CHOSEN, REFUSED, RIVAL, TRIED = "accepted", "best, but refused", "cannot be told from it", "tried"


class Ranked(NamedTuple):
    """One explanation.

    Attributes:
        gain: over the calibrated simulator, twice the log-likelihood.
        needed: what noise alone could gain with as many effects.
    """

    names: tuple[str, ...]
    gain: float
    needed: float
    standing: str


def ranking(d: Diagnosis) -> list[Ranked]:
    """Each set of names once, at its best; best first by gain beyond what is needed."""
    best = d.chosen or d.best
    gains: dict[frozenset[str], tuple[float, tuple[str, ...]]] = {}
    for e in (*([best] if best else []), *d.fitted):
        names, gain = frozenset(e.names), d.before.cost - e.cost
        if names not in gains or gain > gains[names][0]:
            gains[names] = gain, e.names
    rivals = (
        [
            (set(best.names) - {name}) | {other}
            for name, others in zip(best.names, d.rivals, strict=True)
            for other in others.names
        ]
        if best and d.chosen
        else []
    )

    def standing(names: Sequence[str]) -> str:
        if best is not None and set(names) == set(best.names):
            return CHOSEN if d.chosen else REFUSED
        return RIVAL if set(names) in rivals else TRIED

    found = [Ranked(names, gain, d.threshold * len(names), standing(names)) for gain, names in gains.values()]
    return sorted(found, key=lambda e: e.needed - e.gain)
