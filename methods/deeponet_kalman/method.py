"""DeepONet-Kalman: the operator as the model of an augmented extended Kalman filter, Eqs. (1)-(14)."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any, ClassVar

import numpy as np

from twinbench.common.errors import BadInput
from twinbench.data.batch import Array, Batch
from twinbench.machines.machine import Machine
from twinbench.methods.deeponet_kalman.cycle import (
    keep_of,
    memory_type,
    roll_out,
    said_type,
    scaling_of,
    scratch,
    twin_record,
    update,
)
from twinbench.methods.deeponet_kalman.delayed import Filter, fixed_lag
from twinbench.methods.deeponet_kalman.layout import pack
from twinbench.methods.deeponet_kalman.model import model_of
from twinbench.methods.deeponet_kalman.parts import followers, parts_of
from twinbench.methods.deeponet_kalman.safeguards import Envelope, Settings, empty_safety
from twinbench.methods.estimator import Estimator, Info, Sample, State, register
from twinbench.methods.frontend import THRESHOLD, FrontEnd
from twinbench.methods.kalman import linear_filter
from twinbench.methods.modes import at_first, modes_of
from twinbench.methods.noise import coloured_keep
from twinbench.methods.operator import acting
from twinbench.methods.reporting import report

ENVELOPE = (0.001, 0.999)
"""Quantiles of each training query that bound the envelope."""
LAG_MOVES = 1 / 30_000
"""Of a lag's scale: its process noise in a tick, for round-off alone. More lets a probe differ from what it follows."""
LEAST_COSINE, MOST_SIZE = 0.9, 1.5
"""The checkpoint rule: how well the operator's sensitivities to health agree with the plant's in direction, and by
which factor their size may differ. Stricter ones refuse short trainings. Laxer ones let health be corrected the wrong
way."""


def check_audit(machine: Machine, cosine: Array, size: Array) -> None:
    """Refuse an operator whose sensitivities to health are not the machine's.

    Args:
        machine: whose.
        cosine: (na,) dimensionless, agreement in direction of the sensitivities to each health parameter that acts on
            the machine with the plant's.
        size: (na,) dimensionless, their size over the plant's.

    Raises:
        BadInput: which parameter, and what the audit found.
    """
    names = [machine.health_names[i] for i in acting(machine)]
    for name, agreement, ratio in zip(names, cosine, size, strict=True):
        if not (agreement > LEAST_COSINE and 1.0 / MOST_SIZE < ratio < MOST_SIZE):
            raise BadInput(
                f"deeponet_kalman: the operator fails its audit: its sensitivity to {name} has cosine {agreement:.3g}"
                f" with the plant's (more than {LEAST_COSINE:g} is needed) and {ratio:.3g} of its size"
                f" ({1.0 / MOST_SIZE:.2g} to {MOST_SIZE:g}); train it longer, or on more recordings"
            )


