"""The simulator with everything that might be missing from it, ready to run over recordings.

One compiled function holds every candidate term and one free force per balance, flux, input and
output; a candidate that is absent costs a comparison. Everything the engine learns comes from forward
runs of this machine.
"""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numba import njit, types

from mismatch.tracks import Track
from physics.compile import FUNCTION, VECTOR, compiled
from physics.compose import compose
from physics.integrate import INDICES, MATRIX
from physics.simulator import Array, Mechanism, Simulator, Variable

HALVINGS = 7
_DIVERGED = 1e9  # in scales of a state: whatever runs there is no machine any more


@dataclass(frozen=True)
class Candidate:
    """A mechanism's place in the machine's parameter vector.

    Attributes:
        at: positions of its parameters, the size first.
        null: their values when the simulator is as it came.
        typical: their values when the mechanism is plainly there.
    """

    mechanism: Mechanism
    at: tuple[int, ...]
    null: Array
    typical: Array

    @property
    def name(self) -> str:
        return self.mechanism.name


class Machine:
    """A simulator, its candidates and forces.

    The parameter vector ``theta`` holds the simulator's own parameters, then one per force, then those
    of term mechanisms, then those of faults (series).
    """

    def __init__(self, simulator: Simulator, catalogue: Sequence[Mechanism]) -> None:
        terms = [m for m in catalogue if m.term is not None]
        self.simulator = simulator
        self.ports = _ports(simulator)
        self._whole = compose(simulator, (*map(_force, self.ports), *terms))
        self._equations = compiled(self._whole)
        n_own, n_forces = len(simulator.parameters), len(self.ports)
        self.force_at = {port: n_own + i for i, port in enumerate(self.ports)}
        theta = self._whole.theta()
        theta[n_own : n_own + n_forces] = 0.0
        at = n_own + n_forces
        self.candidates: list[Candidate] = []
        self._faults: list[tuple[Candidate, str, int]] = []
        extra: list[float] = []
        for mechanism in catalogue:
            nominal = np.array([v.nominal for v in mechanism.parameters])
            if mechanism.term is None and mechanism.series is None:
                positions = tuple(simulator.index(v.name) for v in mechanism.parameters)
                self.candidates.append(Candidate(mechanism, positions, theta[list(positions)].copy(), nominal))
                continue
            null = nominal.copy()
            null[0] = mechanism.absent[0] if mechanism.absent else 0.0
            if mechanism.term is not None:
                positions = tuple(range(at, at + len(nominal)))
                at += len(nominal)
                theta[list(positions)] = null
            else:
                first = len(theta) + len(extra)
                positions = tuple(range(first, first + len(nominal)))
                extra += null.tolist()
            candidate = Candidate(mechanism, positions, null, nominal)
            self.candidates.append(candidate)
            if mechanism.series is not None:
                kind, _, name = mechanism.port.partition(":")
                group = simulator.inputs if kind == "input" else simulator.outputs
                self._faults.append((candidate, kind, [v.name for v in group].index(name)))
        self.theta = np.concatenate((theta, extra))
        self.states = self._whole.states
        self._n_ode = len(theta)
        self.step_s = np.inf

    def start(self, track: Track) -> Array:
        """The state (nx,) that the simulator's ``initial`` makes of the first inputs and readings."""
        first = np.array([_first(column) for column in track.y.T])
        nominal = np.array([v.nominal for v in self.simulator.outputs])
        readings = np.where(np.isnan(first), nominal, first)
        return np.asarray(self._whole.initial(track.u[0], readings, self.theta[: self._n_ode]), dtype=float)

    def run(
        self, track: Track, theta: Array, x0: Array, varying: np.ndarray | None = None, values: Array | None = None,
        since_s: float = -np.inf,
    ) -> Array:  # fmt: skip
        """Simulated readings (N, ny) at the recording's samples; NaN from where the run diverges.

        Args:
            varying, values: positions (V,) in theta that change in time, and their values (N, V).
            since_s: time from which candidates are there.
        """
        u = track.u
        late = track.time_s < since_s
        for candidate, kind, column in self._faults:
            if kind == "input" and theta[candidate.at[0]] != candidate.null[0]:
                u = self._with_fault(candidate, track.time_s, u, column, theta, late)
        if varying is None or values is None:
            varying, values = np.empty(0, dtype=np.int64), np.empty((len(u), 0))
        if late.any():
            there = [c for c in self.candidates if c.at[0] < self._n_ode and theta[c.at[0]] != c.null[0]]
            varying = np.concatenate((varying, np.array([c.at[0] for c in there], dtype=np.int64)))
            sizes = [np.where(late, c.null[0], theta[c.at[0]]) for c in there]
            values = np.concatenate((values, np.reshape(sizes, (len(there), len(u))).T), axis=1)
        y = np.full((len(u), len(self.simulator.outputs)), np.nan)
        loop = _run if self._equations.native else _run.py_func
        limit = _DIVERGED * np.array([v.scale for v in self.states])
        loop(
            self._equations.rhs, self._equations.output, u, np.diff(track.time_s), np.ascontiguousarray(x0),
            np.ascontiguousarray(theta[: self._n_ode]), varying, np.ascontiguousarray(values), self.step_s, limit, y,
        )  # fmt: skip
        for candidate, kind, column in self._faults:
            if kind == "output" and theta[candidate.at[0]] != candidate.null[0]:
                y = self._with_fault(candidate, track.time_s, y, column, theta, late)
        return y

    @staticmethod
    def _with_fault(
        candidate: Candidate, time_s: Array, values: Array, column: int, theta: Array, late: np.ndarray
    ) -> Array:
        assert candidate.mechanism.series is not None
        changed = values.copy()
        faulty = candidate.mechanism.series(time_s, values[:, column].copy(), theta[list(candidate.at)])
        changed[:, column] = np.where(late, values[:, column], faulty)
        return changed

    def settle_step(self, tracks: Sequence[Track], noise: Array) -> None:
        """Halve the integration step until the readings no longer move by a twentieth of the noise (ny,), rms.

        Raises:
            ValueError: the simulator diverges however small the step.
        """
        track = min(tracks, key=lambda t: len(t.time_s))
        x0 = self.start(track)
        self.step_s = float(np.median(np.diff(track.time_s)))
        coarse = self.run(track, self.theta, x0)
        for _ in range(HALVINGS):
            self.step_s /= 2.0
            fine = self.run(track, self.theta, x0)
            if np.isfinite(coarse).all() and (np.sqrt(np.mean((fine - coarse) ** 2, axis=0)) < 0.05 * noise).all():
                self.step_s *= 2.0
                return
            coarse = fine
        if not np.isfinite(coarse).all():
            k = int(np.argmax(~np.isfinite(coarse).all(axis=1)))
            raise ValueError(
                f"simulator {self.simulator.name!r} diverges on recording {track.name} at {track.time_s[k]:.6g} s, "
                "at its nominal parameters; check its equations, units and initial state"
            )


