"""GRU + Kalman: a recurrent network predicts state and health, a Kalman filter corrects its error.

The network reads the readings up to the previous tick and predicts the present state, probe
temperature and health, each with its standard deviation; temperatures as the biased sensor sees
them, so that they do not hang on its guess of the bias. What it gets wrong is slow, so the filter
estimates that error in units of those deviations: AR(1), with the stationary covariance that it had
on the validation sequences. That covariance is trusted among what the sensors see (pressures, gas
and probe temperature, flow) and among what they do not (wall, health), not across: half a dozen
sequences are too few for it, and a spurious correlation there does more harm than good (measured).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, ClassVar

import numpy as np

from twinbench.baselines import features
from twinbench.baselines.features import FeatureMemory
from twinbench.baselines.recurrent import TICKS_PER_STEP, ReadoutTwin, SlowFast, SlowFastTwin, TwoRates
from twinbench.data.batch import CHANNELS, HEALTH, SAMPLE_PERIOD_S, STATE, STATES, Array, Batch
from twinbench.methods.estimator import Estimator, Info, Sample, State, register
from twinbench.methods.frontend import FrontEnd, Memory
from twinbench.methods.kalman import linear_filter, update_all
from twinbench.methods.noise import coloured_tau_s, output_sd
from twinbench.methods.reporting import clean_flags, report
from twinbench.physics.compressor import M_REF_KG_S
from twinbench.physics.health import ZETA_LIMIT, theta_and_slope, to_zeta

PRESSURE, GAS, FLOW = STATE.p_exh_bar, STATE.T_gas_K, STATE.flow_memory
PROBE = len(STATES)
ZETA = PROBE + 1
SIZE = ZETA + len(HEALTH)
"""Where the parts of z stand, and how many entries it has."""
CHANNELS_READ = len(CHANNELS)
KEEP = np.r_[0 : len(STATES), ZETA:SIZE]
SEEN = np.isin(np.arange(SIZE), [STATE.p_int_bar, PRESSURE, GAS, FLOW, PROBE])
TOGETHER = SEEN[:, None] == SEEN
"""(11, 11) bool: errors whose covariance is kept."""
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

    def fit(self, train: Batch, validation: Batch, seed: int) -> None:
        """Train on the training sequences and their re-simulations; learn the error from validation."""
        import torch
        from torch.nn import functional

        from twinbench.baselines.sequences import Schedule, fit_sequences, read_out
        from twinbench.methods.resimulate import resimulate
        from twinbench.methods.training import seeded, weights_of

        config = self.config
        rng, _ = seeded(seed)
        front_end = FrontEnd.fit(train)
        more = resimulate(train, rng, config["copies"])
        z = _targets(more)
        mean, scale = z.mean(axis=(0, 1)), z.std(axis=(0, 1))
        read = features.run(front_end.standardise(front_end.run(more.measured)[0]))
        network = self.network(read.shape[-1])

        def loss(predicted: torch.Tensor, wanted: torch.Tensor) -> torch.Tensor:
            centre, log_sd = predicted[..., :SIZE], predicted[..., SIZE:].clamp(*LOG_SD)
            return functional.gaussian_nll_loss(centre, wanted, torch.exp(2.0 * log_sd), eps=1e-6)

        # The reading of one tick answers for the next.
        target = ((z[:, 1:] - mean) / scale).astype(np.float32)
        schedule = Schedule(config["iterations"], config["batch"], config["learning_rate"])
        losses = fit_sequences(network, read[:, :-1], target, loss, rng, schedule)
        own = features.run(front_end.standardise(front_end.run(validation.measured)[0]))
        ticks, out = read_out(network, own[:, :-1], every=5)
        error = (_targets(validation)[:, ticks + 1] - mean) / scale - out[..., :SIZE]
        error /= _sd(out)
        lag = TICKS_PER_STEP // 5
        together = (error[:, lag:] * error[:, :-lag]).mean(axis=(0, 1)) / (error**2).mean(axis=(0, 1))
        self.arrays = {
            **weights_of(network),
            **front_end.arrays(),
            "target.mean": mean,
            "target.scale": scale,
            "error.cov": np.einsum("bti,btj->ij", error, error) / error[..., 0].size * TOGETHER,
            "error.correlation": np.clip(together, 0.01, 0.999),
            "loss": np.array(losses),
        }
        self.restore()

    def network(self, features: int) -> TwoRates:
        """What is trained: of so many features, a mean and a standard deviation of each entry of z."""
        return SlowFast("gru", features, self.config["hidden"], self.config["readout"], 2 * SIZE)

    def twin(self, arrays: dict[str, np.ndarray]) -> ReadoutTwin:
        """The same network for the online cycle.

        Args:
            arrays: by name, what was learnt, of any shape, dimensionless.
        """
        return SlowFastTwin(arrays)

    def restore(self) -> None:
        """Rebuild the network's twin and the error model."""
        a = self.arrays
        self._front_end = FrontEnd.from_arrays(a)
        self._network = self.twin(a)
        keep = a["error.correlation"] ** (1.0 / (TICKS_PER_STEP * self.config["error_memory"]))
        drive = a["error.cov"] - keep[:, None] * a["error.cov"] * keep
        values, vectors = np.linalg.eigh(0.5 * (drive + drive.T))
        self._keep = keep
        # Coloured noise stays for a while: so many ticks count as one.
        self._coloured_ticks = 2.0 * coloured_tau_s() / SAMPLE_PERIOD_S
        self._drive = (vectors * np.maximum(values, 0.0)) @ vectors.T

    def init(self, batch: int) -> State:
        """Where the training sequences usually are, with the network's own error as its uncertainty."""
        z = np.tile(self.arrays["target.mean"], (batch, 1))
        P = np.tile(np.diag(self.arrays["target.scale"] ** 2), (batch, 1, 1))
        memory = (
            np.zeros(batch, np.int64),
            np.zeros((batch, SIZE)),
            np.tile(self.arrays["error.cov"], (batch, 1, 1)),
            np.zeros((batch, features.width(CHANNELS_READ))),
            *self._network.init(batch),
            *features.init(batch, CHANNELS_READ),
            *self._front_end.init(batch),
        )
        return _reported(z, P, memory)

    def step(self, state: State, sample: Sample) -> tuple[State, Info]:
        """Predict from what was read before, correct by the outputs, read the sample."""
        ticks, e, P, read, h, c, *rest = state.memory
        means, front = FeatureMemory(*rest[:2]), Memory(*rest[2:])
        front, clean, values = features.clean_step(self._front_end, front, sample.measured)
        means, present = features.step(means, values)
        first = (ticks == 0)[:, None]
        h, c, read = self._begin(first, h, c, read, present)
        g, sd = self._predicted(h, read)
        e = np.where(first, e, self._keep * e)
        P = np.where(first[..., None], P, self._keep[:, None] * P * self._keep + self._drive)
        z = _bounded(g + sd * e)
        innovation = np.where(clean.accepted, clean.filled, np.nan)[:, 4:] - _readings(z)
        H = np.zeros((len(z), 3, SIZE))
        H[:, 0, PRESSURE] = H[:, 1, PROBE] = 1.0
        H[:, 2, FLOW] = M_REF_KG_S
        H *= sd[:, None]
        white, coloured = output_sd(clean.filled)
        R = np.zeros((len(z), 3, 3))
        R[:, range(3), range(3)] = self.config["noise_inflation"] * (white**2 + self._coloured_ticks * coloured**2)
        e, P, S, nis = update_all(e, P, innovation, H, R, 6.0)
        P[:, range(SIZE), range(SIZE)] += LEAST_DOUBT
        z = _bounded(g + sd * e)
        after = ticks + 1
        h, c = self._advanced(after, h, c, present)
        memory = (after, e, P, present, h, c, *means, *front)
        info = Info(innovation, S, nis, clean.accepted[:, 4:], clean_flags(clean), clean.age_s)
        return _reported(z, sd[:, :, None] * P * sd[:, None], memory), info

    def forecast(self, state: State, inputs: Array) -> Array:
        """Roll the network out on its own readings; the health stays, the estimated error fades."""
        ticks, e, _, read, h, c, *rest = state.memory
        means = FeatureMemory(*rest[:2])
        out = np.empty((len(inputs), inputs.shape[1], 3))
        for k in range(inputs.shape[1]):
            e = self._keep * e
            g, sd = self._predicted(h, read)
            out[:, k] = _readings(g + sd * e)
            values = self._front_end.standardise(np.concatenate([inputs[:, k], out[:, k]], axis=1))
            means, read = features.step(means, values)
            ticks = ticks + 1
            h, c = self._advanced(ticks, h, c, read)
        return out

    def _predicted(self, h: np.ndarray, read: np.ndarray) -> tuple[Array, Array]:
        out = self._network.read(h, read.astype(np.float32))
        scale = self.arrays["target.scale"]
        return out[:, :SIZE] * scale + self.arrays["target.mean"], _sd(out) * scale

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
        """The slow step, once a second."""
        due = (((ticks - 1) % TICKS_PER_STEP == 0) & (ticks > 1))[:, None]
        if not due.any():
            return h, c
        h1, c1 = self._network.step(h, c, read.astype(np.float32))
        return np.where(due, h1, h), np.where(due, c1, c)


