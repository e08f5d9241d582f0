"""The last value held: what the readings say as they stand, with nothing known of the machine.

The states that a sensor reads are what it read last: exhaust pressure, gas temperature, flow. The others stay at their
mean in training, and health at the filters' prior. A forecast holds the last readings. Intervals of the states are as
wide as the readings' errors in training.
"""

from __future__ import annotations

import numpy as np

from twinbench.baselines.always_prior import AlwaysPrior
from twinbench.data.batch import ESTIMATE, INPUTS, OUTPUTS, Array, Batch
from twinbench.methods.estimator import Z95, Info, Sample, State, no_info, register
from twinbench.methods.observe import observe
from twinbench.physics.compressor import M_REF_KG_S

READ = [ESTIMATE.p_exh_bar, ESTIMATE.T_gas_K, ESTIMATE.flow_memory]
"""Where the states stand that the sensors read, in the order of OUTPUTS."""
UNIT = np.array([1.0, 1.0, M_REF_KG_S])
"""Readings over these are states: the flow memory is a share of the reference flow."""


@register
class LastValue(AlwaysPrior):
    """Readings as they stand; health at the prior."""

    name = "last_value"
    says = "the last readings held, health at the filters' prior; knows no machine"

    def fit(self, train: Batch, validation: Batch, seed: int) -> None:
        """As ``AlwaysPrior``, and how far each reading is from the state that it reads."""
        super().fit(train, validation, seed)
        assert train.truth is not None
        read = train.measured[..., len(INPUTS) :] / UNIT
        self.arrays["reading.var"] = np.nanmean((read - train.truth.states[..., READ]) ** 2, axis=(0, 1))

    def init(self, batch: int) -> State:
        """The prior, until something is read."""
        return super().init(batch)._replace(memory=(np.full((batch, len(OUTPUTS)), np.nan),))

    def step(self, state: State, sample: Sample) -> tuple[State, Info]:
        """Take what is read; keep the last where nothing is."""
        read = sample.measured[:, len(INPUTS) :].astype(np.float64)
        last = np.where(np.isnan(read), state.memory[0], read)
        known = ~np.isnan(last)
        prior = super().init(len(last))
        mean, cov, low, high = prior.mean, prior.cov, prior.low, prior.high
        half = Z95 * np.sqrt(self.arrays["reading.var"])
        for i, at in enumerate(READ):
            rows = known[:, i]
            mean[rows, at] = last[rows, i] / UNIT[i]
            low[rows, at], high[rows, at] = mean[rows, at] - half[i], mean[rows, at] + half[i]
            cov[rows, at, :], cov[rows, :, at] = 0.0, 0.0
            cov[rows, at, at] = self.arrays["reading.var"][i]
        return State(mean, cov, low, high, (last,)), no_info(len(last))

    def forecast(self, state: State, inputs: Array) -> Array:
        """The last readings, whatever the inputs; those of training until there is one."""
        held = np.where(np.isnan(state.memory[0]), observe(state.mean), state.memory[0])
        return np.repeat(held[:, None], inputs.shape[1], axis=1)
