"""Recordings of any simulator's machine: its inputs and outputs read, in its units, and checked."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from twinbench.common.errors import BadInput
from twinbench.common.shown import bare
from twinbench.data.clock import A_THOUSAND
from twinbench.data.formats.holdings import Zero
from twinbench.data.formats.united import NANOSECONDS
from twinbench.data.recording import Recording, read_recording
from twinbench.data.units import Limits
from twinbench.mismatch.series import held
from twinbench.mismatch.tracks import FEWEST_SAMPLES
from twinbench.physics.simulator import Simulator, Variable

LONGEST_RECORDING_S = 10 * 365.25 * 86400.0
_LOG = logging.getLogger("twinbench")
_RANGE_SLACK = 0.1  # of a channel's range: an idle sensor reads a little below its zero


def read_recordings(paths: Sequence[Path], simulator: Simulator, mapping: Sequence[str] = ()) -> list[Recording]:
    """Read recordings of a simulator's machine; channels are its inputs, then its outputs, in its units.

    Every input has to be there. One that a controller reads off an output's sensor (``Simulator.reads``) takes that
    output's readings where it has no column of its own; each reading holds until the next. An output that has no
    column is missing throughout (NaN): real machines lack sensors. A channel whose median lies well outside the
    bounds that its Variable gives is taken for a mistake in the unit.

    Args:
        paths: of any kind that ``data.formats.kinds`` lists. Where all of them say when they began, their times run on
            from the earliest.
        simulator: whose inputs and outputs are read.
        mapping: ``COLUMN=channel`` or ``COLUMN[unit]=channel``, as for ``data.recording.read_recording``.

    Raises:
        BadInput: one line; unreadable, a missing input, too short, or two recordings of one name.
    """
    channels = (*simulator.inputs, *simulator.outputs)
    if any(v.name == "time_s" for v in channels):
        raise BadInput(f"simulator {simulator.name!r}: 'time_s' is the name of the clock; rename that channel")
    recordings: list[Recording] = []
    for path in paths:
        recording = read_recording(
            path,
            mapping,
            units={v.name: v.unit for v in channels},
            limits={v.name: _limits(v) for v in channels},
            may_lack=[v.name for v in simulator.outputs] + [name for name, _ in simulator.reads],
            longest_s=LONGEST_RECORDING_S,
            period_s=np.inf,
        )
        recording = _with_readings(recording, simulator)
        if len(recording.time_s) < FEWEST_SAMPLES:
            raise BadInput(f"{path}: holds {len(recording.time_s)} samples, must hold {FEWEST_SAMPLES}; record longer")
        for variable, values in zip(simulator.inputs, recording.values.T, strict=False):
            if np.isnan(values).all():
                raise BadInput(f"{path}: input {variable.name} is empty; fill it in, the simulator cannot do without")
        if any(r.name.casefold() == recording.name.casefold() for r in recordings):
            raise BadInput(f"two recordings are named {recording.name}; rename one, or give it once only")
        recordings.append(recording)
    return _on_one_clock(recordings)


def _on_one_clock(recordings: list[Recording]) -> list[Recording]:
    """Times that begin with the earliest recording, where all of them say when they began; otherwise as they are."""
    zeros = [recording.zero for recording in recordings if recording.zero is not None]
    if not zeros:
        return recordings
    if len(zeros) < len(recordings) or len({zero.utc for zero in zeros}) > 1:
        _LOG.warning("twinbench: only some recordings say in UTC when they began; each keeps its own clock")
        return recordings
    begin_ns = min(zero.ns for zero in zeros)
    return [
        replace(r, time_s=r.time_s + (zero.ns - begin_ns) / NANOSECONDS, zero=Zero(begin_ns, zero.utc))
        for r, zero in zip(recordings, zeros, strict=True)
    ]


def _with_readings(recording: Recording, simulator: Simulator) -> Recording:
    """What a controller read is what the sensor said, if nothing else was recorded of it."""
    values = recording.values.copy()
    for name, sensor in simulator.reads:
        at, of = (recording.channels.index(channel) for channel in (name, sensor))
        if np.isnan(values[:, at]).all():
            values[:, at] = held(np.ascontiguousarray(values[:, of]))
    return replace(recording, values=values)


def check_measured(recordings: Sequence[Recording], simulator: Simulator) -> None:
    """Refuse recordings that hold nothing to compare the simulator with, or whose time is in another unit.

    Raises:
        BadInput: one has fewer readings of every output than a recording needs samples, or no output that moves,
            or samples a thousand times as far apart as another's.
    """
    names = ", ".join(v.name for v in simulator.outputs)
    for recording in recordings:
        outputs = recording.values[:, len(simulator.inputs) :]
        readings = (~np.isnan(outputs)).sum(axis=0)
        if readings.max() < FEWEST_SAMPLES:
            unread = f"; it has unread columns: {', '.join(map(bare, recording.unread))}" if recording.unread else ""
            raise BadInput(
                f"recording {recording.name}: none of the outputs ({names}) has {FEWEST_SAMPLES} readings; "
                f"name their columns with --map COLUMN=channel{unread}"
            )
        if all(len(np.unique(y[~np.isnan(y)])) < 2 for y in outputs.T):
            raise BadInput(
                f"recording {recording.name}: no output moves ({names}); leave it out, its sensors stand still"
            )
        _check_in_step(recording, simulator)
    apart = [float(np.median(np.diff(r.time_s))) for r in recordings]
    longest, shortest = int(np.argmax(apart)), int(np.argmin(apart))
    if apart[longest] > A_THOUSAND * apart[shortest]:
        raise BadInput(
            f"recording {recordings[longest].name}: its samples are {apart[longest]:.3g} s apart, those of "
            f"{recordings[shortest].name} {apart[shortest]:.3g} s; is its time in ms? Say so in a TOML file beside it: "
            "[channels] time_s = {column = 'time_s', unit = 'ms'}"
        )


def _check_in_step(recording: Recording, simulator: Simulator) -> None:
    """Refuse an output that is read in every other row or less, as a slow channel beside fast ones is.

    Blocks of rows in which most readings are missing are not compared, so it would pass unseen.
    """
    for variable, y in zip(simulator.outputs, recording.values.T[len(simulator.inputs) :], strict=True):
        read = np.flatnonzero(~np.isnan(y))
        if len(read) > 1 and np.median(np.diff(read)) >= 2:
            own_s = float(np.median(np.diff(recording.time_s[read])))
            raise BadInput(
                f"recording {recording.name}: output {variable.name} is read every {own_s:.4g} s, other channels more "
                f"often; write rate_Hz = {1.0 / own_s:.4g} into {recording.name}.toml beside it, which makes means"
            )


def check_excited(recordings: Sequence[Recording], simulator: Simulator) -> None:
    """Refuse recordings in all of which every input is constant; a machine without inputs needs none.

    Raises:
        BadInput: nothing can be learnt about what the inputs do.
    """
    n = len(simulator.inputs)
    ranges = [np.nanmax(r.values[:, :n], axis=0) - np.nanmin(r.values[:, :n], axis=0) for r in recordings]
    if n and not np.any(ranges):
        names = ", ".join(v.name for v in simulator.inputs)
        raise BadInput(
            f"recording {recordings[0].name}: no input varies ({names}); record the machine while its load changes, "
            "or make a constant input a parameter of the simulator"
        )


def _limits(variable: Variable) -> Limits:
    slack = _RANGE_SLACK * (variable.high - variable.low)
    hint = f"the simulator bounds it by {variable.low:g} and {variable.high:g}; mend those, or is it another unit?"
    return variable.low - slack, variable.high + slack, hint
