"""Last stage: the recordings that were held back are asked once, and may only refuse."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

from twinbench.mismatch.diagnosis import Fit
from twinbench.mismatch.followed import Followed, strangers, told_followed
from twinbench.mismatch.naming.decision import Claim
from twinbench.mismatch.naming.settle import Settled
from twinbench.mismatch.proof import Held, Worse, held_out, worse_outputs
from twinbench.mismatch.solve import NEARLY, solve
from twinbench.mismatch.stage_calibrate import Calibration
from twinbench.mismatch.words import listed, number
from twinbench.physics.simulator import Array

REFITTED = 6
"""Jacobians of a fit that begins where the hypothesis stands, twice."""


class Proved(NamedTuple):
    """What stands in the end; ``Diagnosis`` says what each is."""

    claims: tuple[Claim, ...]
    mended: Fit | None
    held_before: Held | None
    held_after: Held | None
    worse: tuple[Worse, ...]
    refused: str
    followed: tuple[Followed, ...]
    strange: tuple[str, ...]


def proved(chosen: Settled, claims: Sequence[Claim], fit: Calibration, floor: Array) -> Proved:
    """Ask the held-out recordings of the calibrated simulator and of the chosen hypothesis.

    Args:
        floor: (ny,) noise of block means, in the outputs' units.
    """
    before = Fit(fit.problem, fit.z)
    mended = _mended(chosen) if any(c.names for c in claims) else None
    held_before = held_out(*before, fit.held, fit.own, fit.held_first) if fit.held else None
    held_after: Held | None = None
    worse: tuple[Worse, ...] = ()
    if mended is not None and held_before is not None:
        held_after = held_out(*mended, fit.held, fit.own, held_before)
        worse = worse_outputs(held_before, held_after, fit.problem.machine.simulator.outputs)
    if worse:
        claims, mended, held_after = [replace(c, names=()) for c in claims], None, None
    last, held_last = mended or before, held_after or held_before
    outputs = fit.problem.machine.simulator.outputs
    return Proved(
        tuple(claims),
        mended,
        held_before,
        held_after,
        worse,
        f"it makes the held-out errors of {listed([_spoilt(w) for w in worse])}" if worse else "",
        told_followed(fit.held, held_last.residuals, outputs, True)
        if held_last
        else told_followed(fit.tracks, last.residuals, outputs, False),
        strangers(last.residuals, held_last.residuals, outputs, floor) if held_last else (),
    )


def _mended(chosen: Settled) -> Fit:
    """The chosen effects fitted by forward runs: what a discrepancy explained is left to what a simulator can do."""
    z, _ = solve(chosen.problem, chosen.at, REFITTED, share=NEARLY)
    problem = chosen.problem.refined(z)
    return Fit(problem, solve(problem, z, REFITTED, share=NEARLY)[0])


def _spoilt(w: Worse) -> str:
    return f"{w.channel} grow from {number(w.before)} to {number(w.after)}"
