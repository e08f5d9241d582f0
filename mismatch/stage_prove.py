"""Last stages: the chosen effects fitted by forward runs, and asked once on the recordings that were held back.

Those choose nothing: how well they are foretold is part of what decides whether the chosen effects are said.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from twinbench.mismatch.diagnosis import Fit
from twinbench.mismatch.fit import Problem, Unknown
from twinbench.mismatch.followed import Followed, strangers, told_followed
from twinbench.mismatch.naming.answer import PLAIN, Answer
from twinbench.mismatch.naming.decision import Claim
from twinbench.mismatch.naming.effect import memory_starts
from twinbench.mismatch.naming.foretold import foretold
from twinbench.mismatch.naming.name import FAR_OFF
from twinbench.mismatch.naming.settle import Settled
from twinbench.mismatch.proof import Held, Worse, held_out, worse_outputs
from twinbench.mismatch.seed import ENGINE_SEED
from twinbench.mismatch.solve import HOP, NEARLY, solve
from twinbench.mismatch.stage_calibrate import Calibration
from twinbench.mismatch.stuck import Stuck, set_aside
from twinbench.mismatch.tracks import Track
from twinbench.mismatch.words import listed, number
from twinbench.physics.simulator import Array

STANDS_IN = 0.5
"""Share of the removable error on held-out recordings that effects without a name must remove to mend the simulator.
What removed a fifth of it made a filter err more: drifts had taken the rest. Of the real recordings the chambers remove
0.99 and the Cascaded Tanks four fifths, so at more than that the tanks would not be mended."""
REFITTED = 6
"""Jacobians of a fit that begins where the hypothesis stands, twice."""
HOPS = 6
"""Times that a fit which ends far off is begun anew near its best. Steps stall at the kinks of saturations and
overflows: on the train's compressor the fit removed 43 or 95 % of the error to remove, by how sums were rounded. Other
numbers were not measured."""


class Tested(NamedTuple):
    """The chosen effects by forward runs.

    Attributes:
        answer: with what these runs say of each finding.
        mended: the simulator with the effects; None where there are none.
        held: the held-out recordings without the readings of sensors that stand still.
        stuck: those sensors.
        held_before, held_after: these recordings by the calibrated simulator, and by the mended one.
    """

    answer: Answer
    mended: Fit | None
    held: list[Track]
    stuck: list[Stuck]
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


def tested(answer: Answer, fit: Calibration, floor: Array) -> Tested:
    """Fit the chosen effects by forward runs, and ask the held-out recordings of them.

    What the chosen effects explain in these is no sensor that stands still.

    Args:
        floor: (ny,) noise of block means, in the outputs' units.
    """
    mended = _mended(answer.chosen, answer.naming.ground.variance) if answer.found else None
    if fit.held_first is None:
        return Tested(_judged(answer, mended, 0.0), mended, fit.held, [], None, None)
    held, stuck = set_aside(fit.held, fit.held_first.readings, floor)
    before, after = _both(fit, answer.chosen, mended, held)
    if stuck and after is not None:
        held, stuck = set_aside(fit.held, after.readings, floor)
        before, after = _both(fit, answer.chosen, mended, held)
    gain = 0.0
    if after is not None:
        ground, null = answer.naming.ground, answer.naming.null
        with_them = foretold(answer.chosen, ground, held, _own(fit, answer.chosen), after.own)
        gain = with_them - foretold(null, ground, held, fit.own, before.own)
    return Tested(_judged(answer, mended, gain), mended, held, stuck, before, after)


def _both(fit: Calibration, chosen: Settled, mended: Fit | None, held: Sequence[Track]) -> tuple[Held, Held | None]:
    """The held-out recordings by the calibrated simulator, and by the mended one if there is one."""
    before = held_out(fit.problem, fit.z, held, fit.own, fit.held_first)
    if mended is None:
        return before, None
    own = _own(fit, chosen)
    return before, held_out(*mended, held, own, before if own == fit.own else None)


def _own(fit: Calibration, chosen: Settled) -> tuple[Unknown, ...]:
    """What each held-out recording has for itself: where it starts, what the chosen effects remember too."""
    return (*fit.own, *memory_starts(fit.problem.machine, chosen.effects, len(fit.held)))


def _judged(answer: Answer, mended: Fit | None, held_gain: float) -> Answer:
    """The answer with what forward runs say of its findings.

    Args:
        held_gain: nats by which the chosen effects foretell the held-out recordings better than nothing does.
    """
    if mended is None:
        return answer
    misfit = float(_excess(mended.residuals, answer.naming.ground.variance).max(initial=0.0))
    said = {"misfit": misfit, "held_gain": held_gain}
    return replace(answer, found=tuple(replace(f, evidence={**f.evidence, **said}) for f in answer.found))


def _excess(residuals: Sequence[Array], variance: Array) -> Array:
    """(ny,) mean square beyond the noise's, in noise variances, of each output that was seen.

    Args:
        residuals: block means measured minus simulated, (B, ny) per recording, in the outputs' units.
        variance: (ny,) of the noise of block means, in the outputs' units squared.
    """
    whole = np.concatenate(residuals)
    seen = np.isfinite(whole).any(axis=0)
    return np.asarray(np.nanmean(whole[:, seen] ** 2, axis=0) / variance[seen] - 1.0)


def proved(found: Tested, claims: Sequence[Claim], fit: Calibration, floor: Array) -> Proved:
    """What stands of the claims.

    Args:
        floor: (ny,) noise of block means, in the outputs' units.
    """
    before, held_before = Fit(fit.problem, fit.z), found.held_before
    outputs, refused = fit.problem.machine.simulator.outputs, ""
    followed = _followed(found, fit, found.mended or before, found.held_after or held_before)
    lost = [f.channel for f in followed if not f.follows]
    if lost and found.mended is not None:
        # What foretells an output no better than a constant would is no name.
        claims, refused = _nameless(claims), f"with it the simulator does not follow {listed(lost)}"
    said = any(c.names for c in claims)
    foretells = any(f.evidence["held_gain"] > PLAIN for f in found.answer.found)
    # What has no name may mend the simulator all the same: the held-out recordings have to show that it does.
    stands = said or (foretells and removed(found) >= STANDS_IN)
    mended, held_after = (found.mended, found.held_after) if stands else (None, None)
    worse: tuple[Worse, ...] = ()
    if held_before is not None and held_after is not None and not (said and foretells):
        # A name that foretells more, all that is uncertain counted in, errs by what its parameters do.
        worse = worse_outputs(held_before, held_after, outputs)
    if worse:
        claims, mended, held_after = _nameless(claims), None, None
        refused = f"it makes the held-out errors of {listed([_spoilt(w) for w in worse])}"
    last, held_last = mended or before, held_after or held_before
    if mended is None and found.mended is not None:
        followed = _followed(found, fit, last, held_last)
    return Proved(
        tuple(claims),
        mended,
        held_before,
        held_after,
        worse,
        refused,
        followed,
        strangers(last.residuals, held_last.residuals, outputs, floor) if held_last else (),
    )


def _nameless(claims: Sequence[Claim]) -> list[Claim]:
    return [replace(c, names=()) for c in claims]


def _followed(found: Tested, fit: Calibration, by: Fit, held: Held | None) -> tuple[Followed, ...]:
    """How much of each output a fit explains: on the held-out recordings if there are any."""
    outputs = fit.problem.machine.simulator.outputs
    if held is not None:
        return told_followed(found.held, held.residuals, outputs, True)
    return told_followed(fit.tracks, by.residuals, outputs, False)


def removed(found: Tested) -> float:
    """Share of the removable error on the held-out recordings that the chosen effects remove; 0 without any.

    Errors are mean squares of block means beyond the noise's, in noise variances, summed over the outputs.
    """
    if found.held_before is None or found.held_after is None:
        return 0.0
    variance = found.answer.naming.ground.variance
    before, after = (float(np.sum(_excess(held.residuals, variance))) for held in (found.held_before, found.held_after))
    return 1.0 - max(after, 0.0) / before if before > 0.0 else 0.0


def _mended(chosen: Settled, variance: Array) -> Fit:
    """The chosen effects fitted by forward runs: what a discrepancy explained is left to what a simulator can do.

    Args:
        variance: (ny,) of the noise of block means, in the outputs' units squared.
    """
    best, rng = _fitted(chosen.problem, chosen.at), np.random.default_rng(ENGINE_SEED)
    scale = np.array([u.scale for u in chosen.problem.unknowns])
    for _ in range(HOPS):
        if _excess(best.residuals, variance).max(initial=0.0) <= FAR_OFF:
            break
        again = _fitted(chosen.problem, best.z + HOP * scale * rng.standard_normal(len(scale)))
        best = min(best, again, key=lambda fit: fit.problem.cost(fit.z))
    return best


def _fitted(problem: Problem, z: Array) -> Fit:
    z, _ = solve(problem, z, REFITTED, share=NEARLY)
    problem = problem.refined(z)
    return Fit(problem, solve(problem, z, REFITTED, share=NEARLY)[0])


def _spoilt(w: Worse) -> str:
    return f"{w.channel} grow from {number(w.before)} to {number(w.after)}"
