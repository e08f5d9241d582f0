"""The experiment that a verdict carries: the best of a few, where the recordings' inputs went."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from twinbench.common.errors import BadInput
from twinbench.mismatch.design.choice import ranked
from twinbench.mismatch.design.contested import contested
from twinbench.mismatch.design.limits import Limits
from twinbench.mismatch.design.separation import expected
from twinbench.mismatch.design.within import question_of
from twinbench.mismatch.naming.answer import Answer
from twinbench.mismatch.naming.decision import Claim
from twinbench.mismatch.tracks import Track

FEW = 15
"""Experiments that are tried for one sentence: it may cost a second, not a minute."""


class Suggested(NamedTuple):
    """The best of a few experiments.

    Attributes:
        rivals: names of what it would tell apart.
        says: the experiment in words.
        probability: that the right name then stands alone.
        nats: what it adds for the closest pair.
    """

    rivals: tuple[str, ...]
    says: str
    probability: float
    nats: float


def suggested(answer: Answer, claims: Sequence[Claim]) -> Suggested | None:
    """The best of a few experiments where the recordings' inputs went; None where nothing is contested."""
    if contested(claims) is None:
        return None
    limits = visited_limits(answer.chosen.problem.tracks)
    if not np.any(limits.high > limits.low):
        return None
    question = question_of(answer, claims, limits)
    if question is None:
        return None
    try:
        order = ranked(question.hand, question.candidates, question.clock)
    except BadInput:  # no run of them stays within the outputs' bounds
        return None
    best = order.finalists(1)[0]
    promised = expected(question.hand, best, order.groups)
    return Suggested(tuple(question.names), best.candidate.says, promised.right, promised.worst)


def visited_limits(tracks: Sequence[Track]) -> Limits:
    """Limits that recordings kept: how far their inputs went, how fast, and for how long."""
    u = np.concatenate([t.u for t in tracks])
    fastest = np.max(
        [np.abs(np.diff(t.u, axis=0) / np.diff(t.time_s)[:, None]).max(axis=0) for t in tracks], axis=0, initial=0.0
    )
    duration_s = float(np.mean([np.ptp(t.time_s) for t in tracks]))
    sampling_s = float(np.median(np.concatenate([np.diff(t.time_s) for t in tracks])))
    return Limits(u.min(axis=0), u.max(axis=0), fastest, duration_s, sampling_s, candidates=FEW)
