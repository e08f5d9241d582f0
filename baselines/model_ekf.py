"""An augmented extended Kalman filter over any Simulator of the compressor.

What z holds and how it moves is said in ``baselines.augmented_model``. The filter starts from the population of
machines. With the exact plant it is what the oracle builds on, with the reduced-order model the nominal EKF.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, ClassVar

import numpy as np
from numba import njit

from twinbench.baselines.augmented_model import (
    N_ERROR,
    N_HEALTH,
    N_SENSOR,
    Filter,
    bound,
    correct_one,
    forecast_one,
    linearise,
    measure,
    roll_out,
    sensor_keep,
    size_of,
)
from twinbench.baselines.filterpy_filters import ekf_predict, ekf_update
from twinbench.baselines.slow_errors import error_keep, slow_error_sd
from twinbench.data.batch import HEALTH, INPUTS, SAMPLE_PERIOD_S, STATES, Array, Batch
from twinbench.data.population import PRIOR_COV, PRIOR_MEAN
from twinbench.methods.estimator import Estimator, Info, Sample, State
from twinbench.methods.frontend import Clean, FrontEnd, Memory
from twinbench.methods.kalman import INNOVATION_CLIP_SD, linear_filter
from twinbench.methods.noise import health_walk_var, input_sd, output_sd
from twinbench.methods.reporting import clean_flags, report
from twinbench.physics.compile import compiled
from twinbench.physics.health import ZETA_HIGH, ZETA_LOW
from twinbench.physics.jit import as_argument
from twinbench.physics.simulator import Simulator

STATE_WALK = np.array([1e-3, 1e-3, 0.05, 0.05, 1e-3, 0.01, 1e-4, 0.05])
"""Process noise of the plant's states per square root of a second, before ``state_walk``."""
LEAST_FLOW = 0.05
FARTHEST_SD = 10.0
"""Of the noise states, the drift and the slow errors: absurd readings move them no farther. Ten times as much lets the
inputs without drift, and the states, become what the equations have no answer to."""
NONE_OUT = np.zeros(3, np.int64)
"""All outputs are believed."""


@njit(cache=True, error_model="numpy")
def _tick(rhs, output, model, z, P, started, u_before, u, u_sd, measured, white, coloured, info):  # type: ignore[no-untyped-def]
    innovation, S, nis = info
    for b in range(z.shape[0]):
        if started[b]:
            z[b], P[b], _ = forecast_one(rhs, model, z[b], P[b], u_before[b], u_sd[b])
        z[b], P[b], innovation[b], S[b], nis[b] = correct_one(
            output, model, z[b], P[b], u[b], measured[b], white[b], coloured[b], NONE_OUT
        )
        started[b] = True


def _tick_filterpy(
    rhs: Any,
    output: Any,
    model: Filter,
    z: Array,
    P: Array,
    started: np.ndarray,
    u_before: Array,
    u: Array,
    u_sd: Array,
    measured: Array,
    white: Array,
    coloured: Array,
    info: tuple[Array, Array, Array],
) -> None:
    """As ``_tick``, by filterpy: the peer that it must equal and is timed against."""
    innovation, S, nis = info
    for b in range(z.shape[0]):
        if started[b]:
            after, F, Q = linearise(rhs, model, z[b], u_before[b], u_sd[b])
            z[b], P[b] = ekf_predict(P[b], after, F, Q)
        innovation[b], H, R = measure(output, model, z[b], u[b], measured[b], white[b], coloured[b])
        z[b], P[b], S[b], nis[b] = ekf_update(z[b], P[b], innovation[b], H, R, INNOVATION_CLIP_SD)
        bound(model, z[b])
        started[b] = True


