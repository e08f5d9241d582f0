"""From recordings to an answer: audit, calibrate, and weigh everything that may be missing."""

from __future__ import annotations

from typing import NamedTuple

from twinbench.mismatch.asked import Asked, Progress, forward, silent
from twinbench.mismatch.naming.answer import Answer, answered
from twinbench.mismatch.naming.name import named
from twinbench.mismatch.stage_audit import Audited, audited
from twinbench.mismatch.stage_calibrate import Calibration, calibration
from twinbench.mismatch.visited import resized


class Weighed(NamedTuple):
    """What was seen, what was fitted with nothing missing, and what is likely missing."""

    seen: Audited
    fit: Calibration
    answer: Answer


def weighed(asked: Asked, progress: Progress = silent) -> Weighed:
    """Everything but the held-out recordings' say.

    Raises:
        BadInput: a recording that is too short, or a simulator that diverges.
    """
    progress = forward(progress)
    seen = audited(asked, progress)
    fit = calibration(seen, progress)
    machine = seen.machine
    machine.candidates = resized(machine.candidates, fit.problem, fit.z, seen.period_s)
    progress("calibrate", 1.0)
    naming = named(fit.problem, fit.z, seen.floor, lambda share: progress("screen", share))
    answer = answered(naming)
    progress("screen", 1.0)
    return Weighed(seen, fit, answer)
