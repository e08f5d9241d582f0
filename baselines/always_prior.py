"""Always at the prior: what knowing nothing but the training recordings scores. It looks at no measurement.

Health stays where the filters begin, the population's mean, with the interval that they begin with; states and readings
stay at their means over training, with their spread. An estimator that errs more has learnt nothing worth
having from its sensors.
"""

from __future__ import annotations

import numpy as np
from scipy.linalg import block_diag

from twinbench.data.batch import Array, Batch
from twinbench.methods.estimator import Estimator, Info, Sample, State, no_info, register
from twinbench.methods.reporting import report


@register
class AlwaysPrior(Estimator):
    """The same answer at every time."""

    name = "always_prior"
    says = "health at the filters' prior, states at their mean in training; looks at no measurement"
    draws = False

    def fit(self, train: Batch, validation: Batch, seed: int) -> None:
        """Means and spreads of the training states, means of the readings."""
        assert train.truth is not None
        states = flat(train.truth.states)[:, : len(self.machine.estimated)]
        self.arrays = {
            "prior.mean": states.mean(axis=0),
            "prior.cov": np.atleast_2d(np.cov(states.T)),
            "outputs.mean": flat(train.truth.outputs).mean(axis=0),
        }

    def init(self, batch: int) -> State:
        """The prior of ``model_ekf``: health as anywhere in the population, states as in training."""
        z = np.concatenate([self.arrays["prior.mean"], self.machine.prior[0]])
        P = block_diag(self.arrays["prior.cov"], self.machine.prior[1])
        rows, covs = np.tile(z, (batch, 1)), np.tile(P, (batch, 1, 1))
        return report(self.machine.coordinates, rows, covs, np.arange(len(z)), ())

    def step(self, state: State, sample: Sample) -> tuple[State, Info]:
        """As before."""
        return state, no_info(len(state.mean), self.machine)

    def forecast(self, state: State, inputs: Array) -> Array:
        """The mean readings of the training recordings, whatever the inputs."""
        return np.tile(self.arrays["outputs.mean"], (*inputs.shape[:2], 1))


def flat(values: Array) -> Array:
    """All ticks of all recordings, (B x N, m).

    Args:
        values: (B, N, m) in any unit.
    """
    return values.reshape(-1, values.shape[-1])