class ModelEKF(Estimator):
    """Base of the filters whose model is a Simulator; a subclass says which in ``machine``.

    ``slow_error`` is a multiple of what the model was found to err by for minutes; 0 leaves slow errors out.
    """

    toy_filter = staticmethod(linear_filter)
    draws = False
    settings: ClassVar[dict[str, Any]] = {
        "health_walk": 1.0,
        "state_walk": 1.0,
        "slow_error": 0.0,
        "substeps": 2,
        "implementation": "compiled",
    }
    search_space: ClassVar[dict[str, Sequence[float]]] = {
        "health_walk": (0.5, 16.0),
        "state_walk": (0.1, 300.0),
    }
    online = frozenset({"state_walk", "health_walk", "slow_error"})

    def machine(self) -> Simulator:
        """The model, after ``fit`` with what was calibrated."""
        raise NotImplementedError

    def fit(self, train: Batch, validation: Batch, seed: int) -> None:
        """Nothing is learnt but the front end, where the states usually are, and how the model errs on validation."""
        assert train.truth is not None
        states = train.truth.states.reshape(-1, train.truth.states.shape[-1])[::50]
        self.arrays |= {
            **FrontEnd.fit(train).arrays(),
            "prior.mean": states.mean(axis=0),
            "prior.cov": np.cov(states.T),
            "slow_error.sd": slow_error_sd(self.machine(), validation, self.config["substeps"]),
        }
        self.restore()

    def restore(self) -> None:
        """Assemble the filter from settings and arrays."""
        machine = self.machine()
        self._machine = machine
        self._front_end = FrontEnd.from_arrays(self.arrays)
        equations = compiled(machine)
        self._rhs, self._output = as_argument(equations.rhs), as_argument(equations.output)
        nx = len(machine.states)
        scale = np.array([v.scale for v in machine.states])
        keep, slow_keep = sensor_keep(), error_keep()
        self._sensor, self._error = nx + N_HEALTH, nx + N_HEALTH + N_SENSOR
        self._size = size_of(machine, self.config["slow_error"] > 0.0)
        Q = np.zeros(self._size)
        Q[:nx] = (self.config["state_walk"] * STATE_WALK[:nx]) ** 2 * SAMPLE_PERIOD_S
        Q[nx : self._sensor] = health_walk_var(self.config["health_walk"])
        Q[self._sensor : self._error] = 1.0 - keep**2
        Q[self._error :] = (1.0 - slow_keep**2) * self._slow_var()
        health = np.array([machine.index(name) for name in HEALTH])
        low, high = (np.array([getattr(v, end) for v in machine.states]) for end in ("low", "high"))
        low[STATES.index("flow_memory")] = LEAST_FLOW
        limit = np.concatenate([FARTHEST_SD * np.ones(N_SENSOR), FARTHEST_SD * np.sqrt(self._slow_var())])
        bounds = np.concatenate([low, ZETA_LOW, -limit]), np.concatenate([high, ZETA_HIGH, limit])
        self._model = Filter(
            machine.theta(), health, 1e-4 * scale, np.diag(Q), keep, slow_keep, self.config["substeps"], *bounds
        )

    def _slow_var(self) -> Array:
        """Variance of each slow error that is in z."""
        size = self.config["slow_error"] * self.arrays["slow_error.sd"]
        return np.square(size)[: N_ERROR if self.config["slow_error"] > 0.0 else 0]

    def start(self, batch: int) -> tuple[Array, Array]:
        """z (B, n) and P (B, n, n) before the first sample: states as in training, health as in the population.

        Args:
            batch: how many machines, B.
        """
        nx = len(self._model.step)
        z = np.zeros((batch, self._size))
        z[:, :nx], z[:, nx : self._sensor] = self.arrays["prior.mean"], PRIOR_MEAN
        P = np.zeros((batch, self._size, self._size))
        P[:, :nx, :nx] = self.arrays["prior.cov"]
        P[:, nx : self._sensor, nx : self._sensor] = PRIOR_COV
        P[:, self._sensor : self._error, self._sensor : self._error] = np.eye(N_SENSOR)
        P[:, self._error :, self._error :] = np.diag(self._slow_var())
        return z, P

    def init(self, batch: int) -> State:
        """States as anywhere in the training split, health as anywhere in the population."""
        z, P = self.start(batch)
        return self._report(z, P, (np.zeros(batch, np.bool_), *self._front_end.init(batch)))

    def step(self, state: State, sample: Sample) -> tuple[State, Info]:
        """Predict by the model, correct by the outputs."""
        z, P, started, *front = state.memory
        after, clean = self._front_end.step(Memory(*front), sample.measured)
        z, P, started = z.copy(), P.copy(), started.copy()
        info = (np.empty((len(z), 3)), np.empty((len(z), 3, 3)), np.empty(len(z)))
        tick = _tick_filterpy if self.config["implementation"] == "filterpy" else _tick
        tick(self._rhs, self._output, self._model, z, P, started, *filter_inputs(clean), info)
        reported = self._report(z, P, (started, *after))
        return reported, Info(*info, clean.accepted[:, len(INPUTS) :], clean_flags(clean), clean.age_s)

    def forecast(self, state: State, inputs: Array) -> Array:
        """Run the model on with the parameters frozen; drift and slow errors fade."""
        u = np.concatenate([self.held(state), inputs], axis=1)
        readings = np.empty((*inputs.shape[:2], 3))
        roll_out(self._rhs, self._output, self._model, np.ascontiguousarray(state.memory[0]), u, readings)
        return readings

    def held(self, state: State) -> Array:
        """The inputs (B, 1, 4) that were last accepted, in their units."""
        return Memory(*state.memory[-len(Memory._fields) :]).filled[:, None, : len(INPUTS)]

    def _report(self, z: Array, P: Array, memory: tuple[np.ndarray, ...]) -> State:
        return report(z, P, self.reported(), (z, P, *memory))

    def reported(self) -> np.ndarray:
        """Positions (10,) in z of what is reported, order ESTIMATED."""
        nx = len(self._model.step)
        return np.r_[0 : len(STATES), nx : nx + N_HEALTH]


def filter_inputs(clean: Clean) -> tuple[Array, Array, Array, Array, Array, Array]:
    """What a tick reads: inputs before and now and their sd (B, 4), outputs, white and coloured sd (B, 3), in units.

    Args:
        clean: a tick after the gate.
    """
    before, now = (np.ascontiguousarray(part[:, : len(INPUTS)]) for part in (clean.before, clean.filled))
    measured = np.where(clean.accepted, clean.filled, np.nan)[:, len(INPUTS) :].copy()
    return before, now, input_sd(clean.filled), measured, *output_sd(clean.filled)