def _sd(out: Array) -> Array:
    """Standard deviations (..., 11) in units of the targets' scale."""
    return np.exp(np.clip(out[..., SIZE:], *LOG_SD))


def _targets(batch: Batch) -> Array:
    """(B, N, 11): states, probe temperature, zeta; gas and probe as the biased sensor sees them."""
    assert batch.truth is not None
    z = np.concatenate([batch.truth.states[..., : PROBE + 1], to_zeta(batch.truth.health)], axis=-1)
    z[..., [GAS, PROBE]] += batch.truth.health[..., -1:]
    return z


def _readings(z: Array) -> Array:
    return np.stack([z[:, PRESSURE], z[:, PROBE], M_REF_KG_S * z[:, FLOW]], axis=-1)


def _reported(z: Array, P: Array, memory: tuple[np.ndarray, ...]) -> State:
    """The gas temperature without the sensor's bias."""
    theta, slope = theta_and_slope(z[:, ZETA:])
    free = z.copy()
    free[:, GAS] -= theta[:, -1]
    J = np.tile(np.eye(SIZE), (len(z), 1, 1))
    J[:, GAS, SIZE - 1] = -slope[:, -1]
    return report(free, J @ P @ J.transpose(0, 2, 1), KEEP, memory)


def _bounded(z: Array) -> Array:
    """Health within its coordinates, flow positive."""
    z = z.copy()
    z[:, ZETA:] = np.clip(z[:, ZETA:], -ZETA_LIMIT, ZETA_LIMIT)
    z[:, FLOW] = np.maximum(z[:, FLOW], 0.05)
    return z
