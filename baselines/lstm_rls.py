"""LSTM + recursive least squares: a recurrent model of the machine whose health is fitted online.

The network is driven by the inputs alone and never sees an output: from its memory of load and
suction it says where a healthy machine would be, and how far each health coordinate moves it
(to second order). That is a regression on the health coordinates, and recursive least squares with
exponential forgetting solves it tick by tick. Forgetting leaks towards the training population, so
that directions without excitation do not wind up. Offsets of what unbiased sensors read (of the compressor: pressure
and flow) take the network's own slow error, with the size that it had on the validation sequences.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, ClassVar

import numpy as np

from twinbench.baselines import features
from twinbench.baselines.features import FeatureMemory
from twinbench.baselines.layout import acting, layout_of
from twinbench.baselines.recurrent import SlowFastTwin, ticks_per_step
from twinbench.data.batch import Array, Batch
from twinbench.machines.compressor import COMPRESSOR
from twinbench.machines.coordinates import ZETA_SCALE
from twinbench.machines.machine import Machine
from twinbench.methods.estimator import Estimator, Info, Sample, State, register
from twinbench.methods.frontend import FrontEnd, Memory
from twinbench.methods.kalman import INNOVATION_CLIP_SD
from twinbench.methods.noise import coloured_tau_s, output_sd, sheet_of
from twinbench.methods.reporting import clean_flags, report

LAG_S = 1.0
"""From a held-out error of the network to that which tells how long it stays, a sample at least. An AR(1) has the same
time constant at any lag."""
LONGEST_ERROR_S = 60.0
"""The longest time that an error of the network is taken to stay; a recording is too short to tell longer ones."""
POPULATION_S = 10.0
"""Between those of the training sequences' health that the population is made of: neighbours say the same."""


