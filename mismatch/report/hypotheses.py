"""The hypotheses that were weighed, in order of their evidence."""

from __future__ import annotations

from typing import NamedTuple

from twinbench.mismatch.diagnosis import Diagnosis
from twinbench.mismatch.verdict import weighed

CHOSEN, REFUSED, ABSENT, TRIED = "told", "chosen, not told", "nothing is missing", "also weighed"
NOTHING = "nothing"
"""What the hypothesis that nothing is missing is called."""


class Hypothesis(NamedTuple):
    """One set of effects.

    Attributes:
        gain: nats of evidence over nothing.
        probability: among all that were weighed.
    """

    names: tuple[str, ...]
    gain: float
    probability: float
    standing: str


def hypotheses(d: Diagnosis) -> list[Hypothesis]:
    """Each set of names once, at its best; likeliest first."""
    chosen = frozenset(d.answer.chosen.names)
    nothing, probabilities = d.answer.naming.null.log, weighed(d)
    found: dict[frozenset[str], Hypothesis] = {}
    for h in d.answer.naming.hypotheses:
        names, key = h.names, frozenset(h.names)
        if not names:
            standing = ABSENT
        elif key == chosen:
            standing = CHOSEN if d.mended is not None else REFUSED
        else:
            standing = TRIED
        found.setdefault(key, Hypothesis(names or (NOTHING,), h.log - nothing, probabilities[key], standing))
    return list(found.values())
