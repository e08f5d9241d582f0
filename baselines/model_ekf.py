"""An augmented extended Kalman filter over any Simulator of the compressor.

z = [the simulator's states, five health coordinates zeta, three coloured-noise states]. Jacobians
are forward differences of one Runge-Kutta step; the noise of the measured inputs enters as process
noise through the sensitivity to them. The slow drift that the pressure sensors share is not
modelled. With the exact plant this is the oracle, with the reduced-order model
the nominal EKF.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, ClassVar, NamedTuple

import numpy as np
from numba import njit

from twinbench.baselines.filterpy_filters import ekf_predict, ekf_update
from twinbench.data.batch import HEALTH, SAMPLE_PERIOD_S, STATES, Array, Batch
from twinbench.methods.estimator import Estimator, Info, Sample, State
from twinbench.methods.frontend import FrontEnd, Memory
from twinbench.methods.kalman import INNOVATION_CLIP_SD, linear_filter, predict_covariance, update
from twinbench.methods.noise import coloured_keep, health_walk_var, input_sd, output_sd
from twinbench.methods.reporting import clean_flags, report
from twinbench.physics.compile import compiled
from twinbench.physics.health import ZETA_LIMIT, theta_and_slope, to_theta
from twinbench.physics.integrate import rk4, simulate
from twinbench.physics.jit import as_argument
from twinbench.physics.simulator import Simulator

N_HEALTH, N_NOISE = len(HEALTH), 3
STATE_WALK = np.array([1e-3, 1e-3, 0.05, 0.05, 1e-3, 0.01, 1e-4, 0.05])
"""Process noise of the plant's states per square root of a second, before ``state_walk``."""
LEAST_FLOW = 0.05


class Filter(NamedTuple):
    """What one tick needs besides the equations.

    Attributes:
        theta: (np,) the simulator's parameters, each in its unit.
        health: (5,) positions of the health parameters in theta.
        step: (nx,) finite-difference steps of the states, in their units.
        Q: (n, n) process noise of one tick, input noise apart, in the units of z squared.
        keep: (3,) dimensionless AR(1) factors of the noise states.
        substeps: RK4 steps in a tick.
        low: (nx + 5,) lower bounds of states, in their units, and of dimensionless health coordinates.
        high: (nx + 5,) upper bounds, likewise.
    """

    theta: Array
    health: np.ndarray
    step: Array
    Q: Array
    keep: Array
    substeps: int
    low: Array
    high: Array


@njit(cache=True, error_model="numpy")
def _with_health(model, theta_health):  # type: ignore[no-untyped-def]
    theta = model.theta.copy()
    for i in range(model.health.size):
        theta[model.health[i]] = theta_health[i]
    return theta


@njit(cache=True, error_model="numpy")
def linearise(rhs, model, z, u, u_sd, health, slope):  # type: ignore[no-untyped-def]
    """z (n,) one tick on, F and Q (n, n); inputs u (nu,) and their sd, health and d theta / d zeta (5,)."""
    nx, n = model.step.size, z.size
    theta = _with_health(model, health)
    x = z[:nx].copy()
    base = rk4(rhs, x, u, theta, SAMPLE_PERIOD_S, 1)
    F = np.zeros((n, n))
    for j in range(nx):
        moved = x.copy()
        moved[j] += model.step[j]
        F[:nx, j] = (rk4(rhs, moved, u, theta, SAMPLE_PERIOD_S, 1) - base) / model.step[j]
    for j in range(N_HEALTH - 1):  # the sensor's bias does not act on the machine
        shifted = theta.copy()
        size = 1e-3 * slope[j]
        shifted[model.health[j]] += size
        F[:nx, nx + j] = (rk4(rhs, x, u, shifted, SAMPLE_PERIOD_S, 1) - base) / size * slope[j]
    for j in range(N_HEALTH):
        F[nx + j, nx + j] = 1.0
    for j in range(N_NOISE):
        F[nx + N_HEALTH + j, nx + N_HEALTH + j] = model.keep[j]
    Q = model.Q.copy()
    for j in range(u.size):
        if u_sd[j] > 0.0:
            moved_u = u.copy()
            moved_u[j] += u_sd[j]
            effect = rk4(rhs, x, moved_u, theta, SAMPLE_PERIOD_S, 1) - base
            for a in range(nx):
                for b in range(nx):
                    Q[a, b] += effect[a] * effect[b]
    after = z.copy()
    after[:nx] = rk4(rhs, x, u, theta, SAMPLE_PERIOD_S, model.substeps)
    for j in range(N_NOISE):
        after[nx + N_HEALTH + j] *= model.keep[j]
    return after, F, Q


