"""What is said of each finding: a name, a set of names, or a place alone."""

from __future__ import annotations

from dataclasses import dataclass

from twinbench.mismatch.naming.answer import Answer, Found
from twinbench.physics.simulator import Port

CREDIBLE = 0.95
"""Probability with which a set of names holds the right one."""
LARGEST_SET = 5
"""Names that a set may hold and still say something; beyond, the place is said."""


@dataclass(frozen=True)
class Claim:
    """One thing that a verdict says is there.

    Attributes:
        names: one is a name; several are what these recordings cannot tell apart, likeliest first; none is something
            unnamed.
        alike: do the names stand for one thing, which no record of these channels tells apart?
        probability: that this claim is right.
        port: where it acts.
        found: the finding that it is made of; None if nothing of the catalogue explains it.
    """

    names: tuple[str, ...]
    alike: bool
    probability: float
    port: Port
    found: Found | None


def decided(answer: Answer) -> tuple[Claim, ...]:
    """What is said of an answer; nothing where nothing is missing."""
    machine = answer.chosen.problem.machine
    port_of = {c.name: c.mechanism.port for c in machine.candidates}
    claims = []
    for found in answer.found:
        names = found.credible(CREDIBLE)
        alike = set(names) <= found.alike
        probability = sum(found.weights[n] for n in names)
        if len(names) > LARGEST_SET:
            names = ()
        claims.append(Claim(names, alike, probability, port_of[found.name], found))
    if answer.left and answer.left[0].log > 0.0:
        claims.append(Claim((), False, 0.5, answer.left[0].port, None))
    return tuple(claims)
