"""Fixed-lag smoothing: what DeepONet-Kalman knows of a tick a stated while later.

The filter goes forward as ever. A Rauch-Tung-Striebel pass then looks back over the ticks of the delay, with the mean
and the covariance of the modes' mixture: both follow from those of the tick before by one transition.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

from twinbench.machines.coordinates import Array
from twinbench.methods.deeponet_kalman.cycle import said_type, update
from twinbench.methods.deeponet_kalman.parts import Parts
from twinbench.methods.hindsight import Pass, empty_pass, look_back

LOOKS_BACK = 4
"""A delay is cut into as many parts, and one look back serves the ticks of a part. So estimates are known after three
quarters of the delay to all of it. More parts take longer in proportion, and use more of the delay."""


@njit(cache=True, error_model="numpy")
def _forward(weights, twin, memory, measured, said, t, kept, at):  # type: ignore[no-untyped-def]
    """One machine's filter over readings (L, C), in place on ``memory`` (1,); what it passes is ``kept`` from ``at``.

    The function takes plain arrays because it is compiled.
    """
    blind, nu = memory.copy(), measured.shape[1] - said.innovation.shape[1]
    at_the_tick = np.zeros((1, measured.shape[1]))
    for i in range(measured.shape[0]):
        k = at + i
        unread = measured[i : i + 1].copy()
        unread[0, nu:] = np.nan
        blind[0] = memory[0]
        update(weights, twin, blind, unread, at_the_tick, said, t)
        kept.ahead[k], kept.ahead_cov[k], kept.F[k] = blind[0].z, blind[0].P, t[0].filter.F
        update(weights, twin, memory, measured[i : i + 1], at_the_tick, said, t)
        m = memory[0]
        kept.z[k], kept.P[k] = m.z, m.P


class Filter(NamedTuple):
    """What a pass needs of a trained DeepONet-Kalman: the records that ``cycle.update`` takes.

    Attributes:
        weights: (1,) dimensionless.
        twin: (1,) record of the filter, each entry in its unit.
        room: (1,) record of scratch, dimensionless.
        fresh: (1,) record of a machine before the first sample, each entry in its unit.
        parts: of the machine.
    """

    weights: np.ndarray
    twin: np.ndarray
    room: np.ndarray
    fresh: np.ndarray
    parts: Parts


def fixed_lag(model: Filter, measured: Array, ticks: np.ndarray, delay: int) -> tuple[Array, Array]:
    """What is known of some ticks of one recording at most ``delay`` ticks later.

    Args:
        measured: (N, nu + ny) readings in the channels' units, inputs first; NaN means missing.
        ticks: (K,) positions in the recording, in increasing order.

    Returns:
        z (K, n) and its covariance (K, n, n), in the units of z and those squared.
    """
    samples, n = len(measured), model.parts.size
    block, whole = max(delay // LOOKS_BACK, 1), min(delay + 1, samples)
    memory, said = model.fresh.copy(), np.empty(1, said_type(model.parts))
    kept, there = empty_pass(whole, n), 0
    z, P = np.empty((len(ticks), n)), np.empty((len(ticks), n, n))
    for first in range(0, samples, block):
        to = min(first + whole, samples)
        readings = np.ascontiguousarray(measured[first + there : to], dtype=np.float64)
        _forward(model.weights, model.twin, memory, readings, said, model.room, kept, there)
        there = to - first
        seen = Pass(*(part[:there] for part in kept))
        seen = seen._replace(z=seen.z.copy(), P=seen.P.copy())  # the filter's own are needed for the next part
        look_back(seen)
        own = slice(*np.searchsorted(ticks, (first, first + block)))
        z[own], P[own] = seen.z[ticks[own] - first], seen.P[ticks[own] - first]
        there = max(there - block, 0)
        for part in kept:
            part[:there] = part[block : block + there].copy()
    return z, P