@njit(cache=True, error_model="numpy")
def measure(output, model, z, u, measured, health, slope, white_sd, coloured_sd):  # type: ignore[no-untyped-def]
    """Innovation (3,), NaN where missing, H (3, n) and R (3, 3) for the outputs ``measured`` (3,).

    The function takes plain arrays because it is compiled.
    """
    nx, n = model.step.size, z.size
    theta = _with_health(model, health)
    x = z[:nx].copy()
    y = output(x, u, theta)
    H = np.zeros((3, n))
    for j in range(nx):
        moved = x.copy()
        moved[j] += model.step[j]
        H[:, j] = (output(moved, u, theta) - y) / model.step[j]
    bias = model.health[N_HEALTH - 1]
    theta[bias] += 1.0
    H[:, nx + N_HEALTH - 1] = (output(x, u, theta) - y) * slope[N_HEALTH - 1]
    R = np.zeros((3, 3))
    noise = nx + N_HEALTH
    for i in range(3):
        H[i, noise + i] = coloured_sd[i]
        R[i, i] = white_sd[i] ** 2
    innovation = measured - y
    for i in range(3):
        innovation[i] -= coloured_sd[i] * z[noise + i]
    return innovation, H, R


@njit(cache=True, error_model="numpy")
def _bound(model, z):  # type: ignore[no-untyped-def]
    """States and health where the model is one, in place, whatever was read."""
    for j in range(model.low.size):
        z[j] = min(max(z[j], model.low[j]), model.high[j])


@njit(cache=True, error_model="numpy")
def _tick(  # type: ignore[no-untyped-def]
    rhs, output, model, z, P, started, u_before, u, u_sd, measured, health, slope, white, coloured, info
):
    innovation, S, nis = info
    for b in range(z.shape[0]):
        if started[b]:
            z[b], F, Q = linearise(rhs, model, z[b], u_before[b], u_sd[b], health[b], slope[b])
            P[b] = predict_covariance(P[b], F, Q)
        innovation[b], H, R = measure(
            output, model, z[b], u[b], measured[b], health[b], slope[b], white[b], coloured[b]
        )
        z[b], P[b], S[b], nis[b] = update(z[b], P[b], innovation[b], H, R, INNOVATION_CLIP_SD)
        _bound(model, z[b])
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
    health: Array,
    slope: Array,
    white: Array,
    coloured: Array,
    info: tuple[Array, Array, Array],
) -> None:
    """As ``_tick``, by filterpy: the peer that it must equal and is timed against."""
    innovation, S, nis = info
    for b in range(z.shape[0]):
        if started[b]:
            after, F, Q = linearise(rhs, model, z[b], u_before[b], u_sd[b], health[b], slope[b])
            z[b], P[b] = ekf_predict(P[b], after, F, Q)
        innovation[b], H, R = measure(
            output, model, z[b], u[b], measured[b], health[b], slope[b], white[b], coloured[b]
        )
        z[b], P[b], S[b], nis[b] = ekf_update(z[b], P[b], innovation[b], H, R, INNOVATION_CLIP_SD)
        _bound(model, z[b])
        started[b] = True


