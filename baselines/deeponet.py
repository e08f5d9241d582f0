"""Standalone DeepONet: the operator answers alone, no filter corrects it.

The branch reads the measurement window and the running means; the trunk is asked for a time from
now to a minute ahead, under the inputs of that time. Their product gives the states, what lags them
in a sensor and the health coordinates at once, so a forecast of any length is one evaluation. Its
intervals are the errors that it made on the validation sequences.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, ClassVar

import numpy as np

from twinbench.baselines import features
from twinbench.baselines.features import FeatureMemory
from twinbench.baselines.layout import Layout, layout_of
from twinbench.data.batch import Array, Batch
from twinbench.machines.compressor import COMPRESSOR
from twinbench.machines.machine import Machine
from twinbench.methods.estimator import Estimator, Info, Sample, State, register
from twinbench.methods.frontend import FrontEnd, Memory
from twinbench.methods.kalman import update_all
from twinbench.methods.noise import output_sd, sheet_of
from twinbench.methods.operator import KERNEL, TOKENS, WINDOW
from twinbench.methods.reporting import clean_flags, report

LONGEST_LEAD_S = 60.0
TIMES_S = (0.2, 2.0, 20.0)
"""The trunk sees the query time as its share of these, saturating, and of the longest."""
HELD_S = 1.0
"""Between the answers on the validation sequences that the error is learnt from: neighbours say the same."""


def query_width(inputs: int) -> int:
    """How many numbers a query has, of a machine of so many inputs."""
    return len(TIMES_S) + 1 + 2 * inputs


def network_of(widths: dict[str, int], machine: Machine) -> Any:
    """Branch, trunk and their product."""
    import torch
    from torch import Tensor, nn
    from torch.nn import functional

    from twinbench.methods.operator import Branch, second_moment_norm

    class Network(nn.Module):
        def __init__(self) -> None:
            super().__init__()
            channels = len(machine.channels)
            slow = features.width(channels) - channels
            latents, trunk = widths["latents"], widths["trunk"]
            self.branch = Branch(widths["width_1"], widths["width_2"], 32, latents, slow, channels=channels)
            self.hidden_1 = nn.Linear(query_width(len(machine.inputs)), trunk)
            self.hidden_2 = nn.Linear(trunk, latents)
            self.out = nn.Linear(latents, layout_of(machine).size)

        def forward(self, branch: Tensor, query: Tensor) -> Tensor:
            """Answers (B, Q, size) of latents (B, latents) to queries (B, Q, query_width)."""
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

    def __init__(self, machine: Machine = COMPRESSOR, **settings: Any) -> None:
        super().__init__(machine, **settings)
        self._layout, self._kept = layout_of(machine), features.keep_of(machine)

    def fit(self, train: Batch, validation: Batch, seed: int) -> None:
        """Train on the training sequences and their re-simulations; learn the error from validation."""
        import torch
        from torch.nn import functional

        from twinbench.methods.resimulate import resimulate
        from twinbench.methods.training import adamw, seeded, weights_of

        config, layout, period_s = self.config, self._layout, self.machine.sample_period_s
        rng, _ = seeded(seed)
        front_end = FrontEnd.fit(train)
        source = _Source(resimulate(train, rng, config["copies"]), front_end, layout)
        mean, scale = source.target.mean(axis=(0, 1)), source.target.std(axis=(0, 1))
        network = network_of(config, self.machine)
        longest = LONGEST_LEAD_S / period_s

        def loss(_: int) -> torch.Tensor:
            sequence = rng.integers(source.target.shape[0], size=config["windows"])
            sample = rng.integers(source.target.shape[1], size=config["windows"])
            ahead = np.round(longest * rng.random((config["windows"], config["queries"])) ** 3).astype(int)
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
            "error.cov": np.eye(layout.size),
            "loss": np.array(losses),
        }
        self.restore()
        held = _Source(validation, front_end, layout)
        samples = np.arange(WINDOW, held.target.shape[1], max(1, round(HELD_S / period_s)))
        error = np.empty((len(validation), len(samples), layout.size))
        for b in range(len(validation)):
            rows = np.full(len(samples), b)
            latent = self._branch(*held.window(rows, samples))
            query = held.query(rows[:, None], samples[:, None], samples[:, None])
            error[b] = held.target[b, samples] - self._answer(latent, query)[:, 0]
        flat = error.reshape(-1, layout.size)
        self.arrays["error.cov"] = flat.T @ flat / len(flat)
        self.restore()

    def restore(self) -> None:
        """Rebuild the network's twin."""
        self._front_end, self._sheet = FrontEnd.from_arrays(self.arrays), sheet_of(self.machine)
        self._w = {n.removeprefix("net."): a for n, a in self.arrays.items() if n.startswith("net.")}
        self._cov = self.config["inflation"] ** 2 * self.arrays["error.cov"]

    def init(self, batch: int) -> State:
        """Where the training sequences usually are."""
        z = np.tile(self.arrays["target.mean"], (batch, 1))
        P = np.tile(self._cov + np.diag(self.arrays["target.scale"] ** 2), (batch, 1, 1))
        channels = len(self.machine.channels)
        memory = (
            np.zeros((batch, WINDOW + 1, channels), np.float32),
            np.zeros((batch, WINDOW, channels), np.float32),
            np.zeros((batch, self.config["latents"]), np.float32),
            *features.init(batch, channels),
            *self._front_end.init(batch),
        )
        return report(self.machine.coordinates, z, P, self._layout.keep, memory)

    def step(self, state: State, sample: Sample) -> tuple[State, Info]:
        """Ask the operator for now; what it had said a tick ago gives the innovation."""
        machine, layout = self.machine, self._layout
        nu, ny = len(machine.inputs), len(machine.outputs)
        values, masks, latent, *rest = state.memory
        means, front = FeatureMemory(*rest[:2]), Memory(*rest[2:])
        fresh = ~means.started
        front, clean, standard = features.clean_step(self._front_end, front, sample.measured)
        means, read = features.step(means, standard, self._kept)
        values = _shifted(values, standard, fresh)
        masks = _shifted(masks, clean.accepted, fresh)
        inputs = standard[:, :nu]
        before = latent
        latent = self._branch(values, masks, read[:, nu + ny :])
        before = np.where(fresh[:, None], latent, before)
        both = np.concatenate([before, latent])
        ahead_s = np.repeat([machine.sample_period_s, 0.0], len(latent))
        inputs = np.concatenate([inputs, inputs])
        said = layout.bounded(self._answer(both, _query(ahead_s, inputs, inputs)[:, None])[:, 0])
        foretold, z = said[: len(latent)], said[len(latent) :]
        P = np.tile(self._cov, (len(z), 1, 1))
        innovation = np.where(clean.accepted, clean.filled, np.nan)[:, nu:] - layout.readings(foretold)
        R = np.zeros((len(z), ny, ny))
        white, coloured = output_sd(self._sheet, clean.filled)
        R[:, range(ny), range(ny)] = white**2 + coloured**2
        _, _, S, nis = update_all(foretold, P, innovation, layout.slopes(foretold), R, np.inf)
        info = Info(innovation, S, nis, clean.accepted[:, nu:], clean_flags(clean), clean.age_s)
        return report(machine.coordinates, z, P, layout.keep, (values, masks, latent, *means, *front)), info

    def forecast(self, state: State, inputs: Array) -> Array:
        """One query per tick ahead, a minute at most; beyond it the query time stays a minute."""
        latent = state.memory[2]
        front, nu, nh = self._front_end, inputs.shape[-1], len(self.machine.health)
        standard = (inputs - front.mean[:nu]) / front.scale[:nu]
        count = np.arange(1, inputs.shape[1] + 1)
        mean = np.cumsum(standard, axis=1) / count[:, None]
        ahead = np.minimum(count * self.machine.sample_period_s, LONGEST_LEAD_S)
        query = _query(np.broadcast_to(ahead, standard.shape[:2]), standard, mean)
        z = self._layout.bounded(self._answer(latent, query))
        # What biases the sensors stays as it is now.
        present = self.machine.coordinates.to_zeta(state.mean[:, -nh:])
        z[..., -nh:] = present[:, None]
        return self._layout.readings(z)

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
        """Answers (B, Q, size) in units and zeta, of latents (B, latents) to queries (B, Q, query_width)."""
        w = self._w
        hidden = _silu(query.astype(np.float32) @ w["hidden_1.weight"].T + w["hidden_1.bias"])
        trunk = _unit(np.tanh(hidden @ w["hidden_2.weight"].T + w["hidden_2.bias"]))
        said = (latent[:, None] * trunk) @ w["out.weight"].T + w["out.bias"]
        return self.arrays["target.mean"] + self.arrays["target.scale"] * said.astype(np.float64)


