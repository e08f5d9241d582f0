"""An augmented extended Kalman filter over any Simulator of a machine.

What z holds and how it moves is said in ``baselines.augmented_model``. The filter starts from the population of
machines. With the exact plant it is what the oracle builds on, with the reduced-order model the nominal EKF.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, ClassVar

import numpy as np
from numba import njit

from twinbench.baselines.augmented_model import (
    Filter,
    bound,
    correct_one,
    forecast_one,
    linearise,
    measure,
    roll_out,
    sensor_keep,
    shown,
    size_of,
)
from twinbench.baselines.filterpy_filters import ekf_predict, ekf_update
from twinbench.baselines.slow_errors import error_keep, slow_error_sd
from twinbench.data.batch import Array, Batch
from twinbench.machines.machine import Machine
from twinbench.methods.estimator import Estimator, Info, Sample, State
from twinbench.methods.frontend import Clean, FrontEnd, Memory
from twinbench.methods.kalman import INNOVATION_CLIP_SD, linear_filter
from twinbench.methods.noise import Sheet, health_walk_var, input_sd, output_sd, sheet_of
from twinbench.methods.reporting import clean_flags, report
from twinbench.physics.compile import compiled
from twinbench.physics.jit import as_argument
from twinbench.physics.simulator import Simulator

EVERY_TICKS = 50
"""Of the training states, how many apart those are that the prior is made of: neighbours say the same."""
FARTHEST_SD = 10.0
"""Of the noise states, the drift and the slow errors: absurd readings move them no farther. Ten times as much lets the
inputs without drift, and the states, become what the equations have no answer to."""


@njit(cache=True, error_model="numpy")
def _tick(rhs, output, model, z, P, started, u_before, u, u_sd, measured, white, coloured, info):  # type: ignore[no-untyped-def]
    innovation, S, nis = info
    none_out = np.zeros(measured.shape[1], np.int64)
    for b in range(z.shape[0]):
        if started[b]:
            z[b], P[b], _ = forecast_one(rhs, model, z[b], P[b], u_before[b], u_sd[b])
        z[b], P[b], innovation[b], S[b], nis[b] = correct_one(
            output, model, z[b], P[b], u[b], measured[b], white[b], coloured[b], none_out
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
    """Base of the filters whose model is a Simulator; a subclass says which in ``simulator``.

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

    def simulator(self) -> Simulator:
        """The model of ``machine``, after ``fit`` with what was calibrated."""
        raise NotImplementedError

    def fit(self, train: Batch, validation: Batch, seed: int) -> None:
        """Nothing is learnt but the front end, where the states usually are, and how the model errs on validation."""
        assert train.truth is not None
        states = train.truth.states.reshape(-1, train.truth.states.shape[-1])[::EVERY_TICKS]
        self.arrays |= {
            **FrontEnd.fit(train).arrays(),
            "prior.mean": states.mean(axis=0),
            "prior.cov": np.atleast_2d(np.cov(states.T)),
            "slow_error.sd": slow_error_sd(self.simulator(), validation, self.config["substeps"]),
        }
        self.restore()

    def restore(self) -> None:
        """Assemble the filter from settings and arrays."""
        machine, simulator = self.machine, self.simulator()
        self._front_end, self._sheet = FrontEnd.from_arrays(self.arrays), sheet_of(machine)
        equations = compiled(simulator)
        self._rhs, self._output = as_argument(equations.rhs), as_argument(equations.output)
        nx = len(simulator.states)
        self._sensor = nx + len(machine.health)
        self._error = self._sensor + len(machine.outputs) + 1
        self._size = size_of(machine, simulator, self.config["slow_error"] > 0.0)
        self._model = self._filter(simulator)

    def _filter(self, simulator: Simulator) -> Filter:
        machine, nx, (sensor, error) = self.machine, len(simulator.states), (self._sensor, self._error)
        keep, slow_keep = sensor_keep(machine), error_keep(machine)
        Q = np.zeros(self._size)
        Q[:nx] = (self.config["state_walk"] * machine.states_walk[:nx]) ** 2 * machine.sample_period_s
        Q[nx:sensor] = health_walk_var(machine, self.config["health_walk"])
        Q[sensor:error] = 1.0 - keep**2
        Q[error:] = (1.0 - slow_keep**2) * self._slow_var()
        limit = FARTHEST_SD * np.concatenate([np.ones(error - sensor), np.sqrt(self._slow_var())])
        (low, high), (zeta_low, zeta_high) = machine.state_bounds, machine.zeta_bounds
        return Filter(
            theta=simulator.theta(),
            coordinates=machine.coordinates,
            health=np.array([simulator.index(name) for name in machine.health_names]),
            acts=np.array([not h.on_readings for h in machine.health]),
            shows=shown(machine, simulator),
            step=1e-4 * np.array([v.scale for v in simulator.states]),
            Q=np.diag(Q),
            keep=keep,
            input_drift=machine.drift_shares[: len(machine.inputs)],
            output_drift=machine.drift_shares[len(machine.inputs) :],
            error_keep=slow_keep,
            period_s=machine.sample_period_s,
            substeps=self.config["substeps"],
            low=np.concatenate([low, zeta_low, -limit]),
            high=np.concatenate([high, zeta_high, limit]),
        )

    def _slow_var(self) -> Array:
        """Variance of each slow error that is in z."""
        size = self.config["slow_error"] * self.arrays["slow_error.sd"]
        return np.square(size)[: len(size) if self.config["slow_error"] > 0.0 else 0]

    def start(self, batch: int) -> tuple[Array, Array]:
        """z (B, n) and P (B, n, n) before the first sample: states as in training, health as in the population.

        Args:
            batch: how many machines, B.
        """
        nx, (mean, cov) = len(self._model.step), self.machine.prior
        z = np.zeros((batch, self._size))
        z[:, :nx], z[:, nx : self._sensor] = self.arrays["prior.mean"], mean
        P = np.zeros((batch, self._size, self._size))
        P[:, :nx, :nx] = self.arrays["prior.cov"]
        P[:, nx : self._sensor, nx : self._sensor] = cov
        P[:, self._sensor : self._error, self._sensor : self._error] = np.eye(self._error - self._sensor)
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
        info = self.blank_info(len(z))
        tick = _tick_filterpy if self.config["implementation"] == "filterpy" else _tick
        tick(self._rhs, self._output, self._model, z, P, started, *self.told(clean), info)
        reported = self._report(z, P, (started, *after))
        return reported, Info(*info, clean.accepted[:, len(self.machine.inputs) :], clean_flags(clean), clean.age_s)

    def forecast(self, state: State, inputs: Array) -> Array:
        """Run the model on with the parameters frozen; drift and slow errors fade."""
        u = np.concatenate([self.held(state), inputs], axis=1)
        readings = np.empty((*inputs.shape[:2], len(self.machine.outputs)))
        roll_out(self._rhs, self._output, self._model, np.ascontiguousarray(state.memory[0]), u, readings)
        return readings

    def held(self, state: State) -> Array:
        """The inputs (B, 1, nu) that were last accepted, in their units."""
        return Memory(*state.memory[-len(Memory._fields) :]).filled[:, None, : len(self.machine.inputs)]

    def _report(self, z: Array, P: Array, memory: tuple[np.ndarray, ...]) -> State:
        return report(self.machine.coordinates, z, P, self.reported(), (z, P, *memory))

    def reported(self) -> np.ndarray:
        """Positions (n + nh,) in z of the machine's quantities."""
        return np.r_[0 : len(self.machine.estimated), len(self._model.step) : self._sensor]

    def told(self, clean: Clean) -> tuple[Array, Array, Array, Array, Array, Array]:
        """What ``filter_inputs`` gives of a tick of this machine.

        Args:
            clean: that tick after the gate.
        """
        return filter_inputs(self.machine, self._sheet, clean)

    def blank_info(self, batch: int) -> tuple[Array, Array, Array]:
        """Innovation (B, ny), S (B, ny, ny) and NIS (B,) to be written.

        Args:
            batch: how many machines, B.
        """
        ny = len(self.machine.outputs)
        return np.empty((batch, ny)), np.empty((batch, ny, ny)), np.empty(batch)


def filter_inputs(machine: Machine, sheet: Sheet, clean: Clean) -> tuple[Array, Array, Array, Array, Array, Array]:
    """What a tick reads: inputs before and now and their sd (B, nu), outputs, white and coloured sd (B, ny), in units.

    Args:
        machine: whose tick.
        sheet: the noise of its outputs.
        clean: a tick after the gate.
    """
    nu = len(machine.inputs)
    before, now = (np.ascontiguousarray(part[:, :nu]) for part in (clean.before, clean.filled))
    measured = np.where(clean.accepted, clean.filled, np.nan)[:, nu:].copy()
    return before, now, input_sd(machine, clean.filled), measured, *output_sd(sheet, clean.filled)