class ModelEKF(Estimator):
    """Base of the filters whose model is a Simulator; a subclass says which in ``machine``."""

    toy_filter = staticmethod(linear_filter)
    draws = False
    settings: ClassVar[dict[str, Any]] = {
        "health_walk": 1.0,
        "state_walk": 1.0,
        "substeps": 2,
        "implementation": "compiled",
    }
    search_space: ClassVar[dict[str, Sequence[float]]] = {
        "health_walk": (0.5, 16.0),
        "state_walk": (0.1, 300.0),
    }
    online = frozenset({"state_walk", "health_walk"})

    def machine(self) -> Simulator:
        """The model, after ``fit`` with what was calibrated."""
        raise NotImplementedError

    def fit(self, train: Batch, validation: Batch, seed: int) -> None:
        """Nothing is learnt but the front end and where the states usually are."""
        assert train.truth is not None
        states = train.truth.states.reshape(-1, train.truth.states.shape[-1])[::50]
        self.arrays |= {
            **FrontEnd.fit(train).arrays(),
            "prior.mean": states.mean(axis=0),
            "prior.cov": np.cov(states.T),
        }
        self.restore()

    def restore(self) -> None:
        """Assemble the filter from settings and arrays."""
        machine = self.machine()
        self._machine = machine
        self._front_end = FrontEnd.from_arrays(self.arrays)
        nx = len(machine.states)
        n = nx + N_HEALTH + N_NOISE
        scale = np.array([v.scale for v in machine.states])
        keep = coloured_keep()
        Q = np.zeros(n)
        Q[:nx] = (self.config["state_walk"] * STATE_WALK[:nx]) ** 2 * SAMPLE_PERIOD_S
        Q[nx : nx + N_HEALTH] = health_walk_var(self.config["health_walk"])
        Q[nx + N_HEALTH :] = 1.0 - keep**2
        health = np.array([machine.index(name) for name in HEALTH])
        low, high = (np.array([getattr(v, end) for v in machine.states]) for end in ("low", "high"))
        low[STATES.index("flow_memory")] = LEAST_FLOW
        bounds = np.concatenate([low, -ZETA_LIMIT]), np.concatenate([high, ZETA_LIMIT])
        self._model = Filter(machine.theta(), health, 1e-4 * scale, np.diag(Q), keep, self.config["substeps"], *bounds)

    def init(self, batch: int) -> State:
        """States as anywhere in the training split, a healthy machine."""
        nx = len(self._model.step)
        n = nx + N_HEALTH + N_NOISE
        z = np.zeros((batch, n))
        z[:, :nx] = self.arrays["prior.mean"]
        P = np.zeros((batch, n, n))
        P[:, :nx, :nx] = self.arrays["prior.cov"]
        P[:, nx:, nx:] = np.eye(n - nx)
        return self._report(z, P, (np.zeros(batch, np.bool_), *self._front_end.init(batch)))

    def step(self, state: State, sample: Sample) -> tuple[State, Info]:
        """Predict by the model, correct by the outputs."""
        z, P, started, *front = state.memory
        after, clean = self._front_end.step(Memory(*front), sample.measured)
        z, P, started = z.copy(), P.copy(), started.copy()
        u, u_before = (np.ascontiguousarray(part[:, :4]) for part in (clean.filled, clean.before))
        measured = np.where(clean.accepted[:, 4:], clean.filled[:, 4:], np.nan)
        nx = len(self._model.step)
        health, slope = theta_and_slope(z[:, nx : nx + N_HEALTH])
        white, coloured = output_sd(clean.filled)
        info = (np.empty((len(z), 3)), np.empty((len(z), 3, 3)), np.empty(len(z)))
        equations = compiled(self._machine)
        tick = _tick_filterpy if self.config["implementation"] == "filterpy" else _tick
        rhs, output = as_argument(equations.rhs), as_argument(equations.output)
        tick(
            rhs,
            output,
            self._model,
            z,
            P,
            started,
            u_before,
            u,
            input_sd(clean.filled),
            measured,
            health,
            slope,
            white,
            coloured,
            info,
        )
        reported = self._report(z, P, (started, *after))
        return reported, Info(*info, clean.accepted[:, 4:], clean_flags(clean), clean.age_s)

    def forecast(self, state: State, inputs: Array) -> Array:
        """Run the model on with the parameters frozen."""
        z, _, _, *front = state.memory
        nx = len(self._model.step)
        health = to_theta(z[:, nx : nx + N_HEALTH])
        theta = np.tile(self._model.theta, (len(z), 1))
        theta[:, self._model.health] = health
        u = np.concatenate([Memory(*front).filled[:, None, :4], inputs], axis=1)
        _, y = simulate(self._machine, u, z[:, :nx], theta, SAMPLE_PERIOD_S, self.config["substeps"])
        return y[:, 1:]

    def _report(self, z: Array, P: Array, memory: tuple[np.ndarray, ...]) -> State:
        nx = len(self._model.step)
        keep = np.r_[0 : len(STATES), nx : nx + N_HEALTH]
        return report(z, P, keep, (z, P, *memory))
