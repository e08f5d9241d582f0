"""Always at the prior: what knowing nothing but the training recordings scores. It looks at no measurement.

Health stays where the filters begin, the population's mean, with the interval that they begin with; states and readings
stay at their means over training, with their spread. An estimator that errs more has learnt nothing worth
having from its sensors.
"""

from __future__ import annotations

import numpy as np

from twinbench.data.batch import HEALTH, OUTPUTS, STATES, Array, Batch
from twinbench.data.population import PRIOR_COV, PRIOR_MEAN
from twinbench.methods.estimator import Estimator, Info, Sample, State, no_info, register
from twinbench.methods.reporting import report

N = len(STATES) + len(HEALTH)


@register
class AlwaysPrior(Estimator):
    """The same answer at every time."""

    name = "always_prior"
    says = "health at the filters' prior, states at their mean in training; looks at no measurement"
    draws = False

    def fit(self, train: Batch, validation: Batch, seed: int) -> None:
        """Means and spreads of the training states, means of the readings."""
        assert train.truth is not None
        states = train.truth.states[..., : len(STATES)].reshape(-1, len(STATES))
        self.arrays = {
            "prior.mean": states.mean(axis=0),
            "prior.cov": np.cov(states.T),
            "outputs.mean": train.truth.outputs.reshape(-1, len(OUTPUTS)).mean(axis=0),
        }

    def init(self, batch: int) -> State:
        """The prior of ``model_ekf``: health as anywhere in the population, states as in training."""
        z, P = np.zeros((batch, N)), np.tile(np.eye(N), (batch, 1, 1))
        z[:, : len(STATES)] = self.arrays["prior.mean"]
        P[:, : len(STATES), : len(STATES)] = self.arrays["prior.cov"]
        z[:, len(STATES) :], P[:, len(STATES) :, len(STATES) :] = PRIOR_MEAN, PRIOR_COV
        return report(z, P, np.arange(N), ())

    def step(self, state: State, sample: Sample) -> tuple[State, Info]:
        """As before."""
        return state, no_info(len(state.mean))

    def forecast(self, state: State, inputs: Array) -> Array:
        """The mean readings of the training recordings, whatever the inputs."""
        return np.tile(self.arrays["outputs.mean"], (*inputs.shape[:2], 1))