@register
class LSTMRecursiveLeastSquares(Estimator):
    """A recurrent predictor with recursive least-squares parameter adaptation."""

    name = "lstm_rls"
    says = "recurrent model of the machine, its health fitted by recursive least squares"
    settings: ClassVar[dict[str, Any]] = {
        "iterations": 6000,
        "batch": 16,
        "learning_rate": 1.2e-2,
        "copies": 3,
        "hidden": 112,
        "readout": 194,
        "forgetting_s": 5.949,
        "offset_forgetting_s": 29.92,
        "noise_inflation": 0.07109,
    }
    search_space: ClassVar[dict[str, Sequence[float]]] = {
        "learning_rate": [6e-3, 1.2e-2, 2.4e-2],
        "forgetting_s": (5.0, 200.0),
        "offset_forgetting_s": (1.0, 60.0),
        "noise_inflation": (0.02, 2.0),
    }
    online = frozenset({"forgetting_s", "offset_forgetting_s", "noise_inflation"})
    contract_settings: ClassVar[dict[str, Any]] = {"iterations": 6, "batch": 4, "copies": 1}

    def __init__(self, machine: Machine = COMPRESSOR, **settings: Any) -> None:
        super().__init__(machine, **settings)
        layout = self._layout = layout_of(machine)
        self._ticks, self._kept, self._acting = ticks_per_step(machine), features.keep_of(machine), acting(machine)
        self._terms, self._moves = 1 + 2 * int(self._acting.sum()), np.flatnonzero(self._acting)
        # What an unbiased output reads, and what its lag follows, has an offset.
        unbiased = [i for i, r in enumerate(machine.readings) if not r.bias]
        self._offset = layout.through[unbiased].T.astype(np.float64)
        self._unbiased = layout.read[unbiased]

    def fit(self, train: Batch, validation: Batch, seed: int) -> None:
        """Train on the training sequences and their re-simulations; learn the error from validation."""
        import torch
        from torch.nn import functional

        from twinbench.baselines.recurrent import SlowFast
        from twinbench.baselines.sequences import Schedule, apart, fit_sequences, read_out
        from twinbench.methods.resimulate import resimulate
        from twinbench.methods.training import seeded, weights_of

        config, m, terms = self.config, self._layout.zeta, self._terms
        rng, _ = seeded(seed)
        front_end = FrontEnd.fit(train)
        more = resimulate(train, rng, config["copies"])
        x, zeta = self._targets(more)
        mean, scale = x.mean(axis=(0, 1)), x.std(axis=(0, 1))

        def read_of(batch: Batch) -> np.ndarray:
            standard = front_end.standardise(front_end.run(batch.measured)[0])
            return features.run(standard[..., : len(self.machine.inputs)], self._kept)

        read = read_of(more)
        network = SlowFast("lstm", read.shape[-1], config["hidden"], config["readout"], m * terms)

        def loss(out: torch.Tensor, wanted: torch.Tensor) -> torch.Tensor:
            known = wanted[..., m:].unsqueeze(-2)
            powers = torch.cat([torch.ones_like(known[..., :1]), known, known**2], dim=-1)
            said = (out.unflatten(-1, (m, terms)) * powers).sum(-1)
            return functional.smooth_l1_loss(said, wanted[..., :m], beta=0.1)

        target = np.concatenate([(x - mean) / scale, zeta[..., self._acting] / ZETA_SCALE], axis=-1).astype(np.float32)
        schedule = Schedule(config["iterations"], config["batch"], config["learning_rate"])
        losses = fit_sequences(network, read, target, loss, rng, schedule, self._ticks)
        every, period_s = apart(self._ticks), self.machine.sample_period_s
        ticks, out = read_out(network, read_of(validation), self._ticks, every)
        x_held, zeta_held = (part[:, ticks] for part in self._targets(validation))
        error = x_held - (mean + scale * self._combined(out.reshape(*out.shape[:2], m, terms), zeta_held)[0])
        population = zeta[:, :: max(1, round(POPULATION_S / period_s))].reshape(-1, zeta.shape[-1])
        self.arrays = {
            **weights_of(network),
            **front_end.arrays(),
            "target.mean": mean,
            "target.scale": scale,
            "error.cov": np.einsum("bti,btj->ij", error, error) / error[..., 0].size,
            "error.tau_s": _tau_s(error, every * period_s),
            "prior.mean": population.mean(axis=0),
            "prior.var": population.var(axis=0),
            "loss": np.array(losses),
        }
        self.restore()

    def restore(self) -> None:
        """Rebuild the network's twin, the leakage and the weights of the regression."""
        a, machine, layout = self.arrays, self.machine, self._layout
        self._front_end, self._sheet = FrontEnd.from_arrays(a), sheet_of(machine)
        self._network = SlowFastTwin(a)
        period_s, (mean, prior) = machine.sample_period_s, machine.prior
        shares = len(mean), len(self._unbiased)
        memory_s = np.repeat([self.config["forgetting_s"], self.config["offset_forgetting_s"]], shares)
        self._forget = np.exp(-period_s / memory_s)
        cov, n = a["error.cov"], len(machine.estimated)
        offsets = cov[self._unbiased, self._unbiased]
        self._centre = np.concatenate([a["prior.mean"], np.zeros(len(offsets))])
        self._leak = 1.0 / np.concatenate([a["prior.var"], offsets])
        self._start = 1.0 / np.concatenate([np.diag(prior), offsets])
        # Readings err together for a while: so many ticks count as one.
        self._coloured_ticks = np.maximum(2.0 * coloured_tau_s(machine) / period_s, 1.0)
        self._own_var = layout.gains[range(len(layout.read)), layout.read] ** 2 * cov[layout.read, layout.read]
        self._own_ticks = np.maximum(2.0 * a["error.tau_s"][layout.read] / period_s, 1.0)
        # What the offsets do not take of the network's error stays with the states.
        left = ~np.any(self._offset, axis=1)[:n]
        self._residue = cov[:n, :n] * left[:, None] * left

    def init(self, batch: int) -> State:
        """States where the training sequences usually are, health as anywhere in the population."""
        nh, m = len(self.machine.health), self._layout.zeta
        fitted = np.zeros((batch, len(self._start)))
        fitted[:, :nh] = self.machine.prior[0]
        information = np.tile(np.diag(self._start), (batch, 1, 1))
        x = np.tile(self.arrays["target.mean"], (batch, 1))
        slope = np.zeros((batch, m, len(self._start)))
        slope[:, range(m), 0] = self.arrays["target.scale"]
        memory = (
            np.zeros(batch, np.int64),
            fitted,
            information,
            *self._network.init(batch),
            *features.init(batch, len(self.machine.inputs)),
            *self._front_end.init(batch),
        )
        return self._report(x, slope, fitted, information, memory)

    def step(self, state: State, sample: Sample) -> tuple[State, Info]:
        """Run the network on by the inputs, fit health and offsets to the outputs."""
        nu, nh, limit = len(self.machine.inputs), len(self.machine.health), self._layout.zeta_limit
        ticks, fitted, information, h, c, *rest = state.memory
        means, front = FeatureMemory(*rest[:2]), Memory(*rest[2:])
        front, clean, values = features.clean_step(self._front_end, front, sample.measured)
        means, read = features.step(means, values[:, :nu], self._kept)
        ticks, h, c, terms = self._run_on(ticks, h, c, read)
        y, H = self._readings(*self._located(terms, fitted), fitted)
        white, coloured = output_sd(self._sheet, clean.filled)
        present = clean.accepted[:, nu:]
        innovation = np.where(present, clean.filled[:, nu:] - y, np.nan)
        fresh = (ticks == 1)[:, None]
        root = np.sqrt(self._forget)
        kept = root[:, None] * information * root + np.diag((1.0 - self._forget) * self._leak)
        kept = np.where(fresh[..., None], information, kept)
        pull = (1.0 - self._forget) * self._leak * (self._centre - fitted)
        pull = np.where(fresh, 0.0, pull)
        S = H @ np.linalg.solve(kept, H.transpose(0, 2, 1))
        S[:, range(y.shape[1]), range(y.shape[1])] += white**2 + coloured**2
        farthest = INNOVATION_CLIP_SD * np.sqrt(np.diagonal(S, axis1=1, axis2=2))
        bounded = np.where(present, np.clip(innovation, -farthest, farthest), 0.0)
        variance = white**2 + self._coloured_ticks * coloured**2 + self._own_ticks * self._own_var
        weight = present / (self.config["noise_inflation"] * variance)
        information = kept + H.transpose(0, 2, 1) @ (weight[:, :, None] * H)
        gradient = np.einsum("bij,bi->bj", H, weight * bounded) + pull
        fitted = fitted + np.linalg.solve(information, gradient[..., None])[..., 0]
        fitted[:, :nh] = np.clip(fitted[:, :nh], -limit, limit)
        x, slope = self._located(terms, fitted)
        memory = (ticks, fitted, information, h, c, *means, *front)
        info = Info(innovation, S, _nis(innovation, S), present, clean_flags(clean), clean.age_s)
        return self._report(x, slope, fitted, information, memory), info

    def forecast(self, state: State, inputs: Array) -> Array:
        """Run the network on by the inputs to come; health and offsets stay."""
        ticks, fitted, _, h, c, *rest = state.memory
        means = FeatureMemory(*rest[:2])
        out = np.empty((*inputs.shape[:2], len(self.machine.outputs)))
        front, nu = self._front_end, inputs.shape[-1]
        values = (inputs - front.mean[:nu]) / front.scale[:nu]
        for k in range(inputs.shape[1]):
            means, read = features.step(means, values[:, k], self._kept)
            ticks, h, c, terms = self._run_on(ticks, h, c, read)
            out[:, k] = self._readings(*self._located(terms, fitted), fitted)[0]
        return out

    def _run_on(
        self, ticks: np.ndarray, h: np.ndarray, c: np.ndarray, read: Array
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, Array]:
        """One tick of the network: its memory where a step is due, its readout (B, m, terms) always."""
        read = read.astype(np.float32)
        due = (ticks % self._ticks == 0)[:, None]
        if due.any():
            h1, c1 = self._network.step(h, c, read)
            h, c = np.where(due, h1, h), np.where(due, c1, c)
        terms = self._network.read(h, read).reshape(len(h), self._layout.zeta, self._terms)
        return ticks + 1, h, c, terms

    def _located(self, terms: Array, fitted: Array) -> tuple[Array, Array]:
        """States with their lags (B, m), and their slopes to what is fitted (B, m, nh + offsets)."""
        nh, layout = len(self.machine.health), self._layout
        scaled, to_zeta_ = self._combined(terms, fitted[:, :nh])
        scale = self.arrays["target.scale"]
        x = self.arrays["target.mean"] + scale * scaled + fitted[:, nh:] @ self._offset.T
        slope = np.zeros((*x.shape, fitted.shape[1]))
        slope[..., self._moves] = scale[:, None] * to_zeta_
        slope[..., nh:] = self._offset
        return np.maximum(x, layout.least), slope

    def _readings(self, x: Array, slope: Array, fitted: Array) -> tuple[Array, Array]:
        """Readings (B, ny) and their slopes to what is fitted (B, ny, nh + offsets)."""
        nh, layout = len(self.machine.health), self._layout
        theta, of_zeta = self.machine.coordinates.theta_and_slope(fitted[:, :nh])
        H = layout.gains @ slope
        H[..., :nh] += layout.biases * of_zeta[:, None]
        return x @ layout.gains.T + theta @ layout.biases.T, H

    def _combined(self, terms: Array, zeta: Array) -> tuple[Array, Array]:
        """Scaled states (..., m) of network terms (..., m, terms) at zeta (..., nh), and slopes (..., m, acting)."""
        known = zeta[..., None, self._acting] / ZETA_SCALE
        cut = 1 + known.shape[-1]
        base, linear, square = terms[..., 0], terms[..., 1:cut], terms[..., cut:]
        return base + (linear * known + square * known**2).sum(axis=-1), (linear + 2.0 * square * known) / ZETA_SCALE

    def _targets(self, batch: Batch) -> tuple[Array, Array]:
        """States with their lags (B, N, m) and health coordinates (B, N, nh)."""
        assert batch.truth is not None
        z, m = self._layout.targets(batch.truth), self._layout.zeta
        return z[..., :m], z[..., m:]

    def _report(
        self, x: Array, slope: Array, fitted: Array, information: Array, memory: tuple[np.ndarray, ...]
    ) -> State:
        n, nh, size = len(self.machine.estimated), len(self.machine.health), fitted.shape[1]
        J = np.concatenate([slope[:, :n], np.broadcast_to(np.eye(nh, size), (len(x), nh, size))], axis=1)
        P = J @ np.linalg.solve(information, J.transpose(0, 2, 1))
        P[:, :n, :n] += self._residue
        P = 0.5 * (P + P.transpose(0, 2, 1))
        mean = np.concatenate([x[:, :n], fitted[:, :nh]], axis=1)
        return report(self.machine.coordinates, mean, P, np.arange(n + nh), memory)


def _tau_s(error: Array, every_s: float) -> Array:
    """Time constants (m,) of errors (B, M, m) that are ``every_s`` apart."""
    lag = max(1, round(LAG_S / every_s))
    together = (error[:, lag:] * error[:, :-lag]).mean(axis=(0, 1)) / (error**2).mean(axis=(0, 1))
    return np.minimum(-lag * every_s / np.log(np.clip(together, 0.01, 0.999)), LONGEST_ERROR_S)


def _nis(innovation: Array, S: Array) -> Array:
    """(B,) over the channels that are there, NaN if none."""
    missing = np.isnan(innovation)
    filled = np.where(missing, 0.0, innovation)
    apart = missing[:, :, None] * np.eye(missing.shape[1])
    weight = np.where(missing[:, :, None] | missing[:, None, :], 0.0, S) + apart
    nis = np.einsum("bi,bi->b", filled, np.linalg.solve(weight, filled[..., None])[..., 0])
    return np.where(missing.all(axis=1), np.nan, nis)
