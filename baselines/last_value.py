"""The last value held: what the readings say as they stand, with nothing known of the machine.

The states that a sensor reads, itself or through a lag, are what it read last. The others stay at their mean in
training, and health at the filters' prior. A forecast holds the last readings. Intervals of the states are as
wide as the readings' errors in training.
"""

from __future__ import annotations

import numpy as np

from twinbench.baselines.always_prior import AlwaysPrior
from twinbench.data.batch import Array, Batch
from twinbench.machines.machine import Machine
from twinbench.methods.estimator import Z95, Info, Sample, State, no_info, register


@register
class LastValue(AlwaysPrior):
    """Readings as they stand; health at the prior."""

    name = "last_value"
    says = "the last readings held, health at the filters' prior; knows no machine"

    def fit(self, train: Batch, validation: Batch, seed: int) -> None:
        """As ``AlwaysPrior``, and how far each reading is from the state that it reads."""
        super().fit(train, validation, seed)
        assert train.truth is not None
        outputs, states, gains = read_of(self.machine)
        read = train.measured[..., len(self.machine.inputs) :][..., outputs] / gains
        self.arrays["reading.var"] = np.nanmean((read - train.truth.states[..., states]) ** 2, axis=(0, 1))

    def init(self, batch: int) -> State:
        """The prior, until something is read."""
        return super().init(batch)._replace(memory=(np.full((batch, len(self.machine.outputs)), np.nan),))

    def step(self, state: State, sample: Sample) -> tuple[State, Info]:
        """Take what is read; keep the last where nothing is."""
        read = sample.measured[:, len(self.machine.inputs) :].astype(np.float64)
        last = np.where(np.isnan(read), state.memory[0], read)
        known = ~np.isnan(last)
        prior = super().init(len(last))
        mean, cov, low, high = prior.mean, prior.cov, prior.low, prior.high
        for i, at, gain, var in zip(*read_of(self.machine), self.arrays["reading.var"], strict=True):
            rows, half = known[:, i], Z95 * np.sqrt(var)
            mean[rows, at] = last[rows, i] / gain
            low[rows, at], high[rows, at] = mean[rows, at] - half, mean[rows, at] + half
            cov[rows, at, :], cov[rows, :, at] = 0.0, 0.0
            cov[rows, at, at] = var
        return State(mean, cov, low, high, (last,)), no_info(len(last), self.machine)

    def forecast(self, state: State, inputs: Array) -> Array:
        """The last readings, whatever the inputs; those of training until there is one."""
        held = np.where(np.isnan(state.memory[0]), self.machine.observe(state.mean), state.memory[0])
        return np.repeat(held[:, None], inputs.shape[1], axis=1)


def read_of(machine: Machine) -> tuple[np.ndarray, np.ndarray, Array]:
    """The k outputs that read an estimated state, as positions (k,), those states' (k,), and the gains (k,)."""
    follows = {lag.state: lag.follows for lag in machine.lags}
    states = [follows.get(r.state, r.state) for r in machine.readings]
    outputs = [i for i, state in enumerate(states) if state in machine.estimated]
    at = [machine.estimated.index(states[i]) for i in outputs]
    return np.array(outputs), np.array(at), np.array([machine.readings[i].gain for i in outputs])
