"""Run an estimator over recordings in lockstep and keep what it said. The truth never comes here.

An estimator that looks both ways runs like any other, for its forecasts. What it knows afterwards then takes the place
of its estimates.
"""

from __future__ import annotations

import numpy as np

from twinbench.bench.estimates import Estimates, ticks_ahead
from twinbench.bench.profile import Evaluation
from twinbench.data.batch import Array, Batch
from twinbench.machines.machine import Machine
from twinbench.methods.estimator import Estimator, Sample


def run(estimator: Estimator, batch: Batch, evaluation: Evaluation, seed: int) -> Estimates:
    """Step through all sequences at once; forecast from each origin with the inputs that followed.

    Args:
        estimator: fitted.
        batch: without truth.
        evaluation: what is kept.
        seed: of its training, for the record.

    Raises:
        ValueError: the batch still carries its truth.
        FloatingPointError: an estimate or an interval is not finite.
    """
    if batch.truth is not None:
        raise ValueError("an estimator is run on recordings without truth; use batch.without_truth()")
    B, N = batch.measured.shape[:2]
    machine, period_s = batch.machine, batch.machine.sample_period_s
    stored = np.arange(0, N, evaluation.stride)
    leads = ticks_ahead(np.array(evaluation.leads_s), period_s)
    every = round(min(evaluation.origin_every_s / period_s, N))
    origins = _origins(N, every, int(leads.max()))
    inputs = fill_gaps(batch.measured[..., : len(machine.inputs)])
    kept = _room(machine, B, len(stored), len(origins), len(leads))
    said = [kept[name] for name in ("mean", "low", "high")]
    state = estimator.init(B)
    samples = np.ascontiguousarray(batch.measured.transpose(1, 0, 2))
    at = 0
    for k in range(N):
        # Copies: a view would lead to the rest of the recording.
        state, info = estimator.step(state, Sample(float(batch.time_s[k]), samples[k].copy()))
        if k % evaluation.stride == 0:
            i = k // evaluation.stride
            for part, value in zip(said, (state.mean, state.low, state.high), strict=True):
                part[:, i] = value
            kept["nis"][:, i], kept["flags"][:, i] = info.nis, info.flags
            kept["nis_dof"][:, i] = info.accepted.sum(axis=1)
        if at < len(origins) and k == origins[at]:
            _check_finite(estimator, batch.time_s[stored[: k // evaluation.stride + 1]], *said)
            future = inputs[:, k + 1 : k + 1 + leads.max()].copy()
            kept["forecast"][:, at] = estimator.forecast(state, future)[:, leads - 1]
            kept["mean_at_origin"][:, at], kept["cov_at_origin"][:, at] = state.mean, state.cov
            at += 1
    if estimator.two_sided:
        _look_back(estimator, batch.measured, stored, origins, kept)
    _check_finite(estimator, batch.time_s[stored], *said)
    times = {"time_s": batch.time_s[stored], "forecast_time_s": batch.time_s[origins]}
    return Estimates(estimator.name, seed, batch.names, leads_s=np.array(evaluation.leads_s), **times, **kept)


def _room(machine: Machine, machines: int, ticks: int, origins: int, leads: int) -> dict[str, np.ndarray]:
    """Room for what is kept, by the names that it has in ``Estimates``."""
    n = len(machine.quantities)
    return {
        **{name: np.empty((machines, ticks, n), np.float32) for name in ("mean", "low", "high")},
        "nis": np.empty((machines, ticks), np.float32),
        "nis_dof": np.empty((machines, ticks), np.int8),
        "flags": np.empty((machines, ticks), np.int16),
        "forecast": np.empty((machines, origins, leads, len(machine.outputs))),
        "mean_at_origin": np.empty((machines, origins, n)),
        "cov_at_origin": np.empty((machines, origins, n, n)),
        "factors": np.full(n, np.nan),
    }


def _look_back(
    estimator: Estimator, measured: Array, stored: np.ndarray, origins: np.ndarray, kept: dict[str, np.ndarray]
) -> None:
    """Put what is known afterwards in the place of what was said step by step; forecasts stay as they were made."""
    ticks = np.union1d(stored, origins)
    known = estimator.smooth(measured, ticks)
    at_stored, at_origins = np.searchsorted(ticks, stored), np.searchsorted(ticks, origins)
    whose = {"mean": "mean", "low": "low", "high": "high", "mean_at_origin": "mean", "cov_at_origin": "cov"}
    for name, own in whose.items():
        values = getattr(known, own)
        places = at_origins if name.endswith("origin") else at_stored
        kept[name][:] = values.reshape(len(measured), len(ticks), *values.shape[1:])[:, places]


def _check_finite(estimator: Estimator, time_s: Array, *bounds: np.ndarray) -> None:
    """Are the estimates and intervals at these first stored ticks numbers?"""
    broken = ~np.isfinite([values[:, : len(time_s)] for values in bounds]).all(axis=(0, 1, 3))
    if broken.any():
        raise FloatingPointError(
            f"{estimator.name}: the estimate or its interval is not finite at {time_s[broken.argmax()]:.2f} s"
        )


def _origins(samples: int, every: int, longest_lead: int) -> np.ndarray:
    """Ticks to forecast from: the first after one spacing, the last with its longest lead inside."""
    return np.arange(every - 1, samples - longest_lead, every)


def fill_gaps(values: Array) -> Array:
    """Hold the last value over NaN along time, (B, N, C); leading gaps take the first value there is.

    Args:
        values: (B, N, C) in any unit; NaN means missing.
    """
    filled = values.copy()
    index = np.where(np.isnan(values), 0, np.arange(values.shape[1])[None, :, None])
    np.maximum.accumulate(index, axis=1, out=index)
    filled = np.take_along_axis(filled, index, axis=1)
    first = np.take_along_axis(values, np.argmax(~np.isnan(values), axis=1)[:, None], axis=1)
    return np.where(np.isnan(filled), first, filled)
