"""The mean of training: what knowing the training recordings by heart scores. It looks at no measurement.

Health, states and readings stay at their means over all ticks of training; the intervals hold the central 95 % of
them. Where machines are worn this is less wrong than any filter's prior, which says how they start.
"""

from __future__ import annotations

import numpy as np

from twinbench.baselines.always_prior import flat
from twinbench.data.batch import Array, Batch
from twinbench.methods.estimator import Estimator, Info, Sample, State, no_info, register

CENTRAL_95 = (0.025, 0.975)
"""Quantiles between which an interval lies: those that every estimator promises."""


@register
class TrainingMean(Estimator):
    """The same answer at every time."""

    name = "training_mean"
    says = "health and states at their mean over the training recordings; looks at no measurement"
    draws = False

    def fit(self, train: Batch, validation: Batch, seed: int) -> None:
        """Means, covariance and quantiles of states and health, means of the readings."""
        assert train.truth is not None
        states = flat(train.truth.states)[:, : len(self.machine.estimated)]
        true = np.hstack([states, flat(train.truth.health)])
        low, high = np.quantile(true, CENTRAL_95, axis=0)
        mean = true.mean(axis=0)
        self.arrays = {
            "mean": mean,
            "cov": np.cov(true.T),
            # Of a lopsided quantity the mean may lie beyond a quantile.
            "low": np.minimum(low, mean),
            "high": np.maximum(high, mean),
            "outputs.mean": flat(train.truth.outputs).mean(axis=0),
        }

    def init(self, batch: int) -> State:
        """As training was."""
        mean, cov, low, high = (self.arrays[name] for name in ("mean", "cov", "low", "high"))
        rows = (np.tile(values, (batch, 1)) for values in (mean, low, high))
        mean, low, high = rows
        return State(mean, np.tile(cov, (batch, 1, 1)), low, high)

    def step(self, state: State, sample: Sample) -> tuple[State, Info]:
        """As before."""
        return state, no_info(len(state.mean), self.machine)

    def forecast(self, state: State, inputs: Array) -> Array:
        """The mean readings of the training recordings, whatever the inputs."""
        return np.tile(self.arrays["outputs.mean"], (*inputs.shape[:2], 1))
