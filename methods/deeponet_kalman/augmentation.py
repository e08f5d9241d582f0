"""Noise augmentation of training windows: what sensors do, drawn anew each time a window is seen."""

from __future__ import annotations

import numpy as np
import torch
from numba import njit

from twinbench.machines.machine import Machine
from twinbench.methods.deeponet_kalman.windows import WindowBatch, WindowSource

DRIFT_FACTOR = 2.0
"""Times the data sheet's: the sd of the drift that sensors share."""
JITTER_SAMPLES = 0.1
"""sd of the sampling instants."""
LAG_SAMPLES = 2
"""Outputs whose probes lag may come later by as many."""
DROPOUT = 0.2
"""Share of windows in which a sensor is silent for a while."""
BURST_SAMPLES = 20
GAPS, MOST_GAPS = 0.25, 0.4
"""Share of windows in which single readings of every channel are missing, and which share of them at most."""


def lagging(machine: Machine) -> np.ndarray:
    """Channels of outputs whose probes lag."""
    lags = {lag.state for lag in machine.lags}
    return np.array([machine.channels.index(r.output) for r in machine.readings if r.state in lags], np.int64)


def silent_channels(machine: Machine) -> np.ndarray:
    """Channels whose sensors may fall silent for a while."""
    return np.array([machine.channels.index(name) for name in machine.silent or machine.outputs])


def query_shares(machine: Machine) -> np.ndarray:
    """Of every entry of the query: the share of its value that one sd of the common drift is; quotients lose it."""
    shares = dict(zip(machine.channels, machine.drift_shares, strict=True)) | {"": 0.0}
    parts = [expression.partition("/") for expression in machine.operating]
    return np.array([shares[above] - shares[below] for above, _, below in parts])


def augmented(window: WindowBatch, source: WindowSource, rng: np.random.Generator) -> WindowBatch:
    """Common drift, a probe's lag, a silent sensor, gaps and time-stamp jitter, on standardised windows."""
    values, masks, query = (part.numpy().copy() for part in (window.values, window.masks, window.query))
    (batch, length), machine = masks.shape[:2], source.machine
    late = JITTER_SAMPLES * rng.normal(size=(batch, length, 1)).astype(np.float32)
    values[:, 1:] += late * (values[:, 1:] - values[:, :-1])
    lag = rng.integers(LAG_SAMPLES + 1, size=(batch, 1))
    ticks = np.maximum(np.arange(length + 1) - lag, 0)
    for c in lagging(machine):
        values[:, :, c] = np.take_along_axis(values[:, :, c], ticks, axis=1)
    drift = rng.normal(size=(batch, 1))
    for c in np.flatnonzero(machine.drift_shares):
        at_zero = source.front_end.mean[c] / source.front_end.scale[c]
        values[:, :, c] += DRIFT_FACTOR * machine.drift_shares[c] * drift * (values[:, :, c] + at_zero)
    shares = query_shares(machine)
    for i in np.flatnonzero(shares):
        at_zero = source.query_mean[i] / source.query_scale[i]
        query[:, i] += DRIFT_FACTOR * shares[i] * drift[:, 0] * (query[:, i] + at_zero)
    for b in np.flatnonzero(rng.random(batch) < GAPS):
        gone = rng.random(masks.shape[1:]) < rng.uniform(0.0, MOST_GAPS)
        _hold(values[b], masks[b], gone)
    may = silent_channels(machine)
    for b in np.flatnonzero(rng.random(batch) < DROPOUT):
        begin = int(rng.integers(1, length + 1))
        silent = slice(begin, begin + int(rng.integers(1, BURST_SAMPLES + 1)))
        c = may[rng.integers(len(may))] if len(may) > 1 else may[0]
        values[b, silent, c] = values[b, begin - 1, c]
        masks[b, silent.start - 1 : silent.stop - 1, c] = 0.0
    return WindowBatch(torch.from_numpy(values), torch.from_numpy(masks), window.slow, torch.from_numpy(query))


@njit(cache=True)
def _hold(values, mask, gone):  # type: ignore[no-untyped-def]
    """Readings (L + 1, C) of which ``gone`` (L, C) are missing hold the last one, and their ``mask`` is 0; in place."""
    for k in range(gone.shape[0]):
        for c in range(gone.shape[1]):
            if gone[k, c]:
                values[k + 1, c] = values[k, c]
                mask[k, c] = 0
