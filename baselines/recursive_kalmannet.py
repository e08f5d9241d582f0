"""Recursive KalmanNet: a recurrent network says the gain of a filter of the nominal model (Mortada et al., 2025).

The filter predicts by the recalibrated nominal model and corrects by a gain that no Riccati equation gives: a network
says it at every tick from the innovation, the readings and what the filter thinks of itself. It says the scales of
process and measurement noise too, in the place of the paper's Cholesky factor of what a tick adds, so that the
data sheet and the model's sensitivity to its inputs stay in it. The gain is said in units of the Kalman filter's own,
whose mean is where training begins: a network at random loses the machine. The covariance is Joseph's under that gain,
and the loss is the negative log-likelihood: errors and intervals are learnt together.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, ClassVar

import numpy as np
from numba import njit

from twinbench.baselines.augmented_model import linearise, measure
from twinbench.baselines.layout import layout_of
from twinbench.baselines.learned_gain import GAIN_SPAN, NOISE_SPAN, Rules, correct, seen
from twinbench.baselines.nominal_ekf import NominalEKF
from twinbench.data.batch import Array, Batch
from twinbench.methods.estimator import Info, Sample, State, register
from twinbench.methods.frontend import Memory
from twinbench.methods.kalman import gain, symmetrise
from twinbench.methods.reporting import clean_flags

USUAL_S = 120.0
"""Seconds over which the Kalman filter's own gain is averaged, where training begins: two minutes, in which it settles.
It is a beginning, and training moves on from it."""
USUAL_SEQUENCES = 8
"""Sequences that are averaged over, likewise."""


@njit(cache=True, error_model="numpy")
def _sigmoid(v):  # type: ignore[no-untyped-def]
    return 0.5 * (1.0 + np.tanh(0.5 * v))


@njit(cache=True, error_model="numpy")
def say(net, read, h):  # type: ignore[no-untyped-def]
    """Gain (n, ny), logarithms of the noise's scales (n + ny,) and the state (hidden,), from what is read (F,)."""
    inner, inner_bias, outer, outer_bias, head, head_bias, reach = net
    a, b, n = inner @ read + inner_bias, outer @ h + outer_bias, h.size
    reset, update = _sigmoid(a[:n] + b[:n]), _sigmoid(a[n : 2 * n] + b[n : 2 * n])
    h = (1.0 - update) * np.tanh(a[2 * n :] + reset * b[2 * n :]) + update * h
    said, cut = head @ h + head_bias, reach.size
    multiple = GAIN_SPAN * np.tanh(said[:cut] / GAIN_SPAN).reshape(reach.shape)
    return multiple * reach, NOISE_SPAN * np.tanh(said[cut:] / NOISE_SPAN), h


@njit(cache=True, error_model="numpy")
def _tick(rhs, output, rules, net, values, state, told, info):  # type: ignore[no-untyped-def]
    """One tick of B machines, written into state and info."""
    z, P, h, noise, started = state
    before, now, u_sd, measured, white, coloured = told
    innovation, S, nis = info
    n = z.shape[1]
    for b in range(z.shape[0]):
        if started[b]:
            z[b], F, Q = linearise(rhs, rules.model, z[b], before[b], u_sd[b])
            for i in range(n):
                for j in range(n):
                    Q[i, j] *= np.sqrt(np.exp(noise[b, i]) * np.exp(noise[b, j]))
            P[b] = F @ P[b] @ F.T + Q
            symmetrise(P[b])
        innovation[b], H, R = measure(output, rules.model, z[b], now[b], measured[b], white[b], coloured[b])
        for i in range(len(R)):
            R[i, i] *= np.exp(noise[b, n + i])
        _, S[b], nis[b] = gain(P[b], innovation[b], H, R)
        G, noise[b], h[b] = say(net, seen(rules, values[b], innovation[b], S[b], P[b]), h[b])
        z[b], P[b] = correct(rules, z[b], P[b], innovation[b], H, R, S[b], G)
        started[b] = True


