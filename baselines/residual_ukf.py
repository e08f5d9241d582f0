"""Residual UKF: the nominal equations plus a small neural residual of their rates, in an unscented Kalman filter.

The reduced-order model knows most of the machine, and what it leaves out is a smooth function of state, inputs and
health. A perceptron learns that function, the rates of the plant minus those of the recalibrated model, from the
counterfactual transitions that the PINN is trained on (universal differential equations, Rackauckas et al., 2020; as a
filter's model e.g. Imbiriba et al., 2022). It is evaluated once a tick and held over it. All else is the nominal UKF's:
without the residual the two are the same filter. The network is small on purpose: one twice as wide left as much of
the rates unexplained on validation recordings.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, ClassVar

import numpy as np
from numba import njit

from twinbench.baselines.augmented_model import bound, linearise, move, parameters, true_inputs
from twinbench.baselines.layout import actuators
from twinbench.baselines.nominal_filter import advance, read
from twinbench.baselines.nominal_ukf import NominalUKF
from twinbench.baselines.residual import EDGE, Residual, residual_input, residual_rates
from twinbench.baselines.slow_errors import slow_error_sd
from twinbench.baselines.unscented import correct, moments, sigma_points
from twinbench.data.batch import Array, Batch
from twinbench.methods.estimator import State, register
from twinbench.methods.kalman import INNOVATION_CLIP_SD


@njit(cache=True, error_model="numpy")
def _advance_all(rhs, model, net, points, u):  # type: ignore[no-untyped-def]
    """Points (K, n) a tick on, in place, under inputs u (nu,) as read."""
    for k in range(points.shape[0]):
        bound(model, points[k])
    rates = residual_rates(net, residual_input(model, net, points, u))
    for k in range(points.shape[0]):
        points[k] = advance(rhs, model, points[k], u)
        points[k, : rates.shape[1]] += model.period_s * rates[k]


@njit(cache=True, error_model="numpy")
def _tick(rhs, output, model, net, spread, z, P, started, told, info):  # type: ignore[no-untyped-def]
    alpha, w_mean, w_cov = spread
    before, now, u_sd, measured, white, coloured = told
    readings = np.empty((1, w_mean.size, measured.shape[1]))
    for b in range(z.shape[0]):
        one = slice(b, b + 1)
        if started[b]:
            _, _, Q = linearise(rhs, model, z[b], before[b], u_sd[b])
            points = sigma_points(z[one], P[one], alpha)
            _advance_all(rhs, model, net, points[0], before[b])
            z[one], P[one] = moments(points, w_mean, w_cov, Q)
        points = sigma_points(z[one], P[one], alpha)
        for k in range(w_mean.size):
            readings[0, k] = read(output, model, points[0, k], now[b], coloured[b])
        z[one], P[one], info[0][one], info[1][one], info[2][one] = correct(
            z[one], P[one], points, readings, measured[one], white[one] ** 2, w_mean, w_cov, INNOVATION_CLIP_SD
        )
        bound(model, z[b])


@njit(cache=True, error_model="numpy")
def _roll_out(rhs, output, model, net, z, inputs, readings):  # type: ignore[no-untyped-def]
    """As ``augmented_model.roll_out``, with the residual."""
    nx = model.step.size
    for b in range(z.shape[0]):
        at = z[b : b + 1].copy()
        theta, _ = parameters(model, at[0])
        for k in range(readings.shape[1]):
            rates = residual_rates(net, residual_input(model, net, at, inputs[b, k]))
            at[0] = move(rhs, model, at[0], true_inputs(model, at[0], inputs[b, k]), theta)
            at[0, : rates.shape[1]] += model.period_s * rates[0]
            bound(model, at[0])
            readings[b, k] = output(at[0, :nx].copy(), true_inputs(model, at[0], inputs[b, k + 1]), theta)


@register
class ResidualUKF(NominalUKF):
    """The engineer's model, and a network for what it leaves out."""

    name = "residual_ukf"
    says = "nominal equations plus a neural residual of their rates, in an unscented Kalman filter"
    draws = True
    settings: ClassVar[dict[str, Any]] = {
        **NominalUKF.settings,
        "slow_error": 3.389,
        "alpha": 0.6529,
        "iterations": 10000,
        "rows": 1024,
        "copies": 3,
        "transitions": 300_000,
        "learning_rate": 1e-2,
        "hidden": 64,
        "state_walk": 6.148,
        "health_walk": 1.207,
    }
    search_space: ClassVar[dict[str, Sequence[float]]] = {
        "learning_rate": [5e-3, 1e-2, 2e-2],
        "state_walk": (0.5, 50.0),
        "health_walk": (0.5, 4.0),
        "alpha": (0.3, 1.0),
    }
    contract_settings: ClassVar[dict[str, Any]] = {"iterations": 60, "rows": 128, "copies": 1, "transitions": 3000}

    def fit(self, train: Batch, validation: Batch, seed: int) -> None:
        """The nominal UKF's fit, then the residual from transitions of training sequences and re-simulations."""
        import torch
        from torch.nn import functional

        from twinbench.baselines.perceptron import network_input, perceptron, read_of, standard
        from twinbench.methods.resimulate import resimulate
        from twinbench.methods.training import adamw, seeded, weights_of
        from twinbench.methods.transitions import draw_transitions
        from twinbench.physics.integrate import Varying, advance

        config, machine, n = self.config, self.machine, len(self.machine.estimated)
        period_s = machine.sample_period_s
        nominal = NominalUKF(self.machine, **{name: config[name] for name in NominalUKF.settings})
        nominal.fit(train, validation, seed)
        rng, _ = seeded(seed)
        more = resimulate(train, rng, config["copies"])
        moves = draw_transitions(more, config["transitions"], rng)
        assert more.truth is not None
        hidden = more.truth.states[moves.sequence, moves.sample, n:]
        u = more.truth.inputs[moves.sequence, moves.sample]
        whole, health = np.concatenate([moves.x, hidden], axis=1), Varying(machine.health_names, moves.theta)
        known = advance(nominal.simulator(), whole, u, period_s, config["substeps"], health)[:, :n]
        rates = (moves.x_next - known) / period_s
        seen, unit = network_input(more, moves), rates.std(axis=0)
        mean, scale = standard(machine, seen)
        inputs = torch.from_numpy(np.clip((seen - mean) / scale, -EDGE, EDGE).astype(np.float32))
        wanted = torch.from_numpy((rates / unit).astype(np.float32))
        network = perceptron(seen.shape[1], config["hidden"], n)

        def loss(_: int) -> torch.Tensor:
            rows = torch.from_numpy(rng.integers(len(inputs), size=config["rows"]))
            return functional.smooth_l1_loss(network(inputs[rows]), wanted[rows], beta=0.2)

        losses = adamw(network, loss, config["iterations"], config["learning_rate"])
        self.arrays = {
            **nominal.arrays,
            **weights_of(network),
            "input.mean": mean,
            "input.scale": scale,
            "rate.scale": unit,
            "loss": np.array(losses),
        }
        self.restore()

        def beyond(x: Array, u: Array, theta: Array) -> Array:
            rates: Array = residual_rates(self._net, read_of(machine, x[:, :n], u, x[:, self._net.actuators], theta))
            return period_s * rates

        self.arrays["slow_error.sd"] = slow_error_sd(self.simulator(), validation, config["substeps"], beyond)
        self.restore()

    def restore(self) -> None:
        """As the nominal UKF, and the network."""
        super().restore()
        a = self.arrays
        layers = (part for i in (0, 2, 4) for part in (a[f"net.{i}.weight"].T, a[f"net.{i}.bias"]))
        parts = (a["input.mean"], a["input.scale"], *layers, a["rate.scale"])
        columns, _ = actuators(self.machine)
        self._net = Residual._make([*(np.ascontiguousarray(part, np.float64) for part in parts), columns])

    def tick(
        self,
        z: Array,
        P: Array,
        started: np.ndarray,
        own: tuple[np.ndarray, ...],
        told: tuple[Array, ...],
        info: tuple[Array, ...],
    ) -> tuple[np.ndarray, ...]:
        """Predict and correct by sigma points, the residual among what moves them."""
        _tick(self._rhs, self._output, self._model, self._net, self._spread, z, P, started, told, info)
        return ()

    def forecast(self, state: State, inputs: Array) -> Array:
        """Run equations and residual on with the parameters frozen; the drift fades."""
        u = np.concatenate([self.held(state), inputs], axis=1)
        readings = np.empty((*inputs.shape[:2], len(self.machine.outputs)))
        z = np.ascontiguousarray(state.memory[0])
        _roll_out(self._rhs, self._output, self._model, self._net, z, u, readings)
        return readings
