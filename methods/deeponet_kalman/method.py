"""DeepONet-Kalman: the operator as the model of an augmented extended Kalman filter, Eqs. (1)-(14)."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any, ClassVar

import numpy as np

from twinbench.common.errors import BadInput
from twinbench.data.batch import HEALTH, SAMPLE_PERIOD_S, STATES, Array, Batch
from twinbench.data.population import PRIOR_COV, PRIOR_MEAN
from twinbench.methods.deeponet_kalman.cycle import (
    KEEP,
    SAID,
    Scaling,
    memory_type,
    roll_out,
    scratch,
    twin_record,
    update,
)
from twinbench.methods.deeponet_kalman.layout import pack
from twinbench.methods.deeponet_kalman.model import ERROR, NOISE, SIZE, ZETA, Model
from twinbench.methods.deeponet_kalman.safeguards import N_OUTPUTS, Envelope, Settings, empty_safety
from twinbench.methods.estimator import Estimator, Info, Sample, State, register
from twinbench.methods.frontend import THRESHOLD, FrontEnd
from twinbench.methods.kalman import linear_filter
from twinbench.methods.noise import coloured_keep, health_walk_var
from twinbench.methods.reporting import report
from twinbench.physics.health import to_zeta

ZETA_LOW = to_zeta(np.array([0.75, 0.75, 0.002, 0.30, -11.0]))
ZETA_HIGH = to_zeta(np.array([1.08, 1.08, 0.12, 1.40, 11.0]))
ENVELOPE = (0.001, 0.999)
"""Quantiles of each training query that bound the envelope."""
LEAST_COSINE, MOST_SIZE = 0.9, 1.5
"""The checkpoint rule: how well the operator's sensitivities to health agree with the plant's in direction, and by
which factor their size may differ. Stricter ones refuse short trainings. Laxer ones let health be corrected the wrong
way."""


def check_audit(cosine: Array, size: Array) -> None:
    """Refuse an operator whose sensitivities to health are not the machine's.

    Args:
        cosine: (4,) dimensionless, agreement in direction of each health parameter's sensitivities with the plant's.
        size: (4,) dimensionless, their size over the plant's.

    Raises:
        BadInput: which parameter, and what the audit found.
    """
    for name, agreement, ratio in zip(HEALTH, cosine, size, strict=False):
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
        "health_walk": 0.597,
        "trust_reach": 1.0,
        "extrapolation": 1.0,
        "least_information": 0.0429,
        "q_gain": 0.005678,
        "q_most": 30.0,
        "r_gain": 1.0,
        "r_most": 25.0,
        "hampel": True,
        "channel_gate": 6.0,
        "rollback": True,
        "steps": True,
        "leap": 3.0,
        "weighed_s": 10.0,
        "inflation": 8.132,
        "difference": 0.0,
        "audited": True,
    }
    search_space: ClassVar[dict[str, Sequence[float]]] = {
        "learning_rate": [5e-3, 1e-2, 2e-2],
        "model_noise": (0.5, 10.0),
        "slow_error": (0.3, 4.0),
        "error_tau_s": (100.0, 1500.0),
        "health_walk": (0.5, 4.0),
        "q_gain": (0.005, 0.1),
        "inflation": (1.5, 10.0),
        "least_information": (0.03, 3.0),
    }
    online = frozenset(
        {
            *Settings._fields,
            *("hampel", "update_every", "model_noise", "slow_error", "error_tau_s", "health_walk", "audited"),
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
        "no_rollback": {"rollback": False},
        "no_steps": {"steps": False},
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
        from twinbench.methods.deeponet_kalman.operator_training import HORIZONS_S, Recipe, Scales, audit, fit_operator
        from twinbench.methods.deeponet_kalman.windows import WindowSource
        from twinbench.methods.operator import Operator
        from twinbench.methods.resimulate import resimulate
        from twinbench.methods.training import seeded, weights_of
        from twinbench.methods.transitions import Sampling, draw_transitions

        config = self.config
        rng, _ = seeded(seed)
        train = resimulate(train, rng, config["copies"])
        front_end = FrontEnd.fit(train)
        window = config["window"]
        source = WindowSource.fit(train, front_end, window)
        how = Sampling(window, HORIZONS_S, config["each"], config["counterfactual"], config["stratified"])
        transitions = draw_transitions(train, config["transitions"], rng, how)
        scales = Scales.fit(transitions)
        operator = Operator(window=window)
        recipe = Recipe(**{field.name: config[field.name] for field in dataclasses.fields(Recipe)})
        losses = fit_operator(operator, source, transitions, scales, rng, recipe)
        held_out = WindowSource(validation, front_end, source.query_mean, source.query_scale, window)
        checked = audit(operator, held_out, validation, scales, rng)
        envelope = np.quantile(source.query[:, ::20], ENVELOPE, axis=(0, 1))
        assert train.truth is not None
        states = train.truth.states[..., : len(STATES) + 1].reshape(-1, len(STATES) + 1)
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
            "prior.cov": np.cov(states[::50].T),
            "loss": np.array(losses),
        }
        self.restore()

    def restore(self) -> None:
        """Pack the weights and assemble Q, if the operator passes its audit.

        Sets ``weights``, ``front_end``, ``model`` and ``scaling``, and ``twin``, the last three in one record.
        """
        a = self.arrays
        if self.config["audited"]:
            check_audit(a["audit.G_cosine"], a["audit.G_size"])
        self.weights = pack(a)
        self.front_end = FrontEnd.from_arrays(a, THRESHOLD if self.config["hampel"] else np.inf)
        Q = np.zeros((SIZE, SIZE))
        Q[:5, :5] = self.config["model_noise"] * a["audit.residual_cov"]
        Q[5, 5] = 1e-3**2
        Q[ZETA:NOISE, ZETA:NOISE] = np.diag(health_walk_var(self.config["health_walk"]))
        keep = coloured_keep()
        Q[NOISE:ERROR, NOISE:ERROR] = np.diag(1.0 - keep**2)
        error_keep = float(np.exp(-SAMPLE_PERIOD_S / self.config["error_tau_s"]))
        error_var, first_error_var = ((self.config["slow_error"] * a[f"audit.{n}_sd"]) ** 2 for n in ("slow", "first"))
        Q[ERROR:, ERROR:] = np.diag((1.0 - error_keep**2) * error_var)
        self.model = Model(
            a["scales.state_mean"],
            a["scales.state_scale"],
            a["scales.increment"],
            Q,
            keep,
            error_keep,
            ZETA_LOW,
            ZETA_HIGH,
            Settings(*(self.config[name] for name in Settings._fields)),
            Envelope(a["query.low"], a["query.high"]),
            np.sqrt(np.diag(PRIOR_COV)),
        )
        self.scaling = Scaling(a["query.mean"], a["query.scale"])
        self.twin = twin_record(self.model, self.front_end.fitted, self.scaling, self.config["update_every"])
        self._scratch = scratch(self.weights)
        self._fresh = np.zeros(1, memory_type(self.weights))
        for name, part in self.front_end.init(1)._asdict().items():
            self._fresh[name] = part
        self._fresh["safety"] = empty_safety(1)
        self._fresh["safety"]["valid"] = PRIOR_MEAN, self.model.prior_sd
        self._fresh["z"][:, :ZETA] = a["prior.mean"]
        self._fresh["z"][:, ZETA:NOISE] = PRIOR_MEAN
        P = self._fresh["P"][0]
        P[:ZETA, :ZETA] = a["prior.cov"]
        P[ZETA:NOISE, ZETA:NOISE] = PRIOR_COV
        P[NOISE:ERROR, NOISE:ERROR] = np.eye(N_OUTPUTS)
        P[ERROR:, ERROR:] = np.diag(first_error_var)

    def init(self, batch: int) -> State:
        """States as anywhere in the training split, health as anywhere in the population."""
        memory = np.repeat(self._fresh, batch)
        return report(np.ascontiguousarray(memory["z"]), np.ascontiguousarray(memory["P"]), KEEP, (memory,))

    def step(self, state: State, sample: Sample) -> tuple[State, Info]:
        """Forecast by the operator, correct by the outputs, let the window take the sample in."""
        memory = state.memory[0].copy()
        said = np.empty(len(memory), SAID)
        measured = np.ascontiguousarray(sample.measured, dtype=np.float64)
        lag_s = np.zeros(measured.shape) if sample.lag_s is None else np.asarray(sample.lag_s, dtype=np.float64)
        update(self.weights, self.twin, memory, measured, lag_s, said, self._scratch)
        state = State(said["mean"], said["cov"], said["low"], said["high"], (memory,))
        accepted = said["accepted"].view(np.bool_)
        return state, Info(said["innovation"], said["S"], said["nis"], accepted, said["flags"], said["age_s"])

    def forecast(self, state: State, inputs: Array) -> Array:
        """Roll the operator out, feeding its own readings back into the window."""
        out = np.empty((*inputs.shape[:2], N_OUTPUTS))
        inputs = np.ascontiguousarray(inputs, dtype=np.float64)
        roll_out(self.weights, self.twin, state.memory[0].copy(), inputs, out, self._scratch)
        return out
