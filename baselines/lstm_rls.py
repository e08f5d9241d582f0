"""LSTM + recursive least squares: a recurrent model of the machine whose health is fitted online.

The network is driven by the inputs alone and never sees an output: from its memory of load and
suction it says where a healthy machine would be, and how far each health coordinate moves it
(to second order). That is a regression on the health coordinates, and recursive least squares with
exponential forgetting solves it tick by tick. Forgetting leaks towards the training population, so
that directions without excitation do not wind up. Offsets of pressure and flow take the network's
own slow error, with the size that it had on the validation sequences.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, ClassVar

import numpy as np

from twinbench.baselines import features
from twinbench.baselines.features import FeatureMemory
from twinbench.baselines.recurrent import TICKS_PER_STEP, SlowFastTwin
from twinbench.data.batch import HEALTH, INPUTS, SAMPLE_PERIOD_S, STATE, STATES, Array, Batch
from twinbench.data.population import PRIOR_COV, PRIOR_MEAN
from twinbench.methods.estimator import Estimator, Info, Sample, State, register
from twinbench.methods.frontend import FrontEnd, Memory
from twinbench.methods.kalman import INNOVATION_CLIP_SD
from twinbench.methods.noise import coloured_tau_s, output_sd
from twinbench.methods.reporting import clean_flags, report
from twinbench.physics.compressor import M_REF_KG_S
from twinbench.physics.health import ZETA_LIMIT, ZETA_SCALE, theta_and_slope, to_zeta

N_TARGETS = len(STATES) + 1  # the probe's temperature too
N_ZETA = len(HEALTH) - 1  # the sensor's bias does not move the machine
N_FITTED = len(HEALTH) + 2  # zeta, and the offsets of pressure and flow
PRESSURE, PROBE, FLOW = STATE.p_exh_bar, len(STATES), STATE.flow_memory
LAG_S = 1.0


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

    def fit(self, train: Batch, validation: Batch, seed: int) -> None:
        """Train on the training sequences and their re-simulations; learn the error from validation."""
        import torch
        from torch.nn import functional

        from twinbench.baselines.recurrent import SlowFast
        from twinbench.baselines.sequences import Schedule, fit_sequences, read_out
        from twinbench.methods.resimulate import resimulate
        from twinbench.methods.training import seeded, weights_of

        config = self.config
        rng, _ = seeded(seed)
        front_end = FrontEnd.fit(train)
        more = resimulate(train, rng, config["copies"])
        x, zeta = _targets(more)
        mean, scale = x.mean(axis=(0, 1)), x.std(axis=(0, 1))

        def read_of(batch: Batch) -> np.ndarray:
            standard = front_end.standardise(front_end.run(batch.measured)[0])
            return features.run(standard[..., : len(INPUTS)])

        read = read_of(more)
        network = SlowFast("lstm", read.shape[-1], config["hidden"], config["readout"], N_TARGETS * (1 + 2 * N_ZETA))

        def loss(out: torch.Tensor, wanted: torch.Tensor) -> torch.Tensor:
            terms = out.unflatten(-1, (N_TARGETS, 1 + 2 * N_ZETA))
            known = wanted[..., N_TARGETS:].unsqueeze(-2)
            powers = torch.cat([torch.ones_like(known[..., :1]), known, known**2], dim=-1)
            return functional.smooth_l1_loss((terms * powers).sum(-1), wanted[..., :N_TARGETS], beta=0.1)

        target = np.concatenate([(x - mean) / scale, zeta[..., :N_ZETA] / ZETA_SCALE], axis=-1).astype(np.float32)
        schedule = Schedule(config["iterations"], config["batch"], config["learning_rate"])
        losses = fit_sequences(network, read, target, loss, rng, schedule)
        ticks, out = read_out(network, read_of(validation), every=5)
        x_held, zeta_held = (part[:, ticks] for part in _targets(validation))
        terms = out.reshape(*out.shape[:2], N_TARGETS, 1 + 2 * N_ZETA)
        error = x_held - (mean + scale * _combined(terms, zeta_held)[0])
        lag = round(LAG_S / SAMPLE_PERIOD_S) // 5
        together = (error[:, lag:] * error[:, :-lag]).mean(axis=(0, 1)) / (error**2).mean(axis=(0, 1))
        population = zeta[:, ::200].reshape(-1, len(HEALTH))
        self.arrays = {
            **weights_of(network),
            **front_end.arrays(),
            "target.mean": mean,
            "target.scale": scale,
            "error.cov": np.einsum("bti,btj->ij", error, error) / error[..., 0].size,
            "error.tau_s": np.minimum(-LAG_S / np.log(np.clip(together, 0.01, 0.999)), 60.0),
            "prior.mean": population.mean(axis=0),
            "prior.var": population.var(axis=0),
            "loss": np.array(losses),
        }
        self.restore()

    def restore(self) -> None:
        """Rebuild the network's twin, the leakage and the weights of the regression."""
        a = self.arrays
        self._front_end = FrontEnd.from_arrays(a)
        self._network = SlowFastTwin(a)
        memory_s = np.repeat([self.config["forgetting_s"], self.config["offset_forgetting_s"]], [len(HEALTH), 2])
        self._forget = np.exp(-SAMPLE_PERIOD_S / memory_s)
        cov = a["error.cov"]
        offsets = cov[[PRESSURE, FLOW], [PRESSURE, FLOW]]
        self._centre = np.concatenate([a["prior.mean"], np.zeros(2)])
        self._leak = 1.0 / np.concatenate([a["prior.var"], offsets])
        self._start = 1.0 / np.concatenate([np.diag(PRIOR_COV), offsets])
        # Readings err together for a while: so many ticks count as one.
        self._coloured_ticks = 2.0 * coloured_tau_s() / SAMPLE_PERIOD_S
        rows = [PRESSURE, PROBE, FLOW]
        unit = np.array([1.0, 1.0, M_REF_KG_S])
        self._own_var = unit**2 * cov[rows, rows]
        self._own_ticks = 2.0 * a["error.tau_s"][rows] / SAMPLE_PERIOD_S
        # What the offsets do not take of the network's error stays with the states.
        taken = np.ones(len(STATES))
        taken[[PRESSURE, FLOW]] = 0.0
        self._residue = cov[: len(STATES), : len(STATES)] * taken[:, None] * taken

    def init(self, batch: int) -> State:
        """States where the training sequences usually are, health as anywhere in the population."""
        fitted = np.zeros((batch, N_FITTED))
        fitted[:, : len(HEALTH)] = PRIOR_MEAN
        information = np.tile(np.diag(self._start), (batch, 1, 1))
        x = np.tile(self.arrays["target.mean"], (batch, 1))
        slope = np.zeros((batch, N_TARGETS, N_FITTED))
        slope[:, range(N_TARGETS), 0] = self.arrays["target.scale"]
        memory = (
            np.zeros(batch, np.int64),
            fitted,
            information,
            *self._network.init(batch),
            *features.init(batch, len(INPUTS)),
            *self._front_end.init(batch),
        )
        return self._report(x, slope, fitted, information, memory)

    def step(self, state: State, sample: Sample) -> tuple[State, Info]:
        """Run the network on by the inputs, fit health and offsets to the outputs."""
        ticks, fitted, information, h, c, *rest = state.memory
        means, front = FeatureMemory(*rest[:2]), Memory(*rest[2:])
        front, clean, values = features.clean_step(self._front_end, front, sample.measured)
        means, read = features.step(means, values[:, : len(INPUTS)])
        ticks, h, c, terms = self._run_on(ticks, h, c, read)
        x, slope = self._located(terms, fitted)
        y, H = _readings(x, slope, fitted)
        white, coloured = output_sd(clean.filled)
        present = clean.accepted[:, 4:]
        innovation = np.where(present, clean.filled[:, 4:] - y, np.nan)
        fresh = (ticks == 1)[:, None]
        root = np.sqrt(self._forget)
        kept = root[:, None] * information * root + np.diag((1.0 - self._forget) * self._leak)
        kept = np.where(fresh[..., None], information, kept)
        pull = (1.0 - self._forget) * self._leak * (self._centre - fitted)
        pull = np.where(fresh, 0.0, pull)
        S = H @ np.linalg.solve(kept, H.transpose(0, 2, 1))
        S[:, range(3), range(3)] += white**2 + coloured**2
        limit = INNOVATION_CLIP_SD * np.sqrt(np.diagonal(S, axis1=1, axis2=2))
        bounded = np.where(present, np.clip(innovation, -limit, limit), 0.0)
        variance = white**2 + self._coloured_ticks * coloured**2 + self._own_ticks * self._own_var
        weight = present / (self.config["noise_inflation"] * variance)
        information = kept + H.transpose(0, 2, 1) @ (weight[:, :, None] * H)
        gradient = np.einsum("bij,bi->bj", H, weight * bounded) + pull
        fitted = fitted + np.linalg.solve(information, gradient[..., None])[..., 0]
        fitted[:, : len(HEALTH)] = np.clip(fitted[:, : len(HEALTH)], -ZETA_LIMIT, ZETA_LIMIT)
        x, slope = self._located(terms, fitted)
        memory = (ticks, fitted, information, h, c, *means, *front)
        info = Info(innovation, S, _nis(innovation, S), present, clean_flags(clean), clean.age_s)
        return self._report(x, slope, fitted, information, memory), info

    def forecast(self, state: State, inputs: Array) -> Array:
        """Run the network on by the inputs to come; health and offsets stay."""
        ticks, fitted, _, h, c, *rest = state.memory
        means = FeatureMemory(*rest[:2])
        out = np.empty((*inputs.shape[:2], 3))
        front = self._front_end
        values = (inputs - front.mean[: len(INPUTS)]) / front.scale[: len(INPUTS)]
        for k in range(inputs.shape[1]):
            means, read = features.step(means, values[:, k])
            ticks, h, c, terms = self._run_on(ticks, h, c, read)
            x, slope = self._located(terms, fitted)
            out[:, k] = _readings(x, slope, fitted)[0]
        return out

    def _run_on(
        self, ticks: np.ndarray, h: np.ndarray, c: np.ndarray, read: Array
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, Array]:
        """One tick of the network: its memory once a second, its readout (B, 6, 9) always."""
        read = read.astype(np.float32)
        due = (ticks % TICKS_PER_STEP == 0)[:, None]
        if due.any():
            h1, c1 = self._network.step(h, c, read)
            h, c = np.where(due, h1, h), np.where(due, c1, c)
        terms = self._network.read(h, read).reshape(len(h), N_TARGETS, 1 + 2 * N_ZETA)
        return ticks + 1, h, c, terms

    def _located(self, terms: Array, fitted: Array) -> tuple[Array, Array]:
        """States with the probe (B, 6), and their slopes to what is fitted (B, 6, 7)."""
        scaled, to_zeta_ = _combined(terms, fitted[:, : len(HEALTH)])
        scale = self.arrays["target.scale"]
        x = self.arrays["target.mean"] + scale * scaled
        slope = np.zeros((len(x), N_TARGETS, N_FITTED))
        slope[..., :N_ZETA] = scale[:, None] * to_zeta_
        x[:, PRESSURE] += fitted[:, -2]
        x[:, FLOW] = np.maximum(x[:, FLOW] + fitted[:, -1], 0.05)
        slope[:, PRESSURE, -2] = slope[:, FLOW, -1] = 1.0
        return x, slope

    def _report(
        self, x: Array, slope: Array, fitted: Array, information: Array, memory: tuple[np.ndarray, ...]
    ) -> State:
        n, m = len(STATES), len(HEALTH)
        J = np.concatenate([slope[:, :n], np.broadcast_to(np.eye(m, N_FITTED), (len(x), m, N_FITTED))], axis=1)
        P = J @ np.linalg.solve(information, J.transpose(0, 2, 1))
        P[:, :n, :n] += self._residue
        P = 0.5 * (P + P.transpose(0, 2, 1))
        return report(np.concatenate([x[:, :n], fitted[:, :m]], axis=1), P, np.arange(n + m), memory)