def _ports(simulator: Simulator) -> tuple[str, ...]:
    groups = {
        "balance": simulator.states, "flux": simulator.fluxes,
        "input": simulator.inputs, "output": simulator.outputs,
    }  # fmt: skip
    return tuple(f"{kind}:{v.name}" for kind, variables in groups.items() for v in variables)


def _last(x: Array, u: Array, theta: Array) -> float:
    return theta[-1]


@functools.cache
def _force(port: str) -> Mechanism:
    """Something unknown that acts at a port: what ``locate`` lets vary in time."""
    return Mechanism(f"force@{port}", "", port, (Variable(f"force@{port}", "", -np.inf, np.inf, 0.0),), term=_last)


def _first(values: Array) -> float:
    """Median of the first few readings that are there."""
    seen = values[~np.isnan(values)][:5]
    return float(np.median(seen)) if len(seen) else np.nan


@njit(
    types.void(
        FUNCTION, FUNCTION, MATRIX, VECTOR, VECTOR, VECTOR, INDICES, MATRIX, types.float64, VECTOR, MATRIX
    ),
    cache=True, error_model="numpy", nogil=True,
)  # fmt: skip
def _run(rhs, output, u, gaps, x0, theta, varying, values, step_s, limit, y_out):  # type: ignore[no-untyped-def]
    """Classical Runge-Kutta, inputs held between samples; ``y_out`` stays NaN after a divergence."""
    theta = theta.copy()
    x, z = x0.copy(), x0.copy()
    for k in range(u.shape[0]):
        for j in range(varying.size):
            theta[varying[j]] = values[k, j]
        y = output(x, u[k], theta)
        for i in range(y.size):
            y_out[k, i] = y[i]
        if k + 1 == u.shape[0]:
            break
        substeps = max(1, int(np.ceil(gaps[k] / step_s - 1e-6)))
        h = gaps[k] / substeps
        for _ in range(substeps):
            k1 = rhs(x, u[k], theta)
            for i in range(x.size):
                z[i] = x[i] + 0.5 * h * k1[i]
            k2 = rhs(z, u[k], theta)
            for i in range(x.size):
                z[i] = x[i] + 0.5 * h * k2[i]
            k3 = rhs(z, u[k], theta)
            for i in range(x.size):
                z[i] = x[i] + h * k3[i]
            k4 = rhs(z, u[k], theta)
            for i in range(x.size):
                x[i] += h / 6.0 * (k1[i] + 2.0 * (k2[i] + k3[i]) + k4[i])
        for i in range(x.size):
            if not abs(x[i]) < limit[i]:
                return
