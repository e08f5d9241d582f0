"""One update of DeepONet-Kalman in one compiled call: spike gate, operator, sensitivities, filter, report.

The same function runs one machine in place (``online``) and many in lockstep (``Estimator.step``). All that it touches
lies in five records; nothing is allocated.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

from twinbench.machines.coordinates import Array
from twinbench.machines.machine import Machine
from twinbench.methods.deeponet_kalman.augmented import bound_states, readings
from twinbench.methods.deeponet_kalman.forecast import predict_mean
from twinbench.methods.deeponet_kalman.layout import stream_type
from twinbench.methods.deeponet_kalman.model import Model, modes_type, room_type
from twinbench.methods.deeponet_kalman.parts import Parts
from twinbench.methods.deeponet_kalman.records import one_record, record, record_of
from twinbench.methods.deeponet_kalman.safeguards import Settings, safety_type
from twinbench.methods.deeponet_kalman.stream import fill, push
from twinbench.methods.deeponet_kalman.tick import tick
from twinbench.methods.estimator import FLAG_MISSING, FLAG_SPIKE
from twinbench.methods.frontend import HAMPEL_WINDOW, Fitted, gate_one
from twinbench.methods.kalman import INNOVATION_CLIP_SD
from twinbench.methods.noise import output_sd_of
from twinbench.methods.reporting import report_one

UNKNOWN_S = 1.0
"""From this age of a channel on of which the operator's query is made, what is slow is not corrected: what the outputs
say then may be its doing."""


class Scaling(NamedTuple):
    """The operator's query and its standardisation; that of its samples is the front end's.

    Attributes:
        mean: (q,) means of the query in its units.
        scale: (q,) their spreads in the same units.
        above: (q,) dimensionless, which channel each is, or is a quotient of.
        below: (q,) dimensionless, by which channel it is divided; -1: by none.
        asked: (k,) dimensionless, all channels of which the query is made.
    """

    mean: Array
    scale: Array
    above: np.ndarray
    below: np.ndarray
    asked: np.ndarray


def scaling_of(machine: Machine, mean: Array, scale: Array) -> Scaling:
    """The query of a machine.

    Args:
        machine: whose.
        mean: (q,) means of the query in its units.
        scale: (q,) their spreads in the same units.
    """
    parts = [expression.partition("/") for expression in machine.operating]
    above = np.array([machine.channels.index(part[0]) for part in parts])
    below = np.array([machine.channels.index(part[2]) if part[2] else -1 for part in parts])
    return Scaling(mean, scale, above, below, np.unique(np.append(above, below[below >= 0])))


def keep_of(parts: Parts) -> np.ndarray:
    """Where what is reported stands in z, (n + nh,): states and health."""
    return np.r_[0 : parts.states, parts.zeta : parts.noise]


def twin_record(filter_: Model, front: Fitted, query: Scaling, parts: Parts, update_every: int) -> np.ndarray:
    """(1,): what a twin is, beside the operator's weights.

    Args:
        filter_: its filter's model.
        front: its front end.
        query: of its operator.
        parts: of its machine.
        update_every: ticks from correction to correction.
    """
    settings = Settings._make(
        float(value) for value in filter_.settings
    )  # one type, whatever the numbers were given as
    values = {"filter": filter_._replace(settings=settings), "front": front, "query": query}
    keep = keep_of(parts)
    kind = record(
        {
            **{name: (record_of(value), ()) for name, value in values.items()},
            "keep": ("i8", keep.shape),
            "update_every": ("i8", ()),
        }
    )
    return one_record(kind, {**values, "keep": keep, "update_every": update_every})


def said_type(parts: Parts) -> np.dtype[np.void]:
    """What a twin says after an update: the fields of State and Info."""
    n, ny = parts.states + parts.health, parts.outputs
    return record(
        {
            **dict.fromkeys(("mean", "low", "high"), ("f8", (n,))),
            "cov": ("f8", (n, n)),
            "innovation": ("f8", (ny,)),
            "S": ("f8", (ny, ny)),
            "nis": ("f8", ()),
            "accepted": ("u1", (ny,)),
            "flags": ("i8", ()),
            "age_s": ("f8", (parts.channels,)),
        }
    )


def memory_type(weights: np.ndarray, parts: Parts) -> np.dtype[np.void]:
    """What one machine carries from update to update.

    Args:
        weights: (1,) of ``methods.deeponet_kalman.layout.pack``, a record of dimensionless weights.
        parts: of the machine.
    """
    channels = parts.channels
    return record(
        {
            "recent": ("f8", (HAMPEL_WINDOW, channels)),
            **dict.fromkeys(("filled", "age_s", "outlier", "last", "still"), ("f8", (channels,))),
            "mask": ("f4", (channels,)),  # of the last sample, which the window takes in when the next one is there
            "ticks": ("i8", ()),  # updates so far
            "stream": (stream_type(weights), ()),
            "safety": (safety_type(parts), ()),
            "z": ("f8", (parts.size,)),
            "P": ("f8", (parts.size, parts.size)),
            "modes": (modes_type(parts), ()),
        }
    )


def scratch(weights: np.ndarray, parts: Parts) -> np.ndarray:
    """(1,) of room for one update.

    Args:
        weights: (1,) of ``methods.deeponet_kalman.layout.pack``, a record of dimensionless weights.
        parts: of the machine.
    """
    channels = parts.channels
    kind = record(
        {
            "filter": (room_type(weights, parts), ()),
            **dict.fromkeys(("accepted", "spike", "confirmed"), ("u1", (channels,))),
            "before": ("f8", (channels,)),
            "kept": ("f8", (HAMPEL_WINDOW,)),
            **dict.fromkeys(("white", "coloured", "measured", "lag"), ("f8", (parts.outputs,))),
            **dict.fromkeys(("sample", "mask"), ("f4", (channels,))),
            "query": ("f4", (parts.query,)),
        }
    )
    return np.zeros(1, kind)


@njit(cache=True, error_model="numpy")
def standardise(twin, values, t):  # type: ignore[no-untyped-def]
    """What the operator's window takes in of readings (C,), and its query, into ``t.sample`` and ``t.query``."""
    for c in range(t.sample.size):
        t.sample[c] = (values[c] - twin.front.mean[c]) / twin.front.scale[c]
    for i in range(t.query.size):
        raw = values[twin.query.above[i]]
        if twin.query.below[i] >= 0:
            raw /= values[twin.query.below[i]]
        t.query[i] = (raw - twin.query.mean[i]) / twin.query.scale[i]


