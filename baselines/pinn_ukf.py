"""PINN + UKF: a physics-informed perceptron as the model of an unscented Kalman filter.

The network gives the increment of the estimated states over a tick from state, inputs, actuators
and health. It is trained on the plant's transitions, and held to the balances of the nominal model
beyond them (the residual of Raissi et al., 2019, in discrete time). The filter is Julier and
Uhlmann's with Merwe's sigma points; z = [states, the drift that sensors share, health coordinates, those that act on
the machine first, lags of sensors, coloured noise]. It starts from the population of machines.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, ClassVar, NamedTuple

import numpy as np
from numba import njit

from twinbench.baselines.filterpy_filters import ukf_predict, ukf_update
from twinbench.baselines.layout import acting, actuators, layout_of
from twinbench.baselines.model_ekf import EVERY_TICKS
from twinbench.baselines.unscented import correct, linear_filter, moments, sigma_points, weights
from twinbench.data.batch import Array, Batch
from twinbench.machines.compressor import COMPRESSOR
from twinbench.machines.machine import Machine
from twinbench.methods.estimator import Estimator, Info, Sample, State, register
from twinbench.methods.frontend import FrontEnd, Memory
from twinbench.methods.kalman import INNOVATION_CLIP_SD
from twinbench.methods.lags import lag_share, lags_of
from twinbench.methods.noise import coloured_keep, drift_keep, health_walk_var, output_sd, sheet_of
from twinbench.methods.reporting import clean_flags, report

ALPHA = 0.5
LAG_NOISE = 1.0 / 30_000.0
"""Of its scale, process noise of a sensor's lag in a tick: its equation is exact, and this keeps covariances positive
definite."""


class Places(NamedTuple):
    """Where each part of z begins. What the network reads stands first: sigma points of the rest move nothing in it.

    Attributes:
        drift: behind the estimated states.
        zeta: where health begins.
        bias: where health begins that does not act on the machine.
        probe: where lags begin.
        noise: where coloured noise begins.
        size: how many entries z has.
        health: (nh,) dimensionless, of every health parameter, in the machine's order.
        keep: (n + nh,) dimensionless, of the machine's quantities.
        columns: (m,) dimensionless, of the estimated states and the lags.
    """

    drift: int
    zeta: int
    bias: int
    probe: int
    noise: int
    size: int
    health: np.ndarray
    keep: np.ndarray
    columns: np.ndarray


def places_of(machine: Machine) -> Places:
    """Where the parts of a machine's z begin."""
    n, nh, acts = len(machine.estimated), len(machine.health), acting(machine)
    bias, probe = n + 1 + int(acts.sum()), n + 1 + nh
    noise = probe + layout_of(machine).zeta - n
    health = np.empty(nh, np.int64)
    health[acts], health[~acts] = np.arange(n + 1, bias), np.arange(bias, probe)
    keep, columns = np.concatenate([np.arange(n), health]), np.r_[0:n, probe:noise]
    return Places(n, n + 1, bias, probe, noise, noise + len(machine.outputs), health, keep, columns)


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

    def __init__(self, machine: Machine = COMPRESSOR, **settings: Any) -> None:
        super().__init__(machine, **settings)
        self._layout, self._at, self._lags = layout_of(machine), places_of(machine), lags_of(machine)
        self._weights = weights(self._at.size, ALPHA)
        self._moving = np.flatnonzero(np.isin(self._lags.column, self._layout.columns))
        _, inputs = actuators(machine)
        tau_s = self._lags.tau_s[self._lags.input >= 0]
        self._actuators = np.exp(-machine.sample_period_s / tau_s), inputs

    def fit(self, train: Batch, validation: Batch, seed: int) -> None:
        """Train the network on transitions of training sequences and re-simulations; residuals come from validation."""
        import torch
        from torch.nn import functional

        from twinbench.baselines.perceptron import network_input, perceptron, standard
        from twinbench.methods.resimulate import resimulate
        from twinbench.methods.training import adamw, seeded, weights_of
        from twinbench.methods.transitions import Sampling, draw_transitions

        config, n, columns = self.config, len(self.machine.estimated), self._layout.columns
        rng, _ = seeded(seed)
        train = resimulate(train, rng, config["copies"])
        moves = draw_transitions(train, config["transitions"], rng)
        assert train.truth is not None
        read = network_input(train, moves)
        mean, scale = standard(self.machine, read)
        step = moves.increment.std(axis=0)
        elsewhere, nominal = _collocation(train, moves, read, rng)

        def tensor(a: Array) -> torch.Tensor:
            return torch.from_numpy(a.astype(np.float32))

        inputs, wanted = tensor((read - mean) / scale), tensor(moves.increment / step)
        beyond, balance = tensor((elsewhere - mean) / scale), tensor(nominal / step)
        network = perceptron(read.shape[1], config["hidden"], n)
        quarter = config["rows"] // 4

        def loss(_: int) -> torch.Tensor:
            rows = torch.from_numpy(rng.integers(len(inputs), size=config["rows"]))
            few = rows[:quarter]
            out = network(torch.cat([inputs[rows], beyond[few]]))
            fit = functional.smooth_l1_loss(out[: len(rows)], wanted[rows], beta=0.2)
            return fit + config["physics"] * functional.smooth_l1_loss(out[len(rows) :], balance[few], beta=0.2)

        losses = adamw(network, loss, config["iterations"], config["learning_rate"])
        held = draw_transitions(validation, 20_000, rng, Sampling(perturbed=False))
        states = train.truth.states[..., columns].reshape(-1, len(columns))[::EVERY_TICKS]
        self.arrays = {
            **weights_of(network),
            **FrontEnd.fit(train).arrays(),
            "input.mean": mean,
            "input.scale": scale,
            "increment.scale": step,
            "prior.mean": states.mean(axis=0),
            "prior.cov": np.atleast_2d(np.cov(states.T)),
            "residual.cov": np.eye(n),
            "loss": np.array(losses),
        }
        self.restore()
        residual = held.increment - self._increment(network_input(validation, held))
        self.arrays["residual.cov"] = residual.T @ residual / len(residual)
        self.restore()

    def restore(self) -> None:
        """Rebuild the network and assemble Q."""
        a, machine, at = self.arrays, self.machine, self._at
        self._front_end, self._sheet = FrontEnd.from_arrays(a), sheet_of(machine)
        self._layers = [(np.ascontiguousarray(a[f"net.{i}.weight"].T), a[f"net.{i}.bias"]) for i in (0, 2, 4)]
        self._keep, self._drift_keep = coloured_keep(machine), drift_keep(machine)
        n, walk = at.drift, self.config["state_walk"] * machine.states_walk[: at.drift]
        scales = np.array([v.scale for v in machine.plant.states])[self._layout.columns[n:]]
        Q = np.zeros((at.size, at.size))
        Q[:n, :n] = self.config["model_noise"] * a["residual.cov"]
        Q[:n, :n] += np.diag(walk**2 * machine.sample_period_s)
        Q[at.drift, at.drift] = 1.0 - self._drift_keep**2
        Q[at.health, at.health] = health_walk_var(machine, self.config["health_walk"])
        Q[at.probe : at.noise, at.probe : at.noise] = np.diag((LAG_NOISE * scales) ** 2)
        Q[at.noise :, at.noise :] = np.diag(1.0 - self._keep**2)
        self._Q = Q

    def init(self, batch: int) -> State:
        """States as anywhere in the training split, health as anywhere in the population."""
        at, (mean, cov) = self._at, self.machine.prior
        z = np.zeros((batch, at.size))
        z[:, at.columns], z[:, at.health] = self.arrays["prior.mean"], mean
        P = np.tile(np.eye(at.size), (batch, 1, 1))
        P[:, at.columns[:, None], at.columns] = self.arrays["prior.cov"]
        P[:, at.health[:, None], at.health] = cov
        follow = np.zeros((batch, len(self._actuators[1])))
        return self._report(z, P, (np.zeros(batch, np.bool_), follow, *self._front_end.init(batch)))

    def step(self, state: State, sample: Sample) -> tuple[State, Info]:
        """Predict by the network over sigma points, correct by the outputs."""
        nu = len(self.machine.inputs)
        z, P, started, follow, *rest = state.memory
        front, clean = self._front_end.step(Memory(*rest), sample.measured)
        u = np.concatenate([clean.before[:, :nu], follow], axis=1)
        white, coloured = output_sd(self._sheet, clean.filled)
        measured = np.where(clean.accepted, clean.filled, np.nan)[:, nu:]
        one_tick = self._tick_filterpy if self.config["implementation"] == "filterpy" else self._tick
        z, P, innovation, S, nis = one_tick(z, P, started, u, measured, white, coloured)
        self._bound(z)
        command = clean.filled[:, self._actuators[1]]
        follow = np.where(started[:, None], self._followed(u), command)
        info = Info(innovation, S, nis, clean.accepted[:, nu:], clean_flags(clean), clean.age_s)
        return self._report(z, P, (np.ones_like(started), follow, *front)), info

    def forecast(self, state: State, inputs: Array) -> Array:
        """Run the network on with the parameters frozen."""
        z, _, _, follow, *rest = state.memory
        z, u = z.copy(), np.concatenate([Memory(*rest).filled[:, : inputs.shape[-1]], follow], axis=1)
        out = np.empty((*inputs.shape[:2], len(self.machine.outputs)))
        for k in range(inputs.shape[1]):
            z = self._moved(z[:, None], u)[:, 0]
            z[:, : self._at.drift] = np.maximum(z[:, : self._at.drift], self._layout.least[: self._at.drift])
            out[:, k] = self._clean_readings(z)
            u = np.concatenate([inputs[:, k], self._followed(u)], axis=1)
        return out

    def _report(self, z: Array, P: Array, memory: tuple[np.ndarray, ...]) -> State:
        return report(self.machine.coordinates, z, P, self._at.keep, (z, P, *memory))

    def _bound(self, z: Array) -> None:
        """States (B, size) no lower than a filter lets them be and health within its coordinates, in place."""
        n, health = self._at.drift, self._at.health
        z[:, :n] = np.maximum(z[:, :n], self._layout.least[:n])
        z[:, health] = np.clip(z[:, health], *self.machine.zeta_bounds)

    def _followed(self, u: Array) -> Array:
        """Actuators (B, a) a tick on, from inputs and actuators (B, nu + a)."""
        kept, inputs = self._actuators
        return kept * u[:, u.shape[1] - len(kept) :] + (1.0 - kept) * u[:, inputs]

    def _tick(
        self, z: Array, P: Array, started: np.ndarray, u: Array, measured: Array, white: Array, coloured: Array
    ) -> tuple[Array, Array, Array, Array, Array]:
        """Compiled apart from the network, which takes all sigma points of all machines at once."""
        sigma = sigma_points(z, P, ALPHA)
        moved = sigma.copy()
        # Of what the network reads, the other sigma points have the centre's.
        at, (w_mean, w_cov) = self._at, self._weights
        few = np.r_[0 : 1 + at.bias, at.size + 1 : at.size + 1 + at.bias]
        moved[..., : at.drift] += self._increments(sigma, u, few)
        self._move_rest(sigma, moved, u)
        ahead, P_ahead = moments(moved, w_mean, w_cov, self._Q)
        z = np.where(started[:, None], ahead, z)
        P = np.where(started[:, None, None], P_ahead, P)
        sigma = sigma_points(z, P, ALPHA)
        readings = self._readings(sigma, coloured)
        return correct(z, P, sigma, readings, measured, white**2, w_mean, w_cov, INNOVATION_CLIP_SD)

    def _tick_filterpy(
        self, z: Array, P: Array, started: np.ndarray, u: Array, measured: Array, white: Array, coloured: Array
    ) -> tuple[Array, Array, Array, Array, Array]:
        """As ``_tick``, by filterpy: the peer that it must equal and is timed against."""
        z, P = z.copy(), P.copy()
        ny = measured.shape[1]
        innovation, S, nis = np.empty((len(z), ny)), np.empty((len(z), ny, ny)), np.empty(len(z))
        for b in range(len(z)):

            def move(point: Array, b: int = b) -> Array:
                return self._moved(point[None, None], u[b : b + 1])[0, 0]

            def read(point: Array, b: int = b) -> Array:
                return self._readings(point[None, None], coloured[b : b + 1])[0, 0]

            if started[b]:
                z[b], P[b] = ukf_predict(z[b], P[b], self._Q, ALPHA, move)
            R = np.diag(white[b] ** 2)
            z[b], P[b], innovation[b], S[b], nis[b] = ukf_update(
                z[b], P[b], measured[b], R, ALPHA, INNOVATION_CLIP_SD, read
            )
        return z, P, innovation, S, nis

    def _moved(self, points: Array, u: Array) -> Array:
        """Points (B, K, size) a tick on under inputs and actuators (B, nu + a)."""
        moved = points.copy()
        moved[..., : self._at.drift] += self._increments(points, u, np.arange(points.shape[1]))
        self._move_rest(points, moved, u)
        return moved

    def _increments(self, points: Array, u: Array, few: np.ndarray) -> Array:
        """Increments (B, K, n) of the states at points (B, K, size); all but ``few`` have those of the first."""
        some, at, nu = points[:, few], self._at, len(self.machine.inputs)
        shared = np.broadcast_to(u[:, None], (*some.shape[:2], u.shape[1]))
        read = np.concatenate([some[..., : at.drift], shared, some[..., at.zeta : at.bias]], axis=-1)
        for i, share in enumerate(self.machine.drift_shares[:nu]):
            if share > 0.0:
                read[..., at.drift + i] /= 1.0 + share * some[..., at.drift]
        change = self._increment(read)  # one product a machine: what it gives does not depend on who else is there
        if len(few) == points.shape[1]:
            return change
        out = np.repeat(change[:, :1], points.shape[1], axis=1)
        out[:, few] = change
        return out

    def _increment(self, read: Array) -> Array:
        """The network, (..., M, F) -> (..., M, n) physical."""
        a = ((read - self.arrays["input.mean"]) / self.arrays["input.scale"]).astype(self._layers[0][0].dtype)
        for weight, bias in self._layers[:-1]:
            a = a @ weight + bias
            a *= 0.5 * (1.0 + np.tanh(0.5 * a))
        weight, bias = self._layers[-1]
        return (a @ weight + bias).astype(np.float64) * self.arrays["increment.scale"]

    def _move_rest(self, before: Array, after: Array, u: Array) -> None:
        _move_rest(before, after, u, self._keep, self._drift_keep, self._lags, self._moving, self._at[:5])

    def _clean_readings(self, points: Array) -> Array:
        """(..., ny) of points (..., size), without drift and noise."""
        theta = self.machine.coordinates.to_theta(points[..., self._at.health])
        return points[..., self._at.columns] @ self._layout.gains.T + theta @ self._layout.biases.T

    def _readings(self, points: Array, coloured: Array) -> Array:
        """(B, K, ny) of points (B, K, size), with the drift and the coloured part of the noise, sd (B, ny)."""
        shares = self.machine.drift_shares[len(self.machine.inputs) :]
        y = self._clean_readings(points) * (1.0 + shares * points[..., self._at.drift, None])
        return y + coloured[:, None] * points[..., self._at.noise :]


