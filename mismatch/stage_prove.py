"""Last stages: the chosen effects fitted by forward runs, and asked once on the recordings that were held back.

Those choose nothing: how well they are foretold is part of what decides whether the chosen effects are said.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from twinbench.mismatch.diagnosis import Fit
from twinbench.mismatch.followed import Followed, strangers, told_followed
from twinbench.mismatch.naming.answer import PLAIN, Answer
from twinbench.mismatch.naming.decision import Claim
from twinbench.mismatch.naming.foretold import foretold
from twinbench.mismatch.naming.settle import Settled
from twinbench.mismatch.proof import Held, Worse, held_out, worse_outputs
from twinbench.mismatch.solve import NEARLY, solve
from twinbench.mismatch.stage_calibrate import Calibration
from twinbench.mismatch.words import listed, number
from twinbench.physics.simulator import Array

REFITTED = 6
"""Jacobians of a fit that begins where the hypothesis stands, twice."""


class Tested(NamedTuple):
    """The chosen effects by forward runs.

    Attributes:
        answer: with what these runs say of each finding.
        mended: the simulator with the effects; None where there are none.
        held_before, held_after: the held-out recordings by the calibrated simulator, and by the mended one.
    """

    answer: Answer
    mended: Fit | None
    held_before: Held | None
    held_after: Held | None


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


def tested(answer: Answer, fit: Calibration) -> Tested:
    """Fit the chosen effects by forward runs, and ask the held-out recordings of them."""
    held_before = held_out(fit.problem, fit.z, fit.held, fit.own, fit.held_first) if fit.held else None
    if not answer.found:
        return Tested(answer, None, held_before, None)
    mended = _mended(answer.chosen)
    held_after = held_out(*mended, fit.held, fit.own, held_before) if held_before is not None else None
    noise = answer.naming.ground.noise
    variance = noise.white + noise.coloured
    fits = _beyond_noise(mended.residuals, variance)
    said = {"misfit": fits, "held_gain": _gain(answer, fit, held_before, held_after)}
    found = tuple(replace(f, evidence={**f.evidence, **said}) for f in answer.found)
    return Tested(replace(answer, found=found), mended, held_before, held_after)


def _gain(answer: Answer, fit: Calibration, before: Held | None, after: Held | None) -> float:
    """Nats by which the chosen effects foretell the held-out recordings better than nothing does; 0 without any."""
    if before is None or after is None:
        return 0.0
    ground, null = answer.naming.ground, answer.naming.null
    with_them = foretold(answer.chosen, ground, fit.held, fit.own, after.own)
    return with_them - foretold(null, ground, fit.held, fit.own, before.own)


def _beyond_noise(residuals: Sequence[Array], variance: Array) -> float:
    """Mean square beyond the noise's, in noise variances, of the output that is furthest off.

    Args:
        residuals: block means measured minus simulated, (B, ny) per recording, in the outputs' units.
        variance: (ny,) of the noise of block means, in the outputs' units squared.
    """
    whole = np.concatenate(residuals)
    seen = np.isfinite(whole).any(axis=0)
    ratio = np.nanmean(whole[:, seen] ** 2, axis=0) / variance[seen]
    return max(0.0, float(ratio.max(initial=1.0)) - 1.0)


def proved(found: Tested, claims: Sequence[Claim], fit: Calibration, floor: Array) -> Proved:
    """What stands of the claims.

    Args:
        floor: (ny,) noise of block means, in the outputs' units.
    """
    before, held_before = Fit(fit.problem, fit.z), found.held_before
    mended, held_after = (found.mended, found.held_after) if any(c.names for c in claims) else (None, None)
    worse: tuple[Worse, ...] = ()
    foretells = any(f.evidence["held_gain"] > PLAIN for f in found.answer.found)
    if held_before is not None and held_after is not None and not foretells:
        # Where all that is uncertain is counted in and it foretells more, the run errs by what its parameters do.
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
