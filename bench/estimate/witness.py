"""An estimator that is watched: it does what it does, and what it says of each tick's readings is kept."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from twinbench.bench.estimates import Estimates
from twinbench.bench.evaluate import run as evaluate
from twinbench.bench.profile import Evaluation
from twinbench.data.batch import Batch
from twinbench.methods.estimator import Estimator, Info, Sample, State

NO_FORECASTS = 1e9
"""Seconds between origins, so that there are none."""


class Witnessed(NamedTuple):
    """Diagnostics of every tick. B sequences of N ticks.

    Attributes:
        accepted: (B, N, nu + ny) bool: read at this tick, and used.
        nis: (B, N) float32, dimensionless, over the accepted channels; NaN if none.
        dof: (B, N) int8, dimensionless, channels it is of.
        off: (B, N, ny) float32, dimensionless, innovation over its expected sd; NaN where missing.
        innovation: (B, N, ny) float32, in the outputs' units.
        flags: (B, N) int16, dimensionless: bitwise or of the FLAG_ constants.
    """

    accepted: np.ndarray
    nis: np.ndarray
    dof: np.ndarray
    off: np.ndarray
    innovation: np.ndarray
    flags: np.ndarray


@dataclass
class _Witness:
    """Stands in for the estimator where it is stepped; writes into ``seen`` tick by tick."""

    estimator: Estimator
    seen: Witnessed
    tick: int = 0

    def __getattr__(self, name: str) -> object:
        return getattr(self.estimator, name)

    def step(self, state: State, sample: Sample) -> tuple[State, Info]:
        state, info = self.estimator.step(state, sample)
        seen, k, machine = self.seen, self.tick, self.estimator.machine
        used = info.age_s < 0.5 * machine.sample_period_s
        used[:, len(machine.inputs) :] = info.accepted
        seen.accepted[:, k] = used
        seen.nis[:, k], seen.dof[:, k], seen.flags[:, k] = info.nis, info.accepted.sum(axis=1), info.flags
        with np.errstate(invalid="ignore", divide="ignore"):
            seen.off[:, k] = info.innovation / np.sqrt(np.diagonal(info.S, axis1=1, axis2=2))
        seen.innovation[:, k] = info.innovation
        self.tick += 1
        return state, info


def watch(estimator: Estimator, batch: Batch, stride: int, seed: int) -> tuple[Estimates, Witnessed]:
    """Run an estimator over recordings without truth, keeping its estimates and what it said of the readings.

    Args:
        stride: estimates are kept every so many ticks, diagnostics at each.
    """
    shape, outputs = batch.measured.shape[:2], len(batch.machine.outputs)
    seen = Witnessed(
        np.zeros(batch.measured.shape, bool),
        np.full(shape, np.nan, np.float32),
        np.zeros(shape, np.int8),
        np.full((*shape, outputs), np.nan, np.float32),
        np.full((*shape, outputs), np.nan, np.float32),
        np.zeros(shape, np.int16),
    )
    evaluation = Evaluation(stride=stride, origin_every_s=NO_FORECASTS, leads_s=(1.0,))
    return evaluate(_Witness(estimator, seen), batch, evaluation, seed), seen  # type: ignore[arg-type]