@njit(cache=True, error_model="numpy")
def take_in(weights, twin, m, values, t):  # type: ignore[no-untyped-def]
    """Append readings (C,) with ``t.mask`` to the operator's window."""
    standardise(twin, values, t)
    push(weights, m.stream, t.filter.operator, t.sample, t.mask, t.query)


@njit(cache=True, error_model="numpy")
def _hand_over(twin, m, lag_s, t):  # type: ignore[no-untyped-def]
    """What the filter is to use of the filled readings, and how late, into ``t``; note what the query lacks."""
    inputs, due = m.filled.size - t.measured.size, m.ticks % twin.update_every == 0
    output_sd_of(twin.filter.sheet, m.filled, t.white, t.coloured)
    for c in range(t.measured.size):
        there = due and t.accepted[inputs + c]
        t.measured[c] = m.filled[inputs + c] if there else np.nan
        t.lag[c] = lag_s[inputs + c] / twin.filter.period_s
    standardise(twin, m.filled, t)
    m.safety.unknown = max(m.safety.unknown - 1, 0)
    for i in range(twin.query.asked.size):
        if m.age_s[twin.query.asked[i]] > UNKNOWN_S:
            m.safety.unknown = m.stream.values.shape[0]  # until the window has forgotten it


@njit(cache=True, error_model="numpy")
def update(weights, twin, memory, measured, lag_s, said, t):  # type: ignore[no-untyped-def]
    """One update of B machines, in place on ``memory`` and ``said``.

    Args:
        weights: (1,) of ``methods.deeponet_kalman.layout.pack``.
        twin: (1,) of ``twin_record``.
        memory: (B,) of ``memory_type``.
        measured: (B, C) readings in the channels' units, inputs first; NaN means missing.
        lag_s: (B, C) seconds, how long before the tick each was read.
        said: (B,) of ``said_type``.
        t: (1,) of ``scratch``.
    """
    w, own, room = weights[0], twin[0], t[0]
    for b in range(memory.size):
        m, out = memory[b], said[b]
        gate_one(m, own.front, measured[b], room.accepted, room.spike, room.confirmed, room.before, room.kept)
        if m.ticks > 0:
            for c in range(m.mask.size):
                room.mask[c] = max(m.mask[c], room.confirmed[c])
            take_in(w, own, m, room.before, room)
        _hand_over(own, m, lag_s[b], room)
        query, now, lag, white, coloured = room.query[:], room.measured[:], room.lag[:], room.white[:], room.coloured[:]
        tick(w, own.filter, m, query, now, lag, white, coloured, INNOVATION_CLIP_SD, out, room.filter)
        m.ticks += 1
        for c in range(m.mask.size):
            m.mask[c] = room.accepted[c]
            out.age_s[c] = m.age_s[c] + lag_s[b, c]
            if room.spike[c]:
                out.flags |= FLAG_SPIKE
            elif not room.accepted[c]:
                out.flags |= FLAG_MISSING
        report_one(own.filter.health, m.z, m.P, own.keep, out.mean, out.cov, out.low, out.high)


@njit(cache=True, error_model="numpy")
def roll_out(weights, twin, memory, inputs, out, t):  # type: ignore[no-untyped-def]
    """Open loop over inputs (B, L, nu), in place: the window takes in the model's own readings, none measured.

    Args:
        out: (B, L, ny) readings.
    """
    w, own, room = weights[0], twin[0], t[0]
    for b in range(memory.size):
        m = memory[b]
        if m.ticks > 0:
            fill(room.mask, m.mask)
            take_in(w, own, m, m.filled, room)
        for c in range(m.filled.size):
            room.mask[c] = 1
        nu = inputs.shape[2]
        for k in range(inputs.shape[1]):
            predict_mean(w, own.filter, m.stream.base[:], m.z[:], room.filter)
            bound_states(own.filter, m.z)
            readings(own.filter, m.z, out[b, k])
            for c in range(nu):
                m.filled[c] = inputs[b, k, c]
            for c in range(out.shape[2]):
                m.filled[nu + c] = out[b, k, c]
            take_in(w, own, m, m.filled, room)
