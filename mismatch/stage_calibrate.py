"""Second stage: the simulator as it came, fitted; and readings set aside that say nothing of the machine."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from twinbench.mismatch.asked import Progress
from twinbench.mismatch.calibrate import calibrated, own_unknowns
from twinbench.mismatch.faults import faults
from twinbench.mismatch.fit import Problem, Unknown
from twinbench.mismatch.noisy_inputs import NoisyInput, SpikyInput, find_noisy_inputs
from twinbench.mismatch.proof import Held, held_out
from twinbench.mismatch.rounded import ROUNDS, find_rounded
from twinbench.mismatch.stage_audit import Audited
from twinbench.mismatch.stuck import Stuck, find_stuck, without
from twinbench.mismatch.tracks import Track
from twinbench.physics.simulator import Array, Series


@dataclass(frozen=True)
class Calibration:
    """The calibrated simulator.

    Attributes:
        problem: the fit.
        z: (K,) where the problem's unknowns stand, each in its own unit.
        tracks: the recordings without the readings of sensors that stand still.
        held: the held-out recordings, with the readings of sensors that stand still in them.
        own: unknowns that each held-out recording has for itself.
        held_first: how the calibrated simulator does on the held-out recordings; None without any.
        stuck: the sensors that stand still in the recordings that are learnt from.
        rounded: the faults of sensors that move in steps; the machine has them now.
        noisy: the inputs whose records are noisy or have spikes; all recordings are without these now.
    """

    problem: Problem
    z: Array
    tracks: list[Track]
    held: list[Track]
    own: tuple[Unknown, ...]
    held_first: Held | None
    stuck: list[Stuck]
    rounded: list[Series]
    noisy: tuple[SpikyInput | NoisyInput, ...]


def calibration(audited: Audited, progress: Progress) -> Calibration:
    """Fit the parameters, with spikes that the simulator follows put back, and found what no fit goes to.

    Those are sensors that stand still, and sensors that move in steps.
    """
    progress("calibrate", 0.0)
    machine, tracks, floor = audited.machine, audited.tracks, audited.floor
    problem, z = calibrated(machine, tracks, floor, lambda share: progress("calibrate", 0.5 * share))
    followed = _with_followed_spikes(problem, z)
    if any(a is not b for a, b in zip(followed, tracks, strict=True)):
        tracks = followed
        problem, z = calibrated(machine, tracks, floor, lambda share: progress("calibrate", 0.5 + 0.2 * share))
    held = audited.held
    noisy = find_noisy_inputs(problem, z, machine.input_sds)
    if noisy:
        for one in noisy:
            tracks, held = ([one.off(t) for t in some] for some in (tracks, held))
            # What the noise of each sample does cannot be asked of whole runs: then it is only taken off.
            if isinstance(one, NoisyInput) and machine.simulator.stepped is None:
                machine.input_sds[one.column] = one.sd
        problem, z = calibrated(machine, tracks, floor)
    stuck: list[Stuck] = []
    if found := find_stuck(tracks, problem.residuals(z), floor):
        problem, z = calibrated(machine, without(tracks, found), floor)
        # Where it begins shows best against a fit that has not seen it.
        whole = replace(problem, tracks=tracks, offsets=()).refined(z)
        stuck = find_stuck(tracks, whole.residuals(z), floor) or found
        tracks = without(tracks, stuck)
        problem, z = calibrated(machine, tracks, floor)
    rounded = _rounded(audited, tracks, problem, z)
    if rounded:
        for fault in rounded:
            machine.take_for_granted(fault)
        problem, z = calibrated(machine, tracks, floor)
    progress("calibrate", 0.8)
    own = own_unknowns(machine.simulator, held)
    held_first = held_out(problem, z, held, own) if held else None
    if held_first is not None:
        held = [t.followed(readings) for t, readings in zip(held, held_first.readings, strict=True)]
    return Calibration(problem, z, tracks, held, own, held_first, stuck, rounded, noisy)


def _rounded(audited: Audited, tracks: Sequence[Track], problem: Problem, z: Array) -> list[Series]:
    """The faults of sensors that plainly move in steps, with their steps as nominal sizes."""
    readings = [problem.readings(r, z) for r in range(len(tracks))]
    outputs, found = problem.machine.simulator.outputs, []
    named = {m.name: m for m in faults(problem.machine.simulator, audited.period_s)}
    for one in find_rounded(tracks, readings, audited.may_round):
        fault = named[f"{ROUNDS}{outputs[one.channel].name}"]
        size = replace(fault.parameters[0], nominal=one.step)
        found.append(replace(fault, parameters=(size,)))
    return found


def _with_followed_spikes(problem: Problem, z: Array) -> list[Track]:
    """The recordings with those spikes put back that the calibrated simulator follows."""
    return [t.followed(problem.readings(r, z)) if t.spikes else t for r, t in enumerate(problem.tracks)]