def _collocation(batch: Batch, moves: Any, read: Array, rng: np.random.Generator) -> tuple[Array, Array]:
    """Other states and health, where only the nominal balances answer.

    Args:
        read: (M, F) what the network reads of the transitions themselves.

    Returns:
        What it reads there, (M, F), and the increments (M, n) that the nominal model gives.
    """
    from twinbench.physics.integrate import Varying, advance

    assert batch.truth is not None
    apart = rng.permutation(len(read))
    x = moves.x + 0.5 * (moves.x[apart] - moves.x)
    theta = moves.theta[apart]
    machine, n = batch.machine, x.shape[1]
    hidden = batch.truth.states[moves.sequence, moves.sample, n:]
    u = batch.truth.inputs[moves.sequence, moves.sample]
    varying = Varying(machine.health_names, theta)
    nominal = advance(machine.reduced, np.concatenate([x, hidden], axis=1), u, machine.sample_period_s, 2, varying)
    zeta = machine.coordinates.to_zeta(theta)[:, acting(machine)]
    elsewhere = np.concatenate([x, read[:, n : read.shape[1] - zeta.shape[1]], zeta], axis=1)
    return elsewhere, nominal[:, :n] - x


@njit(cache=True, error_model="numpy")
def _move_rest(before, after, u, keep, drift_keep, lags, moving, places):  # type: ignore[no-untyped-def]
    """Lags follow their states or inputs, the drift and the coloured noise fade; in place on ``after``."""
    drift, _, _, probe, noise = places
    for b in range(before.shape[0]):
        for k in range(before.shape[1]):
            after[b, k, drift] *= drift_keep
            for j in range(moving.size):
                i = moving[j]
                share, _ = lag_share(lags, i, before[b, k])
                followed = before[b, k, lags.state[i]] if lags.state[i] >= 0 else u[b, lags.input[i]]
                after[b, k, probe + j] += share * (followed - before[b, k, probe + j])
            for i in range(keep.size):
                after[b, k, noise + i] *= keep[i]