def _targets(batch: Batch) -> tuple[Array, Array]:
    """States with the probe (B, N, 6) and health coordinates (B, N, 5)."""
    assert batch.truth is not None
    return batch.truth.states[..., :N_TARGETS], to_zeta(batch.truth.health)


def _combined(terms: Array, zeta: Array) -> tuple[Array, Array]:
    """Scaled states (..., 6) of network terms (..., 6, 9) at zeta (..., 5), and slopes (..., 6, 4)."""
    known = zeta[..., None, :N_ZETA] / ZETA_SCALE
    base, linear, square = terms[..., 0], terms[..., 1 : 1 + N_ZETA], terms[..., 1 + N_ZETA :]
    return base + (linear * known + square * known**2).sum(axis=-1), (linear + 2.0 * square * known) / ZETA_SCALE


def _readings(x: Array, slope: Array, fitted: Array) -> tuple[Array, Array]:
    """Readings (B, 3) and their slopes to what is fitted (B, 3, 7)."""
    theta, of_zeta = theta_and_slope(fitted[:, : len(HEALTH)])
    y = np.stack([x[:, PRESSURE], x[:, PROBE] + theta[:, len(HEALTH) - 1], M_REF_KG_S * x[:, FLOW]], axis=-1)
    H = slope[:, [PRESSURE, PROBE, FLOW]] * np.array([1.0, 1.0, M_REF_KG_S])[:, None]
    H[:, 1, len(HEALTH) - 1] = of_zeta[:, len(HEALTH) - 1]
    return y, H


def _nis(innovation: Array, S: Array) -> Array:
    """(B,) over the channels that are there, NaN if none."""
    missing = np.isnan(innovation)
    filled = np.where(missing, 0.0, innovation)
    weight = np.where(missing[:, :, None] | missing[:, None, :], 0.0, S) + missing[:, :, None] * np.eye(3)
    nis = np.einsum("bi,bi->b", filled, np.linalg.solve(weight, filled[..., None])[..., 0])
    return np.where(missing.all(axis=1), np.nan, nis)
