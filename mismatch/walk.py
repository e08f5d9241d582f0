"""The whole walk: audit, calibrate, screen, refit, test, prove."""

from __future__ import annotations

from twinbench.mismatch.asked import Asked, Progress, forward, silent
from twinbench.mismatch.checks import audit, residual_tests
from twinbench.mismatch.diagnosis import Diagnosis
from twinbench.mismatch.explanation import Explanation
from twinbench.mismatch.followed import Followed, told_followed
from twinbench.mismatch.guards import Guards
from twinbench.mismatch.picture import variants
from twinbench.mismatch.stage_audit import audited
from twinbench.mismatch.stage_calibrate import Calibration, calibration
from twinbench.mismatch.stage_prove import Proved, proved
from twinbench.mismatch.stage_search import Search, searched
from twinbench.mismatch.visited import resized


def examine(asked: Asked, progress: Progress = silent, guards: Guards = Guards()) -> Diagnosis:
    """The stages one after the other.

    Raises:
        BadInput: a recording that is too short, or a simulator that diverges.
    """
    progress = forward(progress)
    seen = audited(asked, progress)
    machine, simulator = seen.machine, asked.simulator

    fit = calibration(seen, progress)
    tracks, held = fit.tracks, fit.held
    remarks = [*audit([*tracks, *held], simulator), *([seen.coarse] if seen.coarse else [])]
    machine.candidates = resized(machine.candidates, fit.problem, fit.z, seen.period_s)
    search = Search(variants(machine.candidates), seen.floor, progress, guards)
    progress("calibrate", 1.0)

    found = searched(Explanation((), (), fit.problem, fit.z, fit.cost), search)
    before = found.before
    progress("screen", 1.0)
    progress("refit", 1.0)

    progress("prove", 0.0)
    left = before.problem.residuals(before.z)
    tests = residual_tests(tracks, left, before.problem.whitener, seen.floor, simulator)
    proof = proved(found, fit, search)
    judgement = proof.judgement
    followed = _followed(proof, before, fit)
    progress("prove", 1.0)
    return Diagnosis(
        simulator=simulator,
        machine=machine,
        tracks=tracks,
        held=held,
        joined=seen.joined,
        floor=seen.floor,
        stuck=fit.stuck,
        spikes=tuple(s for t in (*tracks, *held) for s in t.spikes),
        remarks=remarks,
        before=before,
        best=proof.best,
        chosen=proof.chosen,
        tried=found.tried,
        fitted=proof.fitted,
        shown=proof.shown,
        threshold=found.threshold,
        tests=tests,
        rivals=proof.rivals,
        losses=proof.losses,
        held_before=proof.held_before,
        held_after=proof.held_after,
        share=judgement.share,
        there=judgement.there,
        transferred=judgement.transferred,
        worse=judgement.worse,
        refused=judgement.refused,
        weighed_on_held_out=proof.compared,
        followed=followed,
    )


def _followed(proof: Proved, before: Explanation, fit: Calibration) -> tuple[Followed, ...]:
    """How much of each output the accepted simulator explains, on held-out recordings where there are any."""
    accepted = proof.chosen or before
    outputs = accepted.problem.machine.simulator.outputs
    held = proof.held_after if proof.chosen is not None else proof.held_before
    if held is None:
        return told_followed(fit.tracks, accepted.problem.residuals(accepted.z), outputs, False)
    return told_followed(fit.held, held.residuals, outputs, True)
