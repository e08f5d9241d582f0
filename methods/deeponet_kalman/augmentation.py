"""Noise augmentation of training windows: what sensors do, drawn anew each time a window is seen."""

from __future__ import annotations

import numpy as np
import torch
from numba import njit

from twinbench.data.batch import CHANNELS
from twinbench.methods.deeponet_kalman.windows import WindowBatch, WindowSource

DRIFT_SHARE = 0.0016
"""sd of the drift that suction and discharge pressure share; twice the data sheet's."""
JITTER_SAMPLES = 0.1
"""sd of the sampling instants."""
LAG_SAMPLES = 2
"""The discharge temperature may come later by as many."""
DROPOUT = 0.2
"""Share of windows in which the flow sensor is silent for a while."""
BURST_SAMPLES = 20
GAPS, MOST_GAPS = 0.25, 0.4
"""Share of windows in which single readings of every channel are missing, and which share of them at most."""
PRESSURES = ("p_suc_bar", "p_dis_bar")
TEMPERATURE, FLOW = CHANNELS.index("T_dis_K"), CHANNELS.index("m_flow_kg_s")
P_SUC_QUERY = 3


def augmented(window: WindowBatch, source: WindowSource, rng: np.random.Generator) -> WindowBatch:
    """Correlated pressure drift, temperature lag, flow dropout, gaps and time-stamp jitter, on standardised windows."""
    values, masks, query = (part.numpy().copy() for part in (window.values, window.masks, window.query))
    batch, length = masks.shape[:2]
    late = JITTER_SAMPLES * rng.normal(size=(batch, length, 1)).astype(np.float32)
    values[:, 1:] += late * (values[:, 1:] - values[:, :-1])
    lag = rng.integers(LAG_SAMPLES + 1, size=(batch, 1))
    ticks = np.maximum(np.arange(length + 1) - lag, 0)
    values[:, :, TEMPERATURE] = np.take_along_axis(values[:, :, TEMPERATURE], ticks, axis=1)
    drift = DRIFT_SHARE * rng.normal(size=(batch, 1))
    for channel in PRESSURES:
        c = CHANNELS.index(channel)
        at_zero = source.front_end.mean[c] / source.front_end.scale[c]
        values[:, :, c] += drift * (values[:, :, c] + at_zero)
    at_zero = source.query_mean[P_SUC_QUERY] / source.query_scale[P_SUC_QUERY]
    query[:, P_SUC_QUERY] += drift[:, 0] * (query[:, P_SUC_QUERY] + at_zero)
    for b in np.flatnonzero(rng.random(batch) < GAPS):
        gone = rng.random(masks.shape[1:]) < rng.uniform(0.0, MOST_GAPS)
        _hold(values[b], masks[b], gone)
    for b in np.flatnonzero(rng.random(batch) < DROPOUT):
        begin = int(rng.integers(1, length + 1))
        silent = slice(begin, begin + int(rng.integers(1, BURST_SAMPLES + 1)))
        values[b, silent, FLOW] = values[b, begin - 1, FLOW]
        masks[b, silent.start - 1 : silent.stop - 1, FLOW] = 0.0
    return WindowBatch(torch.from_numpy(values), torch.from_numpy(masks), window.slow, torch.from_numpy(query))


@njit(cache=True)
def _hold(values, mask, gone):  # type: ignore[no-untyped-def]
    """Readings (L + 1, 7) of which ``gone`` (L, 7) are missing hold the last one, and their ``mask`` is 0; in place."""
    for k in range(gone.shape[0]):
        for c in range(gone.shape[1]):
            if gone[k, c]:
                values[k + 1, c] = values[k, c]
                mask[k, c] = 0
