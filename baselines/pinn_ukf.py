"""PINN + UKF: a physics-informed perceptron as the model of an unscented Kalman filter.

The network gives the increment of the five states over a tick from state, inputs, valve position
and health. It is trained on the plant's transitions, and held to the balances of the nominal model
beyond them (the residual of Raissi et al., 2019, in discrete time). The filter is Julier and
Uhlmann's with Merwe's sigma points; z = [five states, the drift that the pressure sensors share, health coordinates,
probe, coloured noise]. It starts from the population of machines.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, ClassVar

import numpy as np
from numba import njit

from twinbench.baselines.filterpy_filters import ukf_predict, ukf_update
from twinbench.baselines.unscented import correct, linear_filter, moments, sigma_points, weights
from twinbench.data.batch import HEALTH, INPUTS, OUTPUTS, SAMPLE_PERIOD_S, STATE, STATES, Array, Batch
from twinbench.data.population import PRIOR_COV, PRIOR_MEAN
from twinbench.methods.estimator import Estimator, Info, Sample, State, register
from twinbench.methods.frontend import FrontEnd, Memory
from twinbench.methods.kalman import INNOVATION_CLIP_SD
from twinbench.methods.noise import coloured_keep, drift_keep, health_walk_var, output_sd
from twinbench.methods.probe import probe_lag
from twinbench.methods.reporting import clean_flags, report
from twinbench.physics.compressor import M_REF_KG_S, PLANT
from twinbench.physics.health import ZETA_HIGH, ZETA_LOW, to_theta, to_zeta
from twinbench.physics.sensors import PRESSURE_DRIFT_SHARE

N_X, N_ZETA, N_NOISE = len(STATES), len(HEALTH) - 1, len(OUTPUTS)
PRESSURE, GAS, FLOW = STATE.p_exh_bar, STATE.T_gas_K, STATE.flow_memory
DRIFT = N_X
ZETA = DRIFT + 1
BIAS = ZETA + N_ZETA
PROBE = BIAS + 1
NOISE = PROBE + 1
SIZE = NOISE + N_NOISE
"""Where each part of z begins. What the network reads stands first: sigma points of the rest move nothing in it."""
VALVE_KEEP = float(np.exp(-SAMPLE_PERIOD_S / PLANT.theta()[PLANT.index("tau_v_s")]))
KEEP = np.r_[0:N_X, ZETA:PROBE]
SUCTION = INPUTS.index("p_suc_bar")
ALPHA = 0.5
W_MEAN, W_COV = weights(SIZE, ALPHA)
STATE_WALK = np.array([1e-3, 1e-3, 0.05, 0.05, 1e-3])
"""Process noise of the states per square root of a second, before ``state_walk``; that of the EKFs."""


@register
class PINNUnscentedKalman(Estimator):
    """Physics-informed multilayer perceptron with an unscented filter."""

    name = "pinn_ukf"
    says = "physics-informed perceptron inside an unscented Kalman filter"
    implementations = ("compiled", "filterpy")
    toy_filter = staticmethod(linear_filter)
    settings: ClassVar[dict[str, Any]] = {
        "iterations": 10000,
        "rows": 1024,
        "copies": 3,
        "transitions": 300_000,
        "learning_rate": 2e-2,
        "physics": 1e-3,
        "hidden": 300,
        "model_noise": 0.01092,
        "state_walk": 3.186,
        "health_walk": 1.244,
        "implementation": "compiled",
    }
    search_space: ClassVar[dict[str, Sequence[float]]] = {
        "learning_rate": [9e-3, 2e-2, 4e-2],
        "physics": [2e-4, 1e-3, 5e-3],
        "model_noise": (0.01, 10.0),
        "state_walk": (0.5, 50.0),
        "health_walk": (0.5, 4.0),
    }
    online = frozenset({"model_noise", "state_walk", "health_walk"})
    contract_settings: ClassVar[dict[str, Any]] = {"iterations": 60, "rows": 128, "copies": 1, "transitions": 3000}

    def fit(self, train: Batch, validation: Batch, seed: int) -> None:
        """Train the network on transitions of training sequences and re-simulations; residuals come from validation."""
        import torch
        from torch.nn import functional

        from twinbench.baselines.perceptron import network_input, perceptron, standard
        from twinbench.methods.resimulate import resimulate
        from twinbench.methods.training import adamw, seeded, weights_of
        from twinbench.methods.transitions import Sampling, draw_transitions

        config = self.config
        rng, _ = seeded(seed)
        train = resimulate(train, rng, config["copies"])
        moves = draw_transitions(train, config["transitions"], rng)
        assert train.truth is not None
        read = network_input(train, moves)
        mean, scale = standard(read)
        step = moves.increment.std(axis=0)
        elsewhere, nominal = _collocation(train, moves, read, rng)

        def tensor(a: Array) -> torch.Tensor:
            return torch.from_numpy(a.astype(np.float32))

        inputs, wanted = tensor((read - mean) / scale), tensor(moves.increment / step)
        beyond, balance = tensor((elsewhere - mean) / scale), tensor(nominal / step)
        network = perceptron(read.shape[1], config["hidden"], N_X)
        quarter = config["rows"] // 4

        def loss(_: int) -> torch.Tensor:
            rows = torch.from_numpy(rng.integers(len(inputs), size=config["rows"]))
            few = rows[:quarter]
            out = network(torch.cat([inputs[rows], beyond[few]]))
            fit = functional.smooth_l1_loss(out[: len(rows)], wanted[rows], beta=0.2)
            return fit + config["physics"] * functional.smooth_l1_loss(out[len(rows) :], balance[few], beta=0.2)

        losses = adamw(network, loss, config["iterations"], config["learning_rate"])
        held = draw_transitions(validation, 20_000, rng, Sampling(perturbed=False))
        states = train.truth.states[..., : N_X + 1].reshape(-1, N_X + 1)[::50]
        self.arrays = {
            **weights_of(network),
            **FrontEnd.fit(train).arrays(),
            "input.mean": mean,
            "input.scale": scale,
            "increment.scale": step,
            "prior.mean": states.mean(axis=0),
            "prior.cov": np.cov(states.T),
            "residual.cov": np.eye(N_X),
            "loss": np.array(losses),
        }
        self.restore()
        residual = held.increment - self._increment(network_input(validation, held))
        self.arrays["residual.cov"] = residual.T @ residual / len(residual)
        self.restore()

    def restore(self) -> None:
        """Rebuild the network and assemble Q."""
        a = self.arrays
        self._front_end = FrontEnd.from_arrays(a)
        self._layers = [(np.ascontiguousarray(a[f"net.{i}.weight"].T), a[f"net.{i}.bias"]) for i in (0, 2, 4)]
        self._keep, self._drift_keep = coloured_keep(), drift_keep()
        Q = np.zeros((SIZE, SIZE))
        Q[:N_X, :N_X] = self.config["model_noise"] * a["residual.cov"]
        Q[:N_X, :N_X] += np.diag((self.config["state_walk"] * STATE_WALK) ** 2 * SAMPLE_PERIOD_S)
        Q[DRIFT, DRIFT] = 1.0 - self._drift_keep**2
        Q[ZETA:PROBE, ZETA:PROBE] = np.diag(health_walk_var(self.config["health_walk"]))
        Q[PROBE, PROBE] = 1e-3**2
        Q[NOISE:, NOISE:] = np.diag(1.0 - self._keep**2)
        self._Q = Q

    def init(self, batch: int) -> State:
        """States as anywhere in the training split, health as anywhere in the population."""
        mean, cov = self.arrays["prior.mean"], self.arrays["prior.cov"]
        where = np.r_[0:N_X, PROBE]
        z = np.zeros((batch, SIZE))
        z[:, where], z[:, ZETA:PROBE] = mean, PRIOR_MEAN
        P = np.tile(np.eye(SIZE), (batch, 1, 1))
        P[:, where[:, None], where], P[:, ZETA:PROBE, ZETA:PROBE] = cov, PRIOR_COV
        memory = (np.zeros(batch, np.bool_), np.zeros((batch, 1)), *self._front_end.init(batch))
        return report(z, P, KEEP, (z, P, *memory))

    def step(self, state: State, sample: Sample) -> tuple[State, Info]:
        """Predict by the network over sigma points, correct by the outputs."""
        z, P, started, valve, *rest = state.memory
        front, clean = self._front_end.step(Memory(*rest), sample.measured)
        u = np.concatenate([clean.before[:, : len(INPUTS)], valve], axis=1)
        white, coloured = output_sd(clean.filled)
        outputs = slice(len(INPUTS), None)
        measured = np.where(clean.accepted[:, outputs], clean.filled[:, outputs], np.nan)
        one_tick = self._tick_filterpy if self.config["implementation"] == "filterpy" else self._tick
        z, P, innovation, S, nis = one_tick(z, P, started, u, measured, white, coloured)
        z[:, FLOW] = np.maximum(z[:, FLOW], 0.05)
        z[:, ZETA:PROBE] = np.clip(z[:, ZETA:PROBE], ZETA_LOW, ZETA_HIGH)
        command = clean.filled[:, len(INPUTS) - 1 : len(INPUTS)]
        valve = np.where(started[:, None], VALVE_KEEP * u[:, -1:] + (1.0 - VALVE_KEEP) * u[:, -2:-1], command)
        memory = (np.ones_like(started), valve, *front)
        info = Info(innovation, S, nis, clean.accepted[:, len(INPUTS) :], clean_flags(clean), clean.age_s)
        return report(z, P, KEEP, (z, P, *memory)), info

    def forecast(self, state: State, inputs: Array) -> Array:
        """Run the network on with the parameters frozen."""
        z, _, _, valve, *rest = state.memory
        z, u = z.copy(), np.concatenate([Memory(*rest).filled[:, : len(INPUTS)], valve], axis=1)
        bias_K = to_theta(z[:, ZETA:PROBE])[:, -1]
        out = np.empty((*inputs.shape[:2], 3))
        for k in range(inputs.shape[1]):
            z = self._moved(z[:, None], u)[:, 0]
            z[:, FLOW] = np.maximum(z[:, FLOW], 0.05)
            out[:, k] = np.stack([z[:, PRESSURE], z[:, PROBE] + bias_K, M_REF_KG_S * z[:, FLOW]], axis=-1)
            valve = VALVE_KEEP * u[:, -1:] + (1.0 - VALVE_KEEP) * u[:, -2:-1]
            u = np.concatenate([inputs[:, k], valve], axis=1)
        return out

    def _tick(
        self, z: Array, P: Array, started: np.ndarray, u: Array, measured: Array, white: Array, coloured: Array
    ) -> tuple[Array, Array, Array, Array, Array]:
        """Compiled apart from the network, which takes all sigma points of all machines at once."""
        sigma = sigma_points(z, P, ALPHA)
        moved = sigma.copy()
        # Of what the network reads, the other sigma points have the centre's.
        few = np.r_[0 : 1 + BIAS, SIZE + 1 : SIZE + 1 + BIAS]
        moved[..., :N_X] += self._increments(sigma, u, few)
        _move_rest(sigma, moved, self._keep, self._drift_keep)
        ahead, P_ahead = moments(moved, W_MEAN, W_COV, self._Q)
        z = np.where(started[:, None], ahead, z)
        P = np.where(started[:, None, None], P_ahead, P)
        sigma = sigma_points(z, P, ALPHA)
        return correct(z, P, sigma, _readings(sigma, coloured), measured, white**2, W_MEAN, W_COV, INNOVATION_CLIP_SD)

    def _tick_filterpy(
        self, z: Array, P: Array, started: np.ndarray, u: Array, measured: Array, white: Array, coloured: Array
    ) -> tuple[Array, Array, Array, Array, Array]:
        """As ``_tick``, by filterpy: the peer that it must equal and is timed against."""
        z, P = z.copy(), P.copy()
        innovation, S, nis = np.empty((len(z), 3)), np.empty((len(z), 3, 3)), np.empty(len(z))
        for b in range(len(z)):

            def move(point: Array, b: int = b) -> Array:
                return self._moved(point[None, None], u[b : b + 1])[0, 0]

            def read(point: Array, b: int = b) -> Array:
                return _readings(point[None, None], coloured[b : b + 1])[0, 0]

            if started[b]:
                z[b], P[b] = ukf_predict(z[b], P[b], self._Q, ALPHA, move)
            R = np.diag(white[b] ** 2)
            z[b], P[b], innovation[b], S[b], nis[b] = ukf_update(
                z[b], P[b], measured[b], R, ALPHA, INNOVATION_CLIP_SD, read
            )
        return z, P, innovation, S, nis

    def _moved(self, points: Array, u: Array) -> Array:
        """Points (B, K, 15) a tick on under inputs and valve (B, 5)."""
        moved = points.copy()
        moved[..., :N_X] += self._increments(points, u, np.arange(points.shape[1]))
        _move_rest(points, moved, self._keep, self._drift_keep)
        return moved

    def _increments(self, points: Array, u: Array, few: np.ndarray) -> Array:
        """Increments (B, K, 5) of the states at points (B, K, 15); all but ``few`` have those of the first."""
        some = points[:, few]
        shared = np.broadcast_to(u[:, None], (*some.shape[:2], u.shape[1]))
        read = np.concatenate([some[..., :N_X], shared, some[..., ZETA:BIAS]], axis=-1)
        read[..., N_X + SUCTION] /= 1.0 + PRESSURE_DRIFT_SHARE * some[..., DRIFT]
        change = self._increment(read)  # one product a machine: what it gives does not depend on who else is there
        if len(few) == points.shape[1]:
            return change
        out = np.repeat(change[:, :1], points.shape[1], axis=1)
        out[:, few] = change
        return out

    def _increment(self, read: Array) -> Array:
        """The network, (..., M, 13) -> (..., M, 5) physical."""
        a = ((read - self.arrays["input.mean"]) / self.arrays["input.scale"]).astype(self._layers[0][0].dtype)
        for weight, bias in self._layers[:-1]:
            a = a @ weight + bias
            a *= 0.5 * (1.0 + np.tanh(0.5 * a))
        weight, bias = self._layers[-1]
        return (a @ weight + bias).astype(np.float64) * self.arrays["increment.scale"]


def _collocation(batch: Batch, moves: Any, read: Array, rng: np.random.Generator) -> tuple[Array, Array]:
    """Other states and health, where only the nominal balances answer.

    Args:
        read: (M, 13) what the network reads of the transitions themselves.

    Returns:
        What it reads there, (M, 13), and the increments (M, 5) that the nominal model gives.
    """
    from twinbench.physics.integrate import Varying, advance
    from twinbench.physics.nominal import NOMINAL

    assert batch.truth is not None
    apart = rng.permutation(len(read))
    x = moves.x + 0.5 * (moves.x[apart] - moves.x)
    theta = moves.theta[apart]
    hidden = batch.truth.states[moves.sequence, moves.sample, N_X:]
    u = batch.truth.inputs[moves.sequence, moves.sample]
    nominal = advance(NOMINAL, np.concatenate([x, hidden], axis=1), u, SAMPLE_PERIOD_S, 2, Varying(HEALTH, theta))
    elsewhere = np.concatenate([x, read[:, N_X:-N_ZETA], to_zeta(theta)[:, :N_ZETA]], axis=1)
    return elsewhere, nominal[:, :N_X] - x


@njit(cache=True, error_model="numpy")
def _move_rest(before, after, keep, drift_keep):  # type: ignore[no-untyped-def]
    """The probe follows the gas, the drift and the coloured noise fade; in place on ``after``."""
    for b in range(before.shape[0]):
        for k in range(before.shape[1]):
            share, _ = probe_lag(before[b, k, FLOW])
            after[b, k, DRIFT] *= drift_keep
            after[b, k, PROBE] += share * (before[b, k, GAS] - before[b, k, PROBE])
            for i in range(N_NOISE):
                after[b, k, NOISE + i] *= keep[i]


def _readings(points: Array, coloured: Array) -> Array:
    """(B, K, 3) of points (B, K, 15), with the drift and the coloured part of the noise, sd (B, 3)."""
    bias_K = to_theta(points[..., ZETA:PROBE])[..., -1]
    p_bar = points[..., PRESSURE] * (1.0 + PRESSURE_DRIFT_SHARE * points[..., DRIFT])
    y = np.stack([p_bar, points[..., PROBE] + bias_K, M_REF_KG_S * points[..., FLOW]], axis=-1)
    return y + coloured[:, None] * points[..., NOISE:]
