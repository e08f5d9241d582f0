"""DeepONet-Kalman: the operator as the model of an augmented extended Kalman filter, Eqs. (1)-(12)."""

from __future__ import annotations

from typing import Any, ClassVar

import numpy as np

from data.batch import HEALTH, SAMPLE_PERIOD_S, STATES, Array, Batch
from methods.augmented import ERROR, NOISE, SIZE, ZETA, Model, roll_out, tick
from methods.estimator import Estimator, Info, Sample, State, register
from methods.frontend import FrontEnd, Memory
from methods.kalman import linear_filter
from methods.noise import coloured_keep, output_sd
from methods.reporting import clean_flags, report
from methods.stream import Stream, empty_stream, pack
from methods.windows import query_of
from physics.health import d_theta_d_zeta, theta_and_slope, to_theta, to_zeta

ZETA_LOW = to_zeta(np.array([0.75, 0.75, 0.002, 0.30, -11.0]))
ZETA_HIGH = to_zeta(np.array([1.08, 1.08, 0.12, 1.40, 11.0]))
INNOVATION_CLIP_SD = 6.0


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
        "transitions": 300_000,
        "each": 3,
        "learning_rate": 1e-2,
        "smoothness": 1e-3,
        "feasibility": 0.1,
        "model_noise": 2.0,
        "slow_error": 0.3,
        "error_tau_s": 120.0,
        "capacity_walk": 4e-4,
        "efficiency_walk": 4e-4,
        "leakage_walk": 1.2e-4,
        "heat_transfer_walk": 2e-3,
        "T_bias_K_walk": 0.05,
    }
    search_space: ClassVar[dict[str, tuple[float, float]]] = {
        "learning_rate": (2e-3, 2e-2),
        "model_noise": (1.0, 30.0),
        "slow_error": (0.1, 3.0),
        "capacity_walk": (1e-4, 2e-3),
        "efficiency_walk": (1e-4, 2e-3),
        "leakage_walk": (3e-5, 5e-4),
        "heat_transfer_walk": (5e-4, 1e-2),
        "T_bias_K_walk": (0.01, 0.2),
    }
    contract_settings: ClassVar[dict[str, Any]] = {"iterations": 60, "windows": 64, "transitions": 3000}

    def fit(self, train: Batch, validation: Batch, seed: int) -> None:
        """Train the operator on the training split; take its residuals from the validation split."""
        from methods.operator import Operator
        from methods.operator_training import HORIZONS_S, LossWeights, Scales, audit, fit_operator
        from methods.training import seeded, weights_of
        from methods.transitions import draw_transitions
        from methods.windows import WindowSource

        config = self.config
        rng, _ = seeded(seed)
        front_end = FrontEnd.fit(train)
        source = WindowSource.fit(train, front_end)
        transitions = draw_transitions(train, config["transitions"], rng, dt_s=HORIZONS_S, each=config["each"])
        scales = Scales.fit(transitions)
        operator = Operator()
        losses = fit_operator(
            operator,
            source,
            transitions,
            scales,
            rng,
            config["iterations"],
            config["windows"],
            config["learning_rate"],
            LossWeights(config["smoothness"], config["feasibility"]),
        )
        held_out = WindowSource(validation, front_end, source.query_mean, source.query_scale)
        checked = audit(operator, held_out, validation, scales, rng)
        assert train.truth is not None
        states = train.truth.states[..., : len(STATES) + 1].reshape(-1, len(STATES) + 1)
        self.arrays = {
            **weights_of(operator),
            **front_end.arrays(),
            "query.mean": source.query_mean,
            "query.scale": source.query_scale,
            "scales.state_mean": scales.state_mean,
            "scales.state_scale": scales.state_scale,
            "scales.increment": scales.increment,
            "audit.residual_cov": checked.residual_cov,
            "audit.slow_sd": checked.slow_sd,
            "audit.G_cosine": checked.G_cosine,
            "audit.G_size": checked.G_size,
            "audit.F_cosine": checked.F_cosine,
            "prior.mean": states.mean(axis=0),
            "prior.cov": np.cov(states[::50].T),
            "loss": np.array(losses),
        }
        self.restore()

    def restore(self) -> None:
        """Pack the weights and assemble Q."""
        a = self.arrays
        self._weights = pack(a)
        self._front_end = FrontEnd.from_arrays(a)
        self._scaling = (self._front_end.mean, self._front_end.scale, a["query.mean"], a["query.scale"])
        walk = np.array([self.config[f"{name}_walk"] for name in HEALTH])
        Q = np.zeros((SIZE, SIZE))
        Q[:5, :5] = self.config["model_noise"] * a["audit.residual_cov"]
        Q[5, 5] = 1e-3**2
        Q[ZETA:NOISE, ZETA:NOISE] = np.diag((walk / d_theta_d_zeta(np.zeros(5))) ** 2 * SAMPLE_PERIOD_S)
        keep = coloured_keep()
        Q[NOISE:ERROR, NOISE:ERROR] = np.diag(1.0 - keep**2)
        error_keep = float(np.exp(-SAMPLE_PERIOD_S / self.config["error_tau_s"]))
        self._error_var = (self.config["slow_error"] * a["audit.slow_sd"]) ** 2
        Q[ERROR:, ERROR:] = np.diag((1.0 - error_keep**2) * self._error_var)
        self._model = Model(
            a["scales.state_mean"],
            a["scales.state_scale"],
            a["scales.increment"],
            Q,
            keep,
            error_keep,
            ZETA_LOW,
            ZETA_HIGH,
        )

    def init(self, batch: int) -> State:
        """States as anywhere in the training split, a healthy machine."""
        z = np.zeros((batch, SIZE))
        z[:, : ZETA] = self.arrays["prior.mean"]
        P = np.zeros((batch, SIZE, SIZE))
        P[:, :ZETA, :ZETA] = self.arrays["prior.cov"]
        P[:, ZETA:ERROR, ZETA:ERROR] = np.eye(ERROR - ZETA)
        P[:, ERROR:, ERROR:] = np.diag(self._error_var)
        stream = empty_stream(self._weights, batch)
        return report(z, P, _REPORTED, (z, P, *self._front_end.init(batch), *stream))

    def step(self, state: State, sample: Sample) -> tuple[State, Info]:
        """Forecast by the operator, correct by the outputs, let the window take the sample in."""
        z, P, front, stream = self._unpack(state)
        front, clean = self._front_end.step(front, sample.measured)
        stream = Stream(*(part.copy() for part in stream))
        z, P = z.copy(), P.copy()
        filled = clean.filled
        white, coloured = output_sd(filled)
        theta, slope = theta_and_slope(z[:, ZETA:NOISE])
        batch = len(z)
        info = (np.empty((batch, 3)), np.empty((batch, 3, 3)), np.empty(batch))
        tick(
            self._weights,
            self._model,
            stream,
            z,
            P,
            self._front_end.standardise(filled).astype(np.float32),
            clean.accepted.astype(np.float32),
            ((query_of(filled) - self._scaling[2]) / self._scaling[3]).astype(np.float32),
            np.where(clean.accepted[:, 4:], filled[:, 4:], np.nan),
            np.stack([theta[:, 4], slope[:, 4]], axis=-1),
            white,
            coloured,
            INNOVATION_CLIP_SD,
            info,
        )
        reported = report(z, P, _REPORTED, (z, P, *front, *stream))
        return reported, Info(*info, clean.accepted[:, 4:], clean_flags(clean), clean.age_s)

    def forecast(self, state: State, inputs: Array) -> Array:
        """Roll the operator out, feeding its own readings back into the window."""
        z, _, _, stream = self._unpack(state)
        out = np.empty((*inputs.shape[:2], 3))
        bias = to_theta(z[:, ZETA:NOISE])[:, 4].copy()
        stream = Stream(*(part.copy() for part in stream))
        inputs = np.ascontiguousarray(inputs, dtype=np.float64)
        roll_out(self._weights, self._model, self._scaling, stream, z, inputs, bias, out)
        return out

    def _unpack(self, state: State) -> tuple[Array, Array, Memory, Stream]:
        z, P, *rest = state.memory
        n = len(Memory._fields)
        return z, P, Memory(*rest[:n]), Stream(*rest[n:])


_REPORTED = np.r_[0 : len(STATES), ZETA:NOISE]
