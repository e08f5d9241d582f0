"""One update of DeepONet-Kalman in one compiled call: spike gate, operator, sensitivities, filter, report.

The same function runs one machine in place (``online``) and many in lockstep (``Estimator.step``). All that it touches
lies in five records; nothing is allocated.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

from twinbench.data.batch import CHANNEL, CHANNELS, ESTIMATED, INPUTS, SAMPLE_PERIOD_S, STATES, Array
from twinbench.methods.deeponet_kalman.augmented import readings
from twinbench.methods.deeponet_kalman.forecast import predict_mean
from twinbench.methods.deeponet_kalman.layout import stream_type
from twinbench.methods.deeponet_kalman.model import BIAS, FLOW, MODEL, NOISE, RIVALS, SIZE, ZETA, Model, room_type
from twinbench.methods.deeponet_kalman.records import one_record, record
from twinbench.methods.deeponet_kalman.safeguards import N_OUTPUTS, SAFETY
from twinbench.methods.deeponet_kalman.stream import N_QUERY, fill, push
from twinbench.methods.deeponet_kalman.tick import tick
from twinbench.methods.estimator import FLAG_MISSING, FLAG_SPIKE
from twinbench.methods.frontend import HAMPEL_WINDOW, Fitted, gate_one
from twinbench.methods.kalman import INNOVATION_CLIP_SD
from twinbench.methods.noise import output_sd_of
from twinbench.methods.reporting import report_one
from twinbench.physics.health import map_one

N_CHANNELS, N_INPUTS, N_ESTIMATED = len(CHANNELS), len(INPUTS), len(ESTIMATED)
N_ASKED, UNKNOWN_S = 5, 1.0
"""The first channels, inputs and discharge pressure, make up the operator's query. From this age of one of them on,
what is slow is not corrected: what the outputs say then may be its doing."""
KEEP = np.r_[0 : len(STATES), ZETA:NOISE]
"""Where what is reported stands in z."""


class Scaling(NamedTuple):
    """Standardisation of the operator's query; that of its samples is the front end's.

    Attributes:
        mean: (5,) means of the query in its units: rpm, 1, K, bar, 1.
        scale: (5,) their spreads in the same units.
    """

    mean: Array
    scale: Array


TWIN = record(
    {
        "filter": (MODEL, ()),
        "front": (record({**dict.fromkeys(Fitted._fields[:4], ("f8", (N_CHANNELS,))), "threshold": ("f8", ())}), ()),
        "query": (record(dict.fromkeys(Scaling._fields, ("f8", (N_QUERY,)))), ()),
        "update_every": ("i8", ()),
    }
)
"""What a twin is, beside the operator's weights."""

SAID = record({
    "mean": ("f8", (N_ESTIMATED,)), "cov": ("f8", (N_ESTIMATED, N_ESTIMATED)),
    "low": ("f8", (N_ESTIMATED,)), "high": ("f8", (N_ESTIMATED,)),
    "innovation": ("f8", (N_OUTPUTS,)), "S": ("f8", (N_OUTPUTS, N_OUTPUTS)), "nis": ("f8", ()),
    "accepted": ("u1", (N_OUTPUTS,)), "flags": ("i8", ()), "age_s": ("f8", (N_CHANNELS,)),
})  # fmt: skip
"""What it says after an update: the fields of State and Info."""


def twin_record(filter_: Model, front: Fitted, query: Scaling, update_every: int) -> np.ndarray:
    """(1,) of TWIN."""
    return one_record(TWIN, {"filter": filter_, "front": front, "query": query, "update_every": update_every})


def memory_type(weights: np.ndarray) -> np.dtype[np.void]:
    """What one machine carries from update to update.

    Args:
        weights: (1,) of ``methods.deeponet_kalman.layout.pack``, a record of dimensionless weights.
    """
    return record(
        {
            "recent": ("f8", (HAMPEL_WINDOW, N_CHANNELS)),
            **dict.fromkeys(("filled", "age_s", "outlier", "last", "still"), ("f8", (N_CHANNELS,))),
            "mask": ("f4", (N_CHANNELS,)),  # of the last sample, which the window takes in when the next one is there
            "ticks": ("i8", ()),  # updates so far
            "stream": (stream_type(weights), ()),
            "safety": (SAFETY, ()),
            "z": ("f8", (SIZE,)),
            "P": ("f8", (SIZE, SIZE)),
            "rivals": (RIVALS, ()),
        }
    )


def scratch(weights: np.ndarray) -> np.ndarray:
    """(1,) of room for one update.

    Args:
        weights: (1,) of ``methods.deeponet_kalman.layout.pack``, a record of dimensionless weights.
    """
    return np.zeros(
        1,
        record(
            {
                "filter": (room_type(weights), ()),
                **dict.fromkeys(("accepted", "spike", "confirmed"), ("u1", (N_CHANNELS,))),
                "before": ("f8", (N_CHANNELS,)),
                "kept": ("f8", (HAMPEL_WINDOW,)),
                "white": ("f8", (N_OUTPUTS,)),
                "coloured": ("f8", (N_OUTPUTS,)),
                "measured": ("f8", (N_OUTPUTS,)),
                "lag": ("f8", (N_OUTPUTS,)),
                "sample": ("f4", (N_CHANNELS,)),
                "mask": ("f4", (N_CHANNELS,)),
                "query": ("f4", (N_QUERY,)),
            }
        ),
    )