@register
class RecursiveKalmanNet(NominalEKF):
    """The nominal EKF with a learnt gain."""

    name = "recursive_kalmannet"
    says = "filter of the reduced-order model whose gain a recurrent network says"
    implementations = ("compiled",)
    draws = True
    toy_filter = None  # type: ignore[assignment]  # another gain is another filter
    settings: ClassVar[dict[str, Any]] = {
        **{name: value for name, value in NominalEKF.settings.items() if name != "implementation"},
        "iterations": 1200,
        "batch": 32,
        "learning_rate": 3e-4,
        "copies": 3,
        "hidden": 153,
    }
    search_space: ClassVar[dict[str, Sequence[float]]] = {"learning_rate": [1e-4, 3e-4, 1e-3]}
    online = frozenset()
    contract_settings: ClassVar[dict[str, Any]] = {"iterations": 3, "batch": 4, "copies": 1}

    def fit(self, train: Batch, validation: Batch, seed: int) -> None:
        """The nominal EKF's fit, then the gain from training sequences and their re-simulations."""
        import torch

        from twinbench.baselines.gain_training import Carried, Equations, GainNetwork, fit_gain
        from twinbench.baselines.sequences import Schedule
        from twinbench.methods.resimulate import resimulate
        from twinbench.methods.training import seeded, weights_of

        config = self.config
        nominal = NominalEKF(self.machine, **{name: config[name] for name in NominalEKF.settings if name in config})
        nominal.fit(train, validation, seed)
        self.arrays = nominal.arrays
        self._assemble()
        rng, _ = seeded(seed)
        lessons = self.lessons(resimulate(train, rng, config["copies"]))
        network = GainNetwork(config["hidden"], *self._usual(lessons), len(self.machine.channels))
        z, P = (torch.from_numpy(part) for part in self.start(config["batch"]))
        blank = torch.zeros(len(z), config["hidden"]), torch.zeros(len(z), self._said(), dtype=torch.float64)
        equations = Equations(self._rhs, self._output, self._rules)
        schedule = Schedule(config["iterations"], config["batch"], config["learning_rate"])
        losses = fit_gain(network, equations, Carried(z, P, *blank), lessons, rng, schedule)
        self.arrays = {**nominal.arrays, **weights_of(network), "loss": np.array(losses)}
        self.restore()

    def lessons(self, batch: Batch) -> Any:
        """What a gain is learnt from, of sequences with truth."""
        from twinbench.baselines.gain_training import Lessons

        assert batch.truth is not None
        filled, accepted, _ = self._front_end.run(batch.measured)
        layout = layout_of(self.machine)  # lags of sensors are judged, too: the model has them
        truth = layout.targets(batch.truth)
        judged = np.concatenate([layout.columns, np.arange(len(self._model.step), self._sensor)])
        values = self._front_end.standardise(filled).astype(np.float32)
        return Lessons(self.machine, filled, accepted, values, truth.astype(np.float32), judged)

    def _usual(self, lessons: Any) -> tuple[Array, Array]:
        """Mean and root mean square (n, ny) of the Kalman filter's own gain, dimensionless."""
        from twinbench.baselines.gain_training import told_of, usual_gain

        some = slice(USUAL_SEQUENCES), slice(round(USUAL_S / self.machine.sample_period_s) + 1)
        told = told_of(self.machine, lessons.filled[some], lessons.accepted[some])
        mean, square = usual_gain(self._rhs, self._output, self._rules, *self.start(len(told[0])), told)
        return mean, square

    def _said(self) -> int:
        """How many scales of noise are said."""
        return self._size + len(self.machine.outputs)

    def _assemble(self) -> None:
        """All but the network."""
        super().restore()
        _, P = self.start(1)
        self._rules = Rules(self._model, np.sqrt(np.diagonal(P[0])))

    def restore(self) -> None:
        """As the nominal EKF, and the network."""
        self._assemble()
        names = (
            "cell.weight_ih",
            "cell.bias_ih",
            "cell.weight_hh",
            "cell.bias_hh",
            "head.weight",
            "head.bias",
            "reach",
        )
        self._net = tuple(self.arrays[f"net.{name}"].astype(np.float64) for name in names)

    def init(self, batch: int) -> State:
        """States as anywhere in the training split, health as anywhere in the population."""
        z, P = self.start(batch)
        h, noise = np.zeros((batch, self.config["hidden"])), np.zeros((batch, self._said()))
        return self._report(z, P, (h, noise, np.zeros(batch, np.bool_), *self._front_end.init(batch)))

    def step(self, state: State, sample: Sample) -> tuple[State, Info]:
        """Predict by the model, correct by the gain that the network says."""
        cut = len(state.memory) - len(Memory._fields)
        front, clean = self._front_end.step(Memory(*state.memory[cut:]), sample.measured)
        own = tuple(part.copy() for part in state.memory[:cut])
        info = self.blank_info(len(clean.filled))
        values = self._front_end.standardise(clean.filled)
        _tick(self._rhs, self._output, self._rules, self._net, values, own, self.told(clean), info)
        reported = self._report(own[0], own[1], (*own[2:], *front))
        return reported, Info(*info, clean.accepted[:, len(self.machine.inputs) :], clean_flags(clean), clean.age_s)
