"""An estimator over one recording without truth: what it foretold, and what its innovations were."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from twinbench.bench.evaluate import fill_gaps
from twinbench.bench.statistics.subject import LEADS_S
from twinbench.data.batch import Batch
from twinbench.machines.coordinates import Array
from twinbench.methods.estimator import Estimator, Sample

FARTHEST_ORIGINS_S = 60.0
"""Between forecasts, at most: one a minute, as in the benchmark. A short or slow recording has more of them."""
LEAST_ORIGINS = 50
"""Forecasts that a recording shall have, where its ticks allow it. Fewer make a recording's score noisier."""


class Watched(NamedTuple):
    """B recordings, K origins, L leads, N ticks, ny outputs.

    Attributes:
        error: (B, K, L, ny) reading less forecast, in the outputs' units; NaN where nothing was read.
        held: (B, K, L, ny) reading less the last reading before the origin, likewise.
        nis: (B, N) dimensionless, over the accepted channels; NaN if none.
        dof: (B, N) dimensionless, channels it is of.
        off: (B, N, ny) dimensionless, innovation over its expected sd; NaN where missing.
    """

    error: Array
    held: Array
    nis: Array
    dof: np.ndarray
    off: Array


def lead_ticks(period_s: float) -> tuple[int, ...]:
    """How many ticks ahead is foretold: 1, 10 and 60 s, or as many ticks where a tick lasts longer than a second.

    Args:
        period_s: from tick to tick.
    """
    return tuple(round(lead / min(period_s, 1.0)) for lead in LEADS_S)


def origins(samples: int, leads: tuple[int, ...], period_s: float) -> np.ndarray:
    """Ticks to foretell from, evenly spaced, the last with its longest lead inside.

    Args:
        samples: of the recording.
        leads: in ticks.
        period_s: from tick to tick.
    """
    room = samples - max(leads)
    every = max(1, min(round(FARTHEST_ORIGINS_S / period_s), room // LEAST_ORIGINS))
    return np.arange(every, room, every)


def watch(estimator: Estimator, batch: Batch) -> Watched:
    """Run an estimator over recordings of equal length, and foretell with the inputs that followed.

    Args:
        estimator: fitted.
        batch: without truth.

    Raises:
        FloatingPointError: a forecast is not finite.
    """
    machine, measured = batch.machine, batch.measured
    nu, (B, N) = len(machine.inputs), measured.shape[:2]
    leads = lead_ticks(machine.sample_period_s)
    begin = origins(N, leads, machine.sample_period_s)
    inputs, last = fill_gaps(measured[..., :nu]), fill_gaps(measured[..., nu:])
    read = np.stack([measured[:, begin + lead, nu:] for lead in leads], axis=2)
    error, held = np.full(read.shape, np.nan), read - last[:, begin][:, :, None]
    nis, dof = np.full((B, N), np.nan), np.zeros((B, N), dtype=np.int64)
    off = np.full((B, N, len(machine.outputs)), np.nan)
    state = estimator.init(B)
    place = {int(tick): k for k, tick in enumerate(begin)}
    for t in range(N):
        state, info = estimator.step(state, Sample(float(batch.time_s[t]), measured[:, t].copy()))
        nis[:, t], dof[:, t] = info.nis, info.accepted.sum(axis=1)
        with np.errstate(invalid="ignore", divide="ignore"):
            off[:, t] = info.innovation / np.sqrt(np.diagonal(info.S, axis1=1, axis2=2))
        if (k := place.get(t)) is not None:
            future = estimator.forecast(state, inputs[:, t + 1 : t + 1 + max(leads)].copy())
            foretold = future[:, [lead - 1 for lead in leads]]
            if not np.isfinite(foretold).all():
                raise FloatingPointError(f"{estimator.name}: a forecast from {batch.time_s[t]:.2f} s is not finite")
            error[:, k] = read[:, k] - foretold
    return Watched(error, held, nis, dof, off)
