"""Where the time of an update in place goes: each stage on its own in compiled loops, as in Fig. 7(a).

- preprocessing: gate, gap filling, standardisation, the sensors' noise at these readings
- operator: the window takes in a sample; branch, trunk and the heads' first layer of it
- sensitivity: the heads with their Jacobian
- filter: covariances, safeguards, correction, report
- synchronisation: what a call from Python costs beside: readings handed in, records unwrapped
"""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np
from numba import njit

from twinbench.bench.latency.timing import ROUNDS
from twinbench.machines.coordinates import Array
from twinbench.methods.deeponet_kalman.cycle import (
    INNOVATION_CLIP_SD,
    said_type,
    scratch,
    standardise,
    take_in,
    update,
)
from twinbench.methods.deeponet_kalman.method import DeepONetKalman
from twinbench.methods.deeponet_kalman.online import Online
from twinbench.methods.deeponet_kalman.stream import heads_with_jacobian
from twinbench.methods.deeponet_kalman.tick import tick
from twinbench.methods.frontend import gate_one
from twinbench.methods.noise import output_sd_of
from twinbench.methods.reporting import report_one

STAGES = ("preprocessing", "operator", "sensitivity", "filter", "synchronisation")
TICKS = 2000
"""In one compiled loop."""


@njit(cache=True, error_model="numpy")
def _whole(weights, twin, memory, said, t, readings, lag):  # type: ignore[no-untyped-def]
    for k in range(readings.shape[0]):
        update(weights, twin, memory, readings[k : k + 1], lag, said, t)


@njit(cache=True, error_model="numpy")
def _preprocessing(weights, twin, memory, said, t, readings, lag):  # type: ignore[no-untyped-def]
    m, own, room = memory[0], twin[0], t[0]
    for k in range(readings.shape[0]):
        gate_one(m, own.front, readings[k], room.accepted, room.spike, room.confirmed, room.before, room.kept)
        output_sd_of(own.filter.sheet, m.filled, room.white, room.coloured)
        standardise(own, m.filled, room)


@njit(cache=True, error_model="numpy")
def _operator(weights, twin, memory, said, t, readings, lag):  # type: ignore[no-untyped-def]
    for k in range(readings.shape[0]):
        take_in(weights[0], twin[0], memory[0], readings[k], t[0])


@njit(cache=True, error_model="numpy")
def _sensitivity(weights, twin, memory, said, t, readings, lag):  # type: ignore[no-untyped-def]
    net = t[0].filter.operator
    for _ in range(readings.shape[0]):
        heads_with_jacobian(weights[0], net, memory[0].stream.base, net.condition)


@njit(cache=True, error_model="numpy")
def _filter_and_sensitivity(weights, twin, memory, said, t, readings, lag):  # type: ignore[no-untyped-def]
    m, own, room, out = memory[0], twin[0], t[0], said[0]
    inputs = readings.shape[1] - room.measured.size
    query, now, lag_of, white, coloured = room.query[:], room.measured[:], room.lag[:], room.white[:], room.coloured[:]
    for k in range(readings.shape[0]):
        for c in range(room.measured.size):
            now[c], lag_of[c] = readings[k, inputs + c], 0.0
        tick(weights[0], own.filter, m, query, now, lag_of, white, coloured, INNOVATION_CLIP_SD, out, room.filter)
        report_one(own.filter.health, m.z, m.P, own.keep, out.mean, out.cov, out.low, out.high)


def stages(twin: DeepONetKalman, filled: Array) -> dict[str, float]:
    """Microseconds of each of STAGES, medians over interleaved rounds.

    Args:
        filled: (N, C) in the channels' units, inputs first, none missing, N at least 2 TICKS.
    """
    kernels = (_whole, _preprocessing, _operator, _sensitivity, _filter_and_sensitivity)
    loops: list[_Loop | _Calls] = [*(_Loop(kernel, twin, filled) for kernel in kernels), _Calls(twin, filled)]
    took = np.array([[loop.us() for loop in loops] for _ in range(ROUNDS)])
    whole, preprocessing, operator, sensitivity, both, called = np.median(took, axis=0)
    values = (preprocessing, operator, sensitivity, both - sensitivity, called - whole)
    return {name: round(float(value), 2) for name, value in zip(STAGES, values, strict=True)}


class _Calls:
    """The update in place, called from Python tick by tick."""

    def __init__(self, twin: DeepONetKalman, filled: Array) -> None:
        self._update, rows = Online(twin).update, list(filled)
        for row in rows[:TICKS]:
            self._update(row)
        self._rows = rows[TICKS : 2 * TICKS]

    def us(self) -> float:
        """Microseconds of one tick, mean over the recording."""
        start = time.perf_counter_ns()
        for row in self._rows:
            self._update(row)
        return (time.perf_counter_ns() - start) / 1e3 / TICKS


class _Loop:
    """One kernel over a recording, on a machine of its own that has run for a while."""

    def __init__(self, kernel: Callable[..., None], twin: DeepONetKalman, filled: Array) -> None:
        self._kernel, lag = kernel, np.zeros((1, twin.parts.channels))
        said, room = np.zeros(1, said_type(twin.parts)), scratch(twin.weights, twin.parts)
        machine = (twin.weights, twin.twin, twin.init(1).memory[0].copy(), said, room)
        before, during = filled[:TICKS].copy(), filled[TICKS : 2 * TICKS].copy()
        _whole(*machine, before, lag)
        self._arguments = (*machine, during, lag)
        self.us()

    def us(self) -> float:
        """Microseconds of one tick, mean over the recording."""
        start = time.perf_counter_ns()
        self._kernel(*self._arguments)
        return (time.perf_counter_ns() - start) / 1e3 / TICKS
