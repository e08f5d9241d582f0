"""The experiment that would settle a set, within limits that are told."""

from __future__ import annotations

from collections.abc import Sequence

from twinbench.common.errors import BadInput
from twinbench.mismatch.design.candidates import drawn
from twinbench.mismatch.design.choice import Proposal, hand_of, proposed
from twinbench.mismatch.design.clock import clock_of
from twinbench.mismatch.design.contested import contested, rivals_at
from twinbench.mismatch.design.hand import weighed_as
from twinbench.mismatch.design.limits import Limits
from twinbench.mismatch.naming.answer import Answer
from twinbench.mismatch.naming.decision import Claim


def within(answer: Answer, claims: Sequence[Claim], limits: Limits) -> Proposal | None:
    """The best experiment within limits; None where nothing is contested, or no experiment can be made."""
    claim = contested(claims)
    if claim is None:
        return None
    rivals, names = rivals_at(answer.naming, answer.chosen, claim)
    if len(rivals) < 2:
        return None
    tracks, ground = answer.chosen.problem.tracks, answer.naming.ground
    clock = clock_of(tracks, ground.noise, limits.sampling_s, tracks[0].linear)
    candidates = drawn(answer.chosen.problem.machine.simulator, limits)
    hand = weighed_as(hand_of(rivals, names, ground, candidates, clock), claim.found.weights if claim.found else {})
    try:
        return proposed(hand, candidates, clock)
    except BadInput:
        return None