@register
class DeepONetKalman(Estimator):
    """The proposed method."""

    name = "deeponet_kalman"
    says = "operator network inside an augmented Kalman filter (the proposed method)"
    window = 64
    delayed = True
    toy_filter = staticmethod(linear_filter)
    settings: ClassVar[dict[str, Any]] = {
        "iterations": 12000,
        "windows": 384,
        "copies": 3,
        "transitions": 300_000,
        "each": 3,
        "learning_rate": 1e-2,
        "smoothness": 1e-3,
        "feasibility": 0.1,
        "counterfactual": True,
        "conditioned": True,
        "augmented": True,
        "stratified": True,
        "refinement": 100,
        "window": 64,
        "update_every": 1,
        "model_noise": 4.228,
        "slow_error": 0.5062,
        "error_tau_s": 183.0,
        "health_walk": 2.0,
        "still": 0.04,
        "leap": 2.0,
        "trust_reach": 1.0,
        "extrapolation": 1.0,
        "least_information": 0.0429,
        "q_gain": 0.005678,
        "q_most": 30.0,
        "r_gain": 1.0,
        "r_most": 25.0,
        "hampel": True,
        "channel_gate": 6.0,
        "difference": 0.0,
        "audited": True,
    }
    search_space: ClassVar[dict[str, Sequence[float]]] = {
        "learning_rate": [5e-3, 1e-2, 2e-2],
        "model_noise": (0.5, 10.0),
        "slow_error": (0.3, 4.0),
        "error_tau_s": (100.0, 1500.0),
        "health_walk": (0.5, 4.0),
        "still": (0.01, 0.5),
        "leap": (0.5, 10.0),
        "least_information": (0.03, 3.0),
    }
    online = frozenset(
        {
            *Settings._fields,
            *("hampel", "update_every", "model_noise", "slow_error", "error_tau_s", "audited"),
            *("health_walk", "still", "leap"),
        }
    )
    ablations: ClassVar[dict[str, dict[str, Any]]] = {
        "no_covariance_adaptation": {"q_gain": 0.0, "r_gain": 0.0},
        "no_feasibility": {"feasibility": 0.0},
        "finite_differences": {"difference": 0.01},
        "no_trust": {"trust_reach": np.inf, "extrapolation": 0.0},
        "trust_alone": {"extrapolation": 0.0},
        "extrapolation_alone": {"trust_reach": np.inf},
        "no_counterfactuals": {"counterfactual": False, "audited": False},
        "no_conditioning": {"conditioned": False, "audited": False},
        "no_observability": {"least_information": 0.0},
        "no_gate": {"channel_gate": np.inf, "hampel": False},
        "no_modes": {"still": 1.0, "leap": 0.0, "health_walk": 0.597},
        "no_slow_errors": {"slow_error": 0.0},
        "no_augmentation": {"augmented": False},
        "no_strata": {"stratified": False},
        "no_refinement": {"refinement": 0},
        **{f"window_{n}": {"window": n} for n in (16, 32, 128, 256)},
        "update_10_hz": {"update_every": 2},
        "update_5_hz": {"update_every": 4},
    }
    contract_settings: ClassVar[dict[str, Any]] = {
        "iterations": 60,
        "windows": 64,
        "copies": 1,
        "transitions": 3000,
        "audited": False,
    }

    def fit(self, train: Batch, validation: Batch, seed: int) -> None:
        """Train the operator on the training sequences and their re-simulations; residuals come from validation."""
        from twinbench.methods.deeponet_kalman.operator_training import HORIZONS, Recipe, Scales, audit, fit_operator
        from twinbench.methods.deeponet_kalman.windows import WindowSource
        from twinbench.methods.operator import Operator
        from twinbench.methods.resimulate import resimulate
        from twinbench.methods.training import seeded, weights_of
        from twinbench.methods.transitions import Sampling, draw_transitions

        config, machine = self.config, self.machine
        rng, _ = seeded(seed)
        train = resimulate(train, rng, config["copies"])
        front_end = FrontEnd.fit(train)
        window = config["window"]
        source = WindowSource.fit(train, front_end, window)
        horizons = tuple(ticks * machine.sample_period_s for ticks in HORIZONS)
        how = Sampling(window, horizons, config["each"], config["counterfactual"], config["stratified"])
        transitions = draw_transitions(train, config["transitions"], rng, how)
        scales = Scales.fit(machine, transitions)
        operator = Operator(machine, window=window)
        recipe = Recipe(**{field.name: config[field.name] for field in dataclasses.fields(Recipe)})
        losses = fit_operator(operator, source, transitions, scales, rng, recipe)
        held_out = WindowSource(validation, front_end, source.query_mean, source.query_scale, window)
        checked = audit(operator, held_out, validation, scales, rng)
        envelope = np.quantile(source.query[:, ::20], ENVELOPE, axis=(0, 1))
        assert train.truth is not None
        names = [v.name for v in machine.plant.states]
        moving = [names.index(name) for name in (*machine.estimated, *(lag.state for lag in followers(machine)))]
        states = train.truth.states[..., moving].reshape(-1, len(moving))
        self.arrays = {
            **weights_of(operator),
            **front_end.arrays(),
            "query.mean": source.query_mean,
            "query.scale": source.query_scale,
            "query.low": envelope[0],
            "query.high": envelope[1],
            "scales.state_mean": scales.state_mean,
            "scales.state_scale": scales.state_scale,
            "scales.increment": scales.increment,
            "audit.residual_cov": checked.residual_cov,
            "audit.slow_sd": checked.slow_sd,
            "audit.first_sd": checked.first_sd,
            "audit.G_cosine": checked.G_cosine,
            "audit.G_size": checked.G_size,
            "audit.F_cosine": checked.F_cosine,
            "prior.mean": states.mean(axis=0),
            "prior.cov": np.atleast_2d(np.cov(states[::50].T)),
            "loss": np.array(losses),
        }
        self.restore()

    def restore(self) -> None:
        """Pack the weights and assemble Q, if the operator passes its audit.

        Sets ``parts``, ``weights``, ``front_end``, ``model`` and ``scaling``, ``twin``, the last three in one record,
        and ``room`` for one update.
        """
        a, machine = self.arrays, self.machine
        if self.config["audited"]:
            check_audit(machine, a["audit.G_cosine"], a["audit.G_size"])
        self.parts = parts_of(machine)
        self.weights = pack(machine, a)
        self.front_end = FrontEnd.from_arrays(a, THRESHOLD if self.config["hampel"] else np.inf)
        error_keep = float(np.exp(-machine.sample_period_s / self.config["error_tau_s"]))
        self.model = model_of(
            machine,
            (a["scales.state_mean"], a["scales.state_scale"], a["scales.increment"]),
            self._process_noise(error_keep),
            error_keep,
            Settings(*(self.config[name] for name in Settings._fields)),
            Envelope(a["query.low"], a["query.high"]),
            modes_of(machine, *(self.config[name] for name in ("health_walk", "still", "leap"))),
        )
        self.scaling = scaling_of(machine, a["query.mean"], a["query.scale"])
        every = self.config["update_every"]
        self.twin = twin_record(self.model, self.front_end.fitted, self.scaling, self.parts, every)
        self.room = scratch(self.weights, self.parts)
        self._fresh = self._before_the_first_sample()

    def _process_noise(self, error_keep: float) -> Array:
        """Q (N, N) of one tick but for the walk of health, in the units of z squared."""
        parts, machine = self.parts, self.machine
        n, lag = parts.states, slice(parts.states, parts.zeta)
        noise, error = slice(parts.noise, parts.error), slice(parts.error, parts.size)
        Q = np.zeros((parts.size, parts.size))
        Q[:n, :n] = self.config["model_noise"] * self.arrays["audit.residual_cov"]
        scales = np.array([machine.variables[follower.state].scale for follower in followers(machine)])
        Q[lag, lag] = np.diag((LAG_MOVES * scales) ** 2)
        Q[noise, noise] = np.diag(1.0 - coloured_keep(machine) ** 2)
        Q[error, error] = np.diag((1.0 - error_keep**2) * self._error_var("slow"))
        return Q

    def _error_var(self, when: str) -> Array:
        """Variance (n,) of the operator's slow errors, ``first`` or later, in the states' units squared."""
        return np.asarray((self.config["slow_error"] * self.arrays[f"audit.{when}_sd"]) ** 2)

    def _before_the_first_sample(self) -> np.ndarray:
        """Memory (1,): states as anywhere in the training split, health as anywhere in the population."""
        parts, (mean, cov) = self.parts, self.machine.prior
        fresh = np.zeros(1, memory_type(self.weights, parts))
        for name, part in self.front_end.init(1)._asdict().items():
            fresh[name] = part
        fresh["safety"] = empty_safety(parts, 1)
        fresh["z"][:, : parts.zeta] = self.arrays["prior.mean"]
        fresh["z"][:, parts.zeta : parts.noise] = mean
        P, health, error = fresh["P"][0], slice(parts.zeta, parts.noise), slice(parts.error, parts.size)
        P[: parts.zeta, : parts.zeta] = self.arrays["prior.cov"]
        P[health, health] = cov
        P[parts.noise : parts.error, parts.noise : parts.error] = np.eye(parts.outputs)
        P[error, error] = np.diag(self._error_var("first"))
        modes = fresh["modes"][0]
        modes["mu"], modes["z"], modes["P"] = at_first(self.model.modes), fresh["z"], P
        return fresh

    def init(self, batch: int) -> State:
        """States as anywhere in the training split, health as anywhere in the population."""
        memory = np.repeat(self._fresh, batch)
        z, P = np.ascontiguousarray(memory["z"]), np.ascontiguousarray(memory["P"])
        return report(self.machine.coordinates, z, P, keep_of(self.parts), (memory,))

    def step(self, state: State, sample: Sample) -> tuple[State, Info]:
        """Forecast by the operator, correct by the outputs, let the window take the sample in."""
        memory = state.memory[0].copy()
        said = np.empty(len(memory), said_type(self.parts))
        measured = np.ascontiguousarray(sample.measured, dtype=np.float64)
        lag_s = np.zeros(measured.shape) if sample.lag_s is None else np.asarray(sample.lag_s, dtype=np.float64)
        update(self.weights, self.twin, memory, measured, lag_s, said, self.room)
        state = State(said["mean"], said["cov"], said["low"], said["high"], (memory,))
        accepted = said["accepted"].view(np.bool_)
        return state, Info(said["innovation"], said["S"], said["nis"], accepted, said["flags"], said["age_s"])

    def forecast(self, state: State, inputs: Array) -> Array:
        """Roll the operator out, feeding its own readings back into the window."""
        out = np.empty((*inputs.shape[:2], self.parts.outputs))
        inputs = np.ascontiguousarray(inputs, dtype=np.float64)
        roll_out(self.weights, self.twin, state.memory[0].copy(), inputs, out, self.room)
        return out

    def smooth(self, measured: Array, ticks: np.ndarray, delay_s: float = np.inf) -> State:
        """What is known of ticks a stated while later: ``methods.deeponet_kalman.delayed``."""
        delay = round(min(delay_s / self.machine.sample_period_s, measured.shape[1]))
        model = Filter(self.weights, self.twin, self.room, self._fresh, self.parts)
        z, P = zip(*(fixed_lag(model, own, ticks, delay) for own in measured), strict=True)
        return report(self.machine.coordinates, np.concatenate(z), np.concatenate(P), keep_of(self.parts), ())
