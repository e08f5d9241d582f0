"""The experiment to make next: all candidates tried on paper, the best of them looked at closely."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from twinbench.mismatch.catalogue import typical_rates
from twinbench.mismatch.course import Course
from twinbench.mismatch.design.candidates import Candidate
from twinbench.mismatch.design.hand import Hand, at_hand
from twinbench.mismatch.design.separation import Expected, expected, nats
from twinbench.mismatch.design.trials import Clock, Trial, course_of, tried
from twinbench.mismatch.naming.discrepancy import discrepancy
from twinbench.mismatch.naming.ground import Ground
from twinbench.mismatch.naming.name import common_fluxes
from twinbench.mismatch.naming.settle import Settled
from twinbench.mismatch.naming.view import View
from twinbench.mismatch.visited import moved

ANCHORED = 12
"""Candidates whose runs say, beside the recordings, where the discrepancy has to be described."""


def hand_of(
    rivals: Sequence[Settled], names: Sequence[str], ground: Ground, candidates: Sequence[Candidate], clock: Clock
) -> Hand:
    """What is at hand, the discrepancy described wherever recordings and candidates go."""
    best, measured = rivals[0], np.ones(len(ground.noise.white), dtype=bool)
    if not ground.ports:
        return at_hand(rivals, names, ground)
    view = View.around(best.problem, best.z)
    some = candidates[:: max(1, len(candidates) // ANCHORED)]
    courses = [c for c in (course_of(best, one, clock, measured) for one in some) if np.isfinite(c.means).all()]
    whole = discrepancy([*view.courses, *courses], typical_rates(moved(best.problem, best.z)), common_fluxes(view))
    return at_hand(rivals, names, replace(ground, discrepancy=whole))
