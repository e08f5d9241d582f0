"""First stage: the recordings and the simulator made ready for each other, before anything is fitted."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from twinbench.common.errors import BadInput
from twinbench.data.recording import Recording
from twinbench.mismatch.asked import Asked, Progress
from twinbench.mismatch.calibrate import block_noise, is_parameter
from twinbench.mismatch.joining import AUTO, LINEAR, Joined, how_joined
from twinbench.mismatch.machine import Machine
from twinbench.mismatch.model import whole_catalogue
from twinbench.mismatch.rounded import ROUNDS
from twinbench.mismatch.stepped import machine_of
from twinbench.mismatch.steps import settle_step
from twinbench.mismatch.stuck import STANDS_STILL
from twinbench.mismatch.tracks import FEWEST_SAMPLES, Track, prepare
from twinbench.mismatch.unbroken import unbroken
from twinbench.physics.compose import ONLY_STEPPED
from twinbench.physics.simulator import Array, Mechanism, Simulator

WITHOUT_SIZE = ("input_quantisation@", "input_stuck@")
"""Faults that have no small size which a fit could begin from, and are not found in another way."""
SPLIT = 0.7
"""Share of a single recording that is learnt from when none is held out."""


@dataclass(frozen=True)
class Audited:
    """What the other stages work on.

    Attributes:
        tracks, held: recordings to learn from, and those held back.
        floor: (ny,) noise of block means, in the outputs' units.
        period_s: median time between samples.
        joined: how inputs go between samples.
        remarks: where recordings were cut, and if the machine could not be integrated finely enough.
        may_round: positions of the outputs whose sensors may move in steps.
    """

    machine: Machine
    tracks: list[Track]
    held: list[Track]
    floor: Array
    period_s: float
    joined: Joined
    remarks: tuple[str, ...]
    may_round: tuple[int, ...]


def audited(asked: Asked, progress: Progress) -> Audited:
    """Split the recordings, put everything that may be missing into one machine, and settle how it is run.

    Raises:
        BadInput: a recording that is too short, or a simulator that diverges.
    """
    progress("audit", 0.0)
    simulator = asked.simulator
    recordings, hold_out = _split(asked.recordings, asked.hold_out)
    period_s = float(np.median(np.concatenate([np.diff(r.time_s) for r in recordings])))
    listed = _listed(asked, period_s)
    machine = _machine(asked, listed)
    names = {m.name for m in listed} - {m.name for m in asked.faults}
    may_round = tuple(c for c, v in enumerate(simulator.outputs) if f"{ROUNDS}{v.name}" in names)
    cut = [[unbroken(r, simulator) for r in some] for some in (recordings, hold_out)]
    learnt, held_out = ([part for parts, _ in some for part in parts] for some in cut)
    # Lengths of recordings held back choose nothing.
    shortest_s = min(float(r.time_s[-1] - r.time_s[0]) for r in (*learnt, *held_out))
    tracks = prepare(learnt, simulator, shortest_s=shortest_s)
    held = prepare(held_out, simulator, like=tracks)
    remarks = [remark for some in cut for _, remark in some]
    machine.epoch_s = min(float(t.time_s[0]) for t in tracks)
    _check_length([*tracks, *held])
    progress("audit", 0.3)
    try:
        joined = (
            how_joined(machine, tracks, lambda share: progress("audit", 0.3 + 0.6 * share))
            if asked.inputs == AUTO
            else Joined(asked.inputs, "user")
        )
        if joined.inputs == LINEAR:
            tracks, held = ([replace(t, linear=True) for t in some] for some in (tracks, held))
        floor = block_noise(tracks, simulator)
        coarse = settle_step(machine, tracks, floor)
    except ValueError as error:
        raise BadInput(str(error)) from error
    progress("audit", 1.0)
    said = tuple(remark for remark in (*remarks, coarse) if remark)
    return Audited(machine, tracks, held, floor, period_s, joined, said, may_round)


def _listed(asked: Asked, period_s: float) -> tuple[Mechanism, ...]:
    """What may be missing, as far as the user leaves it in."""
    simulator = asked.simulator
    listed = whole_catalogue(simulator, (), period_s) if asked.catalogue is None else tuple(asked.catalogue)
    asked.told.check(simulator, listed)
    return asked.told.left(listed)


def _machine(asked: Asked, listed: Sequence[Mechanism]) -> Machine:
    """The simulator with all candidates. What calibration moves anyway, or is found by itself, is none."""
    simulator, known = asked.simulator, {m.name for m in asked.faults}
    listed = tuple(m for m in listed if is_fitted(simulator, m))
    machine = machine_of(simulator, [m for m in listed if m.name not in known], asked.faults)
    machine.candidates = [replace(c, odds=asked.told.prior.get(c.name)) for c in machine.candidates]
    if asked.told.measured and simulator.stepped is not None:
        name = next(iter(asked.told.measured))
        raise BadInput(f"measured {name!r}: simulator {simulator.name!r} {ONLY_STEPPED}; leave it out")
    machine.input_sds = np.array([asked.told.measured.get(v.name, 0.0) for v in simulator.inputs])
    return machine


def is_fitted(simulator: Simulator, mechanism: Mechanism) -> bool:
    """Has it a size of its own that a fit finds? What calibration moves anyway, or is found by itself, has none."""
    return not (is_parameter(simulator, mechanism) or mechanism.name.startswith((STANDS_STILL, ROUNDS, *WITHOUT_SIZE)))


def _check_length(tracks: Sequence[Track]) -> None:
    for track in tracks:
        if len(track.starts) < FEWEST_SAMPLES:
            raise BadInput(
                f"recording {track.name}: {len(track.time_s)} samples are too few to learn from; record at least "
                f"{FEWEST_SAMPLES}"
            )


def _split(
    recordings: Sequence[Recording], hold_out: Sequence[Recording]
) -> tuple[Sequence[Recording], Sequence[Recording]]:
    if hold_out:
        return recordings, hold_out
    if len(recordings) > 1:
        return recordings[:-1], recordings[-1:]
    (only,) = recordings
    cut = int(SPLIT * len(only.time_s))
    return [_piece(only, slice(0, cut), "")], [_piece(only, slice(cut, None), " (end)")]


def _piece(recording: Recording, rows: slice, suffix: str) -> Recording:
    return replace(
        recording, name=recording.name + suffix, time_s=recording.time_s[rows], values=recording.values[rows]
    )