class _Source:
    """Whole sequences after the front end, cut into windows and queries."""

    def __init__(self, batch: Batch, front_end: FrontEnd, layout: Layout) -> None:
        assert batch.truth is not None
        channels, self.inputs = batch.measured.shape[-1], len(batch.machine.inputs)
        self.period_s = batch.machine.sample_period_s
        filled, self.accepted, _ = front_end.run(batch.measured)
        read = features.run(front_end.standardise(filled), features.keep_of(batch.machine))
        self.values, self.slow = read[..., :channels], read[..., channels:]
        self.sums = np.cumsum(self.values[..., : self.inputs], axis=1, dtype=np.float64)
        self.target = layout.targets(batch.truth)

    def window(self, sequence: np.ndarray, sample: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Values (M, 65, C), masks (M, 64, C) and running means (M, 4 C); the first sample stands in before it."""
        ticks = np.maximum(sample[:, None] + np.arange(-WINDOW, 1), 0)
        rows = sequence[:, None]
        masks = self.accepted[rows, ticks[:, 1:]].astype(np.float32)
        return self.values[rows, ticks], masks, self.slow[sequence, sample]

    def query(self, sequence: np.ndarray, sample: np.ndarray, later: np.ndarray) -> Array:
        """(M, Q, query_width) for ticks ``later`` (M, Q)."""
        inputs = self.values[sequence, later, : self.inputs]
        count = np.maximum(later - sample, 1)[..., None]
        mean = (self.sums[sequence, later] - self.sums[sequence, sample]) / count
        between = np.where((later > sample)[..., None], mean, inputs)
        return _query((later - sample) * self.period_s, inputs, between)


def _query(ahead_s: Array, inputs: np.ndarray, mean: np.ndarray) -> Array:
    """(..., query_width): the time ahead on four scales, the inputs then, and their mean until then."""
    times = [1.0 - np.exp(-ahead_s / tau) for tau in TIMES_S]
    return np.concatenate([np.stack([*times, ahead_s / LONGEST_LEAD_S], axis=-1), inputs, mean], axis=-1)


def _shifted(window: np.ndarray, newest: np.ndarray, fresh: np.ndarray) -> np.ndarray:
    """The window one tick on; a fresh one holds its first sample throughout."""
    last = newest.astype(np.float32)[:, None]
    moved = np.concatenate([window[:, 1:], last], axis=1)
    return np.where(fresh[:, None, None], last, moved)


def _unit(x: np.ndarray) -> np.ndarray:
    return x / np.sqrt((x * x).mean(axis=-1, keepdims=True) + np.float32(1e-6))


def _sigmoid(x: np.ndarray) -> np.ndarray:
    return np.float32(0.5) * (np.float32(1.0) + np.tanh(np.float32(0.5) * x))


def _silu(x: np.ndarray) -> np.ndarray:
    return x * _sigmoid(x)