@njit(cache=True, error_model="numpy")
def standardise(twin, values, t):  # type: ignore[no-untyped-def]
    """What the operator's window takes in of readings (7,), and its query, into ``t.sample`` and ``t.query``."""
    for c in range(N_CHANNELS):
        t.sample[c] = (values[c] - twin.front.mean[c]) / twin.front.scale[c]
    p_suc = values[CHANNEL.p_suc_bar]
    ratio = values[CHANNEL.p_dis_bar] / p_suc
    raw = (values[CHANNEL.N_rpm], ratio, values[CHANNEL.T_suc_K], p_suc, values[CHANNEL.valve])
    for c in range(N_QUERY):
        t.query[c] = (raw[c] - twin.query.mean[c]) / twin.query.scale[c]


@njit(cache=True, error_model="numpy")
def take_in(weights, twin, m, values, t):  # type: ignore[no-untyped-def]
    """Append readings (7,) with ``t.mask`` to the operator's window."""
    standardise(twin, values, t)
    push(weights, m.stream, t.filter.operator, t.sample, t.mask, t.query)


@njit(cache=True, error_model="numpy")
def _update(weights, twin, m, measured, lag_s, said, t):  # type: ignore[no-untyped-def]
    """One machine's update, in place on its memory ``m`` and on what is ``said``."""
    gate_one(m, twin.front, measured, t.accepted, t.spike, t.confirmed, t.before, t.kept)
    if m.ticks > 0:
        for c in range(N_CHANNELS):
            t.mask[c] = max(m.mask[c], t.confirmed[c])
        take_in(weights, twin, m, t.before, t)
    output_sd_of(m.filled, t.white, t.coloured)
    due = m.ticks % twin.update_every == 0
    for c in range(N_OUTPUTS):
        there = due and t.accepted[N_INPUTS + c]
        t.measured[c] = m.filled[N_INPUTS + c] if there else np.nan
        t.lag[c] = lag_s[N_INPUTS + c] / SAMPLE_PERIOD_S
    standardise(twin, m.filled, t)
    m.safety.unknown = max(m.safety.unknown - 1, 0)
    for c in range(N_ASKED):
        if m.age_s[c] > UNKNOWN_S:
            m.safety.unknown = m.stream.values.shape[0]  # until the window has forgotten it
    tick(weights, twin.filter, m, t.query, t.measured, t.lag, t.white, t.coloured, INNOVATION_CLIP_SD, said, t.filter)
    m.ticks += 1
    for c in range(N_CHANNELS):
        m.mask[c] = t.accepted[c]
        said.age_s[c] = m.age_s[c] + lag_s[c]
        if t.spike[c]:
            said.flags |= FLAG_SPIKE
        elif not t.accepted[c]:
            said.flags |= FLAG_MISSING
    report_one(m.z, m.P, KEEP, said.mean, said.cov, said.low, said.high)


@njit(cache=True, error_model="numpy")
def update(weights, twin, memory, measured, lag_s, said, t):  # type: ignore[no-untyped-def]
    """One update of B machines, in place on ``memory`` and ``said``.

    Args:
        weights: (1,) of ``methods.deeponet_kalman.layout.pack``.
        twin: (1,) of ``twin_record``.
        memory: (B,) of ``memory_type``.
        measured: (B, 7) readings in the channels' units, order CHANNELS; NaN means missing.
        lag_s: (B, 7) seconds, how long before the tick each was read.
        said: (B,) of SAID.
        t: (1,) of ``scratch``.
    """
    for b in range(memory.size):
        _update(weights[0], twin[0], memory[b], measured[b], lag_s[b], said[b], t[0])


@njit(cache=True, error_model="numpy")
def roll_out(weights, twin, memory, inputs, out, t):  # type: ignore[no-untyped-def]
    """Open loop over inputs (B, L, 4), in place: the window takes in the model's own readings, none measured.

    Args:
        out: (B, L, 3) readings.
    """
    w, own, room = weights[0], twin[0], t[0]
    for b in range(memory.size):
        m = memory[b]
        if m.ticks > 0:
            fill(room.mask, m.mask)
            take_in(w, own, m, m.filled, room)
        for c in range(N_CHANNELS):
            room.mask[c] = 1
        bias_K, _ = map_one(BIAS - ZETA, m.z[BIAS])
        for k in range(inputs.shape[1]):
            predict_mean(w, own.filter, m.stream.base, m.z, room.filter)
            m.z[FLOW] = max(m.z[FLOW], 0.05)
            readings(m.z, bias_K, out[b, k])
            for c in range(N_INPUTS):
                m.filled[c] = inputs[b, k, c]
            for c in range(N_OUTPUTS):
                m.filled[N_INPUTS + c] = out[b, k, c]
            take_in(w, own, m, m.filled, room)
