"""The experiment that would settle a set, within limits that are told."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from twinbench.common.errors import BadInput
from twinbench.mismatch.design.candidates import Candidate, drawn, usual
from twinbench.mismatch.design.choice import Choice, best_of, hand_of
from twinbench.mismatch.design.clock import Clock, clock_of
from twinbench.mismatch.design.contested import contested, rivals_at
from twinbench.mismatch.design.hand import Hand, weighed_as
from twinbench.mismatch.design.limits import Limits
from twinbench.mismatch.naming.answer import Answer
from twinbench.mismatch.naming.decision import Claim


class Question(NamedTuple):
    """What an experiment has to settle: the rivals as the recordings leave them, and what may be done."""

    names: Sequence[str]
    hand: Hand
    candidates: Sequence[Candidate]
    clock: Clock


def question_of(answer: Answer, claims: Sequence[Claim], limits: Limits) -> Question | None:
    """The question that a diagnosis leaves open; None where nothing is contested."""
    claim = contested(claims)
    if claim is None:
        return None
    rivals, names = rivals_at(answer.naming, answer.chosen, claim)
    if len(rivals) < 2:
        return None
    tracks, ground = answer.chosen.problem.tracks, answer.naming.ground
    clock = clock_of(tracks, ground.noise, limits.sampling_s, tracks[0].linear)
    candidates = drawn(answer.chosen.problem.machine.simulator, limits, usual(tracks))
    hand = weighed_as(hand_of(rivals, names, ground, candidates, clock), claim.found.weights if claim.found else {})
    return Question(names, hand, candidates, clock)


def within(answer: Answer, claims: Sequence[Claim], limits: Limits) -> Choice | None:
    """The best experiment within limits; None where nothing is contested, or no experiment can be made."""
    question = question_of(answer, claims, limits)
    if question is None:
        return None
    try:
        return best_of(question.hand, question.candidates, question.clock)
    except BadInput:
        return None
