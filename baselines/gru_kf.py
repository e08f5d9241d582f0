"""GRU + Kalman: a recurrent network predicts state and health, a Kalman filter corrects its error.

The network reads the readings up to the previous tick and predicts the present state, what lags it
in a sensor, and health, each with its standard deviation; states as a biased sensor sees
them, so that they do not hang on its guess of the bias. What it gets wrong is slow, so the filter
estimates that error in units of those deviations: AR(1), with the stationary covariance that it had
on the validation sequences. That covariance is trusted among what the sensors see and among what they do not (of the
compressor: the wall, health), not across: half a dozen sequences are too few for it, and a spurious correlation there
does more harm than good (measured).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, ClassVar

import numpy as np

from twinbench.baselines import features
from twinbench.baselines.features import FeatureMemory
from twinbench.baselines.layout import layout_of
from twinbench.baselines.recurrent import ReadoutTwin, SlowFast, SlowFastTwin, TwoRates, ticks_per_step
from twinbench.data.batch import Array, Batch
from twinbench.machines.compressor import COMPRESSOR
from twinbench.machines.machine import Machine
from twinbench.methods.estimator import Estimator, Info, Sample, State, register
from twinbench.methods.frontend import FrontEnd, Memory
from twinbench.methods.kalman import linear_filter, update_all
from twinbench.methods.noise import coloured_tau_s, output_sd, sheet_of
from twinbench.methods.reporting import clean_flags, report

LOG_SD = (-6.0, 3.0)
LEAST_DOUBT = 1e-9
"""Variance that is added after every correction, in units of the network's own: where a reading's noise is relative to
a reading of nothing, round-off would leave less than none. Ten times more would widen intervals by 0.2 % at most."""


@register
class GRUKalman(Estimator):
    """The strongest recurrent baseline of the paper."""

    name = "gru_kf"
    says = "recurrent network, its error estimated by a Kalman filter"
    toy_filter = staticmethod(linear_filter)
    settings: ClassVar[dict[str, Any]] = {
        "iterations": 6000,
        "batch": 16,
        "learning_rate": 3e-3,
        "copies": 3,
        "hidden": 128,
        "readout": 180,
        "noise_inflation": 4.139,
        "error_memory": 15.5,
    }
    search_space: ClassVar[dict[str, Sequence[float]]] = {
        "learning_rate": [1.5e-3, 3e-3, 6e-3],
        "noise_inflation": (1.0, 100.0),
        "error_memory": (0.2, 50.0),
    }
    online = frozenset({"noise_inflation", "error_memory"})
    contract_settings: ClassVar[dict[str, Any]] = {"iterations": 6, "batch": 4, "copies": 1}

    def __init__(self, machine: Machine = COMPRESSOR, **settings: Any) -> None:
        super().__init__(machine, **settings)
        self._layout = layout_of(machine, as_read=True)
        self._ticks, self._kept = ticks_per_step(machine), features.keep_of(machine)

    def fit(self, train: Batch, validation: Batch, seed: int) -> None:
        """Train on the training sequences and their re-simulations; learn the error from validation."""
        import torch
        from torch.nn import functional

        from twinbench.baselines.sequences import Schedule, apart, fit_sequences, read_out
        from twinbench.methods.resimulate import resimulate
        from twinbench.methods.training import seeded, weights_of

        config, size = self.config, self._layout.size
        rng, _ = seeded(seed)
        front_end = FrontEnd.fit(train)
        more = resimulate(train, rng, config["copies"])
        z = self._targets(more)
        mean, scale = z.mean(axis=(0, 1)), z.std(axis=(0, 1))
        read = features.run(front_end.standardise(front_end.run(more.measured)[0]), self._kept)
        network = self.network(read.shape[-1])

        def loss(predicted: torch.Tensor, wanted: torch.Tensor) -> torch.Tensor:
            centre, log_sd = predicted[..., :size], predicted[..., size:].clamp(*LOG_SD)
            return functional.gaussian_nll_loss(centre, wanted, torch.exp(2.0 * log_sd), eps=1e-6)

        # The reading of one tick answers for the next.
        target = ((z[:, 1:] - mean) / scale).astype(np.float32)
        schedule = Schedule(config["iterations"], config["batch"], config["learning_rate"])
        losses = fit_sequences(network, read[:, :-1], target, loss, rng, schedule, self._ticks)
        own = features.run(front_end.standardise(front_end.run(validation.measured)[0]), self._kept)
        every = apart(self._ticks)
        ticks, out = read_out(network, own[:, :-1], self._ticks, every)
        error = (self._targets(validation)[:, ticks + 1] - mean) / scale - out[..., :size]
        error /= self._sd(out)
        lag = self._ticks // every
        stays = (error[:, lag:] * error[:, :-lag]).mean(axis=(0, 1)) / (error**2).mean(axis=(0, 1))
        seen = self._layout.seen
        together = seen[:, None] == seen
        self.arrays = {
            **weights_of(network),
            **front_end.arrays(),
            "target.mean": mean,
            "target.scale": scale,
            "error.cov": np.einsum("bti,btj->ij", error, error) / error[..., 0].size * together,
            "error.correlation": np.clip(stays, 0.01, 0.999),
            "loss": np.array(losses),
        }
        self.restore()

    def network(self, features: int) -> TwoRates:
        """What is trained: of so many features, a mean and a standard deviation of each entry of z."""
        return SlowFast("gru", features, self.config["hidden"], self.config["readout"], 2 * self._layout.size)

    def twin(self, arrays: dict[str, np.ndarray]) -> ReadoutTwin:
        """The same network for the online cycle.

        Args:
            arrays: by name, what was learnt, of any shape, dimensionless.
        """
        return SlowFastTwin(arrays)

    def restore(self) -> None:
        """Rebuild the network's twin and the error model."""
        a = self.arrays
        self._front_end, self._sheet = FrontEnd.from_arrays(a), sheet_of(self.machine)
        self._network = self.twin(a)
        keep = a["error.correlation"] ** (1.0 / (self._ticks * self.config["error_memory"]))
        drive = a["error.cov"] - keep[:, None] * a["error.cov"] * keep
        values, vectors = np.linalg.eigh(0.5 * (drive + drive.T))
        self._keep = keep
        # Coloured noise stays for a while: so many ticks count as one.
        self._coloured_ticks = np.maximum(2.0 * coloured_tau_s(self.machine) / self.machine.sample_period_s, 1.0)
        self._drive = (vectors * np.maximum(values, 0.0)) @ vectors.T

    def init(self, batch: int) -> State:
        """Where the training sequences usually are, with the network's own error as its uncertainty."""
        z = np.tile(self.arrays["target.mean"], (batch, 1))
        P = np.tile(np.diag(self.arrays["target.scale"] ** 2), (batch, 1, 1))
        channels = len(self.machine.channels)
        memory = (
            np.zeros(batch, np.int64),
            np.zeros((batch, self._layout.size)),
            np.tile(self.arrays["error.cov"], (batch, 1, 1)),
            np.zeros((batch, features.width(channels))),
            *self._network.init(batch),
            *features.init(batch, channels),
            *self._front_end.init(batch),
        )
        return self._reported(z, P, memory)

    def step(self, state: State, sample: Sample) -> tuple[State, Info]:
        """Predict from what was read before, correct by the outputs, read the sample."""
        layout, nu, ny = self._layout, len(self.machine.inputs), len(self.machine.outputs)
        ticks, e, P, read, h, c, *rest = state.memory
        means, front = FeatureMemory(*rest[:2]), Memory(*rest[2:])
        front, clean, values = features.clean_step(self._front_end, front, sample.measured)
        means, present = features.step(means, values, self._kept)
        first = (ticks == 0)[:, None]
        h, c, read = self._begin(first, h, c, read, present)
        g, sd = self._predicted(h, read)
        e = np.where(first, e, self._keep * e)
        P = np.where(first[..., None], P, self._keep[:, None] * P * self._keep + self._drive)
        z = layout.bounded(g + sd * e)
        innovation = np.where(clean.accepted, clean.filled, np.nan)[:, nu:] - layout.readings(z)
        H = layout.slopes(z) * sd[:, None]
        white, coloured = output_sd(self._sheet, clean.filled)
        R = np.zeros((len(z), ny, ny))
        R[:, range(ny), range(ny)] = self.config["noise_inflation"] * (white**2 + self._coloured_ticks * coloured**2)
        e, P, S, nis = update_all(e, P, innovation, H, R, 6.0)
        P[:, range(layout.size), range(layout.size)] += LEAST_DOUBT
        z = layout.bounded(g + sd * e)
        after = ticks + 1
        h, c = self._advanced(after, h, c, present)
        memory = (after, e, P, present, h, c, *means, *front)
        info = Info(innovation, S, nis, clean.accepted[:, nu:], clean_flags(clean), clean.age_s)
        return self._reported(z, sd[:, :, None] * P * sd[:, None], memory), info

    def forecast(self, state: State, inputs: Array) -> Array:
        """Roll the network out on its own readings; the health stays, the estimated error fades."""
        ticks, e, _, read, h, c, *rest = state.memory
        means = FeatureMemory(*rest[:2])
        out = np.empty((*inputs.shape[:2], len(self.machine.outputs)))
        for k in range(inputs.shape[1]):
            e = self._keep * e
            g, sd = self._predicted(h, read)
            out[:, k] = self._layout.readings(g + sd * e)
            values = self._front_end.standardise(np.concatenate([inputs[:, k], out[:, k]], axis=1))
            means, read = features.step(means, values, self._kept)
            ticks = ticks + 1
            h, c = self._advanced(ticks, h, c, read)
        return out

    def _predicted(self, h: np.ndarray, read: np.ndarray) -> tuple[Array, Array]:
        out = self._network.read(h, read.astype(np.float32))
        scale = self.arrays["target.scale"]
        return out[:, : self._layout.size] * scale + self.arrays["target.mean"], self._sd(out) * scale

    def _sd(self, out: Array) -> Array:
        """Standard deviations (..., size) in units of the targets' scale."""
        return np.exp(np.clip(out[..., self._layout.size :], *LOG_SD))

    def _targets(self, batch: Batch) -> Array:
        assert batch.truth is not None
        return self._layout.targets(batch.truth)

    def _reported(self, z: Array, P: Array, memory: tuple[np.ndarray, ...]) -> State:
        """Without the biases of the sensors."""
        return report(self.machine.coordinates, *self._layout.freed(z, P), self._layout.keep, memory)

    def _begin(
        self, first: np.ndarray, h: np.ndarray, c: np.ndarray, read: np.ndarray, present: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Before anything was read, the first sample stands in for the one before it."""
        if not first.any():
            return h, c, read
        h1, c1 = self._network.step(h, c, present.astype(np.float32))
        return np.where(first, h1, h), np.where(first, c1, c), np.where(first, present, read)

    def _advanced(
        self, ticks: np.ndarray, h: np.ndarray, c: np.ndarray, read: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """The slow step, where one is due."""
        due = (((ticks - 1) % self._ticks == 0) & (ticks > 1))[:, None]
        if not due.any():
            return h, c
        h1, c1 = self._network.step(h, c, read.astype(np.float32))
        return np.where(due, h1, h), np.where(due, c1, c)
