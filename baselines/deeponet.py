"""Standalone DeepONet: the operator answers alone, no filter corrects it.

The branch reads the measurement window and the running means; the trunk is asked for a time from
now to a minute ahead, under the inputs of that time. Their product gives the states, the probe's
temperature and the health coordinates at once, so a forecast of any length is one evaluation. Its
intervals are the errors that it made on the validation sequences.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, ClassVar

import numpy as np

from twinbench.baselines import features
from twinbench.baselines.features import FeatureMemory
from twinbench.data.batch import CHANNELS, HEALTH, INPUTS, SAMPLE_PERIOD_S, STATE, STATES, Array, Batch
from twinbench.methods.estimator import Estimator, Info, Sample, State, register
from twinbench.methods.frontend import FrontEnd, Memory
from twinbench.methods.kalman import update_all
from twinbench.methods.noise import output_sd
from twinbench.methods.operator import KERNEL, TOKENS, WINDOW
from twinbench.methods.reporting import clean_flags, report
from twinbench.physics.compressor import M_REF_KG_S
from twinbench.physics.health import ZETA_LIMIT, theta_and_slope, to_zeta

PRESSURE, FLOW = STATE.p_exh_bar, STATE.flow_memory
PROBE = len(STATES)
ZETA = PROBE + 1
SIZE = ZETA + len(HEALTH)
"""Where the parts of z stand, and how many entries it has."""
KEEP = np.r_[0 : len(STATES), ZETA:SIZE]
N_IN = len(INPUTS)
LONGEST_LEAD_S = 60.0
TIMES_S = (0.2, 2.0, 20.0)
"""The trunk sees the query time as its share of these, saturating, and of the longest."""
N_QUERY = len(TIMES_S) + 1 + 2 * N_IN


def network_of(widths: dict[str, int]) -> Any:
    """Branch, trunk and their product."""
    import torch
    from torch import Tensor, nn
    from torch.nn import functional

    from twinbench.methods.operator import Branch, second_moment_norm

    class Network(nn.Module):
        def __init__(self) -> None:
            super().__init__()
            slow = features.width(len(CHANNELS)) - len(CHANNELS)
            latents, trunk = widths["latents"], widths["trunk"]
            self.branch = Branch(widths["width_1"], widths["width_2"], 32, latents, slow, len(CHANNELS))
            self.hidden_1 = nn.Linear(N_QUERY, trunk)
            self.hidden_2 = nn.Linear(trunk, latents)
            self.out = nn.Linear(latents, SIZE)

        def forward(self, branch: Tensor, query: Tensor) -> Tensor:
            """Answers (B, Q, 11) of latents (B, latents) to queries (B, Q, 12)."""
            trunk = self.hidden_2(functional.silu(self.hidden_1(query)))
            return self.out(branch.unsqueeze(1) * second_moment_norm(torch.tanh(trunk)))

    return Network()


@register
class DeepONet(Estimator):
    """The operator without measurement correction."""

    name = "deeponet"
    says = "operator network alone, no filter"
    window = WINDOW
    settings: ClassVar[dict[str, Any]] = {
        "iterations": 10000,
        "windows": 160,
        "queries": 4,
        "learning_rate": 9e-3,
        "copies": 3,
        "width_1": 48,
        "width_2": 96,
        "latents": 128,
        "trunk": 176,
        "inflation": 1.041,
    }
    search_space: ClassVar[dict[str, Sequence[float]]] = {
        "learning_rate": [3e-3, 9e-3, 2.7e-2],
        "inflation": (0.5, 3.0),
    }
    online = frozenset({"inflation"})
    contract_settings: ClassVar[dict[str, Any]] = {"iterations": 20, "windows": 16, "copies": 1}

    def fit(self, train: Batch, validation: Batch, seed: int) -> None:
        """Train on the training sequences and their re-simulations; learn the error from validation."""
        import torch
        from torch.nn import functional

        from twinbench.methods.resimulate import resimulate
        from twinbench.methods.training import adamw, seeded, weights_of

        config = self.config
        rng, _ = seeded(seed)
        front_end = FrontEnd.fit(train)
        source = _Source(resimulate(train, rng, config["copies"]), front_end)
        mean, scale = source.target.mean(axis=(0, 1)), source.target.std(axis=(0, 1))
        network = network_of(config)

        def loss(_: int) -> torch.Tensor:
            sequence = rng.integers(source.target.shape[0], size=config["windows"])
            sample = rng.integers(source.target.shape[1], size=config["windows"])
            ahead = np.round(20 * LONGEST_LEAD_S * rng.random((config["windows"], config["queries"])) ** 3).astype(int)
            ahead[:, 0] = rng.integers(2, size=config["windows"])
            later = np.minimum(sample[:, None] + ahead, source.target.shape[1] - 1)
            latent = network.branch(*(torch.from_numpy(part) for part in source.window(sequence, sample)))
            query = source.query(sequence[:, None], sample[:, None], later)
            wanted = (source.target[sequence[:, None], later] - mean) / scale
            said = network(latent, torch.from_numpy(query.astype(np.float32)))
            return functional.smooth_l1_loss(said, torch.from_numpy(wanted.astype(np.float32)), beta=0.1)

        losses = adamw(network, loss, config["iterations"], config["learning_rate"])
        self.arrays = {
            **weights_of(network),
            **front_end.arrays(),
            "target.mean": mean,
            "target.scale": scale,
            "error.cov": np.eye(SIZE),
            "loss": np.array(losses),
        }
        self.restore()
        held = _Source(validation, front_end)
        samples = np.arange(WINDOW, held.target.shape[1], 20)
        error = np.empty((len(validation), len(samples), SIZE))
        for b in range(len(validation)):
            rows = np.full(len(samples), b)
            latent = self._branch(*held.window(rows, samples))
            query = held.query(rows[:, None], samples[:, None], samples[:, None])
            error[b] = held.target[b, samples] - self._answer(latent, query)[:, 0]
        flat = error.reshape(-1, SIZE)
        self.arrays["error.cov"] = flat.T @ flat / len(flat)
        self.restore()

    def restore(self) -> None:
        """Rebuild the network's twin."""
        self._front_end = FrontEnd.from_arrays(self.arrays)
        self._w = {n.removeprefix("net."): a for n, a in self.arrays.items() if n.startswith("net.")}
        self._cov = self.config["inflation"] ** 2 * self.arrays["error.cov"]

    def init(self, batch: int) -> State:
        """Where the training sequences usually are."""
        z = np.tile(self.arrays["target.mean"], (batch, 1))
        P = np.tile(self._cov + np.diag(self.arrays["target.scale"] ** 2), (batch, 1, 1))
        memory = (
            np.zeros((batch, WINDOW + 1, len(CHANNELS)), np.float32),
            np.zeros((batch, WINDOW, len(CHANNELS)), np.float32),
            np.zeros((batch, self.config["latents"]), np.float32),
            *features.init(batch, len(CHANNELS)),
            *self._front_end.init(batch),
        )
        return report(z, P, KEEP, memory)

    def step(self, state: State, sample: Sample) -> tuple[State, Info]:
        """Ask the operator for now; what it had said a tick ago gives the innovation."""
        values, masks, latent, *rest = state.memory
        means, front = FeatureMemory(*rest[:2]), Memory(*rest[2:])
        fresh = ~means.started
        front, clean, standard = features.clean_step(self._front_end, front, sample.measured)
        means, read = features.step(means, standard)
        values = _shifted(values, standard, fresh)
        masks = _shifted(masks, clean.accepted, fresh)
        inputs = standard[:, :N_IN]
        before = latent
        latent = self._branch(values, masks, read[:, len(CHANNELS) :])
        before = np.where(fresh[:, None], latent, before)
        both = np.concatenate([before, latent])
        ahead_s = np.repeat([SAMPLE_PERIOD_S, 0.0], len(latent))
        inputs = np.concatenate([inputs, inputs])
        said = _bounded(self._answer(both, _query(ahead_s, inputs, inputs)[:, None])[:, 0])
        foretold, z = said[: len(latent)], said[len(latent) :]
        P = np.tile(self._cov, (len(z), 1, 1))
        y, H = _readings(foretold)
        innovation = np.where(clean.accepted[:, 4:], clean.filled[:, 4:] - y, np.nan)
        R = np.zeros((len(z), 3, 3))
        white, coloured = output_sd(clean.filled)
        R[:, range(3), range(3)] = white**2 + coloured**2
        _, _, S, nis = update_all(foretold, P, innovation, H, R, np.inf)
        info = Info(innovation, S, nis, clean.accepted[:, 4:], clean_flags(clean), clean.age_s)
        return report(z, P, KEEP, (values, masks, latent, *means, *front)), info

    def forecast(self, state: State, inputs: Array) -> Array:
        """One query per tick ahead, a minute at most; beyond it the query time stays a minute."""
        latent = state.memory[2]
        front = self._front_end
        standard = (inputs - front.mean[:N_IN]) / front.scale[:N_IN]
        count = np.arange(1, inputs.shape[1] + 1)
        mean = np.cumsum(standard, axis=1) / count[:, None]
        ahead = np.minimum(count * SAMPLE_PERIOD_S, LONGEST_LEAD_S)
        query = _query(np.broadcast_to(ahead, standard.shape[:2]), standard, mean)
        z = _bounded(self._answer(latent, query))
        bias_K = state.mean[:, -1:]
        return np.stack([z[..., PRESSURE], z[..., PROBE] + bias_K, M_REF_KG_S * z[..., FLOW]], axis=-1)

    def _branch(self, values: np.ndarray, masks: np.ndarray, slow: np.ndarray) -> np.ndarray:
        """``methods.operator.Branch`` in NumPy, (B, latents)."""
        w = self._w

        def linear(name: str, x: np.ndarray) -> np.ndarray:
            return x @ w[f"branch.{name}.weight"].T + w.get(f"branch.{name}.bias", np.float32(0.0))

        batch, window = len(values), values[:, 1:]
        columns = np.concatenate([window, window - values[:, :-1], masks], axis=-1)
        first = _silu(linear("block_1", columns.reshape(batch, WINDOW // KERNEL, -1)))
        second = _silu(linear("block_2", first.reshape(batch, TOKENS, -1)))
        tokens = second + _silu(linear("mix_2", second))
        gated = np.tanh(linear("gate_tanh", tokens)) * _sigmoid(linear("gate_sigmoid", tokens))
        score = linear("score", gated)[..., 0] + w["branch.position"]
        weight = np.exp(score - score.max(axis=-1, keepdims=True))
        weight /= weight.sum(axis=-1, keepdims=True)
        attended = (weight[..., None] * tokens).sum(axis=1)
        mean = window.mean(axis=1)
        spread = np.sqrt(((window - mean[:, None]) ** 2).mean(axis=1) + np.float32(1e-6))
        parts = [attended, tokens[:, -1], mean, spread, slow.astype(np.float32)]
        return _unit(linear("project", np.concatenate(parts, axis=-1)))

    def _answer(self, latent: np.ndarray, query: Array) -> Array:
        """Answers (B, Q, 11) in physical units and zeta, of latents (B, latents) to queries (B, Q, 12)."""
        w = self._w
        hidden = _silu(query.astype(np.float32) @ w["hidden_1.weight"].T + w["hidden_1.bias"])
        trunk = _unit(np.tanh(hidden @ w["hidden_2.weight"].T + w["hidden_2.bias"]))
        said = (latent[:, None] * trunk) @ w["out.weight"].T + w["out.bias"]
        return self.arrays["target.mean"] + self.arrays["target.scale"] * said.astype(np.float64)


class _Source:
    """Whole sequences after the front end, cut into windows and queries."""

    def __init__(self, batch: Batch, front_end: FrontEnd) -> None:
        assert batch.truth is not None
        filled, self.accepted, _ = front_end.run(batch.measured)
        read = features.run(front_end.standardise(filled))
        self.values, self.slow = read[..., : len(CHANNELS)], read[..., len(CHANNELS) :]
        self.sums = np.cumsum(self.values[..., :N_IN], axis=1, dtype=np.float64)
        self.target = np.concatenate([batch.truth.states[..., : PROBE + 1], to_zeta(batch.truth.health)], axis=-1)

    def window(self, sequence: np.ndarray, sample: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Values (M, 65, 7), masks (M, 64, 7) and running means (M, 28); the first sample stands in before it."""
        ticks = np.maximum(sample[:, None] + np.arange(-WINDOW, 1), 0)
        rows = sequence[:, None]
        masks = self.accepted[rows, ticks[:, 1:]].astype(np.float32)
        return self.values[rows, ticks], masks, self.slow[sequence, sample]

    def query(self, sequence: np.ndarray, sample: np.ndarray, later: np.ndarray) -> Array:
        """(M, Q, 12) for ticks ``later`` (M, Q)."""
        inputs = self.values[sequence, later, :N_IN]
        count = np.maximum(later - sample, 1)[..., None]
        mean = (self.sums[sequence, later] - self.sums[sequence, sample]) / count
        between = np.where((later > sample)[..., None], mean, inputs)
        return _query((later - sample) * SAMPLE_PERIOD_S, inputs, between)


def _query(ahead_s: Array, inputs: np.ndarray, mean: np.ndarray) -> Array:
    """(..., 12): the time ahead on four scales, the inputs then, and their mean until then."""
    times = [1.0 - np.exp(-ahead_s / tau) for tau in TIMES_S]
    return np.concatenate([np.stack([*times, ahead_s / LONGEST_LEAD_S], axis=-1), inputs, mean], axis=-1)


def _shifted(window: np.ndarray, newest: np.ndarray, fresh: np.ndarray) -> np.ndarray:
    """The window one tick on; a fresh one holds its first sample throughout."""
    last = newest.astype(np.float32)[:, None]
    moved = np.concatenate([window[:, 1:], last], axis=1)
    return np.where(fresh[:, None, None], last, moved)


def _bounded(z: Array) -> Array:
    """Health within its coordinates, flow positive."""
    z[..., ZETA:] = np.clip(z[..., ZETA:], -ZETA_LIMIT, ZETA_LIMIT)
    z[..., FLOW] = np.maximum(z[..., FLOW], 0.05)
    return z


def _readings(z: Array) -> tuple[Array, Array]:
    """Readings (B, 3) of z (B, 11) and their slopes (B, 3, 11)."""
    theta, slope = theta_and_slope(z[:, ZETA:])
    y = np.stack([z[:, PRESSURE], z[:, PROBE] + theta[:, len(HEALTH) - 1], M_REF_KG_S * z[:, FLOW]], axis=-1)
    H = np.zeros((len(z), 3, SIZE))
    H[:, 0, PRESSURE] = H[:, 1, PROBE] = 1.0
    H[:, 1, SIZE - 1] = slope[:, len(HEALTH) - 1]
    H[:, 2, FLOW] = M_REF_KG_S
    return y, H


def _unit(x: np.ndarray) -> np.ndarray:
    return x / np.sqrt((x * x).mean(axis=-1, keepdims=True) + np.float32(1e-6))


def _sigmoid(x: np.ndarray) -> np.ndarray:
    return np.float32(0.5) * (np.float32(1.0) + np.tanh(np.float32(0.5) * x))


def _silu(x: np.ndarray) -> np.ndarray:
    return x * _sigmoid(x)
