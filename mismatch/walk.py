"""The whole walk: audit, calibrate, weigh what may be missing, decide what is said, prove it on what was held back."""

from __future__ import annotations

from twinbench.mismatch.asked import Asked, Progress, forward, silent
from twinbench.mismatch.checks import audit
from twinbench.mismatch.design.suggested import suggested
from twinbench.mismatch.diagnosis import Diagnosis, Fit
from twinbench.mismatch.history.history import history_of
from twinbench.mismatch.naming.decision import Rule, decided
from twinbench.mismatch.naming.selfcheck import checked
from twinbench.mismatch.naming.weighed import weighed
from twinbench.mismatch.residual_tests import residual_tests
from twinbench.mismatch.stage_prove import proved, tested
from twinbench.mismatch.unread import unread


def examine(asked: Asked, progress: Progress = silent, rule: Rule | None = None) -> Diagnosis:
    """The stages one after the other.

    Args:
        rule: by which is decided what is said; the learnt one if left out.

    Raises:
        BadInput: a recording that is too short, or a simulator that diverges.
    """
    progress = forward(progress)
    seen, fit, answer = weighed(asked, progress)
    tracks, simulator = fit.tracks, asked.simulator

    progress("prove", 0.0)
    self_check = checked(answer)
    progress("prove", 0.5)
    asked_of = tested(answer, fit, seen.floor)
    answer, held = asked_of.answer, asked_of.held
    found = proved(asked_of, decided(answer, self_check.again, rule), fit, seen.floor)
    before = Fit(fit.problem, fit.z)
    chosen = answer.chosen
    histories = tuple(history_of(answer.naming, chosen, k, seen.floor) for k in range(len(chosen.effects)))
    if not found.claims and simulator.stepped is None:  # what is unnamed in a stepped model is sought at its readings
        found = found._replace(strange=(*found.strange, *unread(chosen, answer.naming.ground, seen.floor)))
    tests = residual_tests(tracks, before.residuals, answer.naming.ground, seen.floor, simulator)
    progress("prove", 1.0)
    return Diagnosis(
        simulator=simulator,
        machine=seen.machine,
        tracks=tracks,
        held=held,
        joined=seen.joined,
        noisy=fit.noisy,
        floor=seen.floor,
        stuck=[*fit.stuck, *asked_of.stuck],
        rounded=fit.rounded,
        spikes=tuple(s for t in (*tracks, *held) for s in t.spikes),
        remarks=[*audit([*tracks, *held], simulator), *seen.remarks],
        before=before,
        tests=tests,
        answer=answer,
        self_check=self_check,
        histories=histories,
        experiment=suggested(answer, found.claims),
        **found._asdict(),
    )
