"""What SINDy looks at: derivatives of measured states, and every candidate's term along the states' paths.

Equations of motion are regressed on, not trajectories. A state that an output shows by itself is taken from its
readings; all others from the calibrated simulation. Only the balances of the former have a derivative to explain.
So a term that acts elsewhere alone has no column and is never named, nor is a fault of a sensor.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numba import njit, types

from twinbench.mismatch.tracks import Track
from twinbench.mismatch.variants import Variant, switched, typical, variants
from twinbench.physics.compile import compiled
from twinbench.physics.integrate import MATRIX, simulate
from twinbench.physics.jit import FUNCTION, VECTOR
from twinbench.physics.simulator import Array, Series, Term
from twinbench.proof.opponents.base import Calibrated

PROBE_SIZE = 0.2
"""Share of its typical size at which a candidate's column is taken."""
STEP = 0.02
"""Forward-difference step, in scales of an unknown."""
_PRESENT = 1e-9
"""Of its typical size: a term's own states run with it, and it does nothing yet."""


class Shown(NamedTuple):
    """A state that an output shows by itself, with the output's slope."""

    state: int
    output: int
    slope: float


@dataclass(frozen=True)
class Path:
    """One recording as a path through the space of states, N samples, s measured states.

    Attributes:
        time_s: (N,) seconds.
        x: (N, s) measured states, as recorded, in the states' units.
        rate: (N, s) their derivatives by the calibrated simulator's equations, in those units per second.
        terms: (N, s, J) what each of the candidates adds to these at its typical size, in the same units.
        moved_x: (N, s, K) change of x with each unknown of the calibration, by its scale, in the states' units.
        moved_rate: (N, s, K) change of the derivatives, likewise.
    """

    time_s: Array
    x: Array
    rate: Array
    terms: Array
    moved_x: Array
    moved_rate: Array


def paths(c: Calibrated, smooth: Callable[[Array], Array]) -> tuple[tuple[Variant, ...], list[Path]]:
    """The candidates' variants, and every training recording with a column for each; none if no state is measured.

    Args:
        smooth: ``smooth(x (N, s)) -> (N, s)``, what measured states are put through before equations see them.
    """
    listed = variants(c.candidates)
    shown = _shown(c)
    recordings = range(len(c.found.tracks)) if shown else ()
    return listed, [_Recording(c, r, shown, smooth).path(listed) for r in recordings]


class _Recording:
    """One recording, and the machine that ran it."""

    def __init__(self, c: Calibrated, r: int, shown: list[Shown], smooth: Callable[[Array], Array]) -> None:
        self.machine, self.problem = c.fit.problem.machine, c.fit.problem
        self.whole = self.machine.whole
        self.track: Track = c.found.tracks[r]
        self.r, self.z, self.shown, self.smooth = r, c.fit.z, shown, smooth
        self.states = [s.state for s in shown]
        self.readings = np.stack([_filled(self.track.y[:, s.output]) for s in shown], axis=-1)

    def path(self, listed: tuple[Variant, ...]) -> Path:
        theta, x, states = self.course(self.z)
        rate = self.rates(states, self.track.u, theta)
        terms = [self.term(v, theta, states, rate) for v in listed]
        moved = []
        for k, unknown in enumerate(self.problem.unknowns):
            step = -STEP if self.z[k] + STEP * unknown.scale > unknown.high else STEP
            z = self.z.copy()
            z[k] += step * unknown.scale
            if unknown.recording in (-1, self.r):
                theta_k, x_k, states_k = self.course(z)
                moved.append(((x_k - x) / step, (self.rates(states_k, self.track.u, theta_k) - rate) / step))
            else:
                moved.append((np.zeros_like(x), np.zeros_like(rate)))
        moved_x, moved_rate = (np.stack(m, axis=-1) for m in zip(*moved, strict=True))
        return Path(self.track.time_s, x, rate, np.stack(terms, axis=-1), moved_x, moved_rate)

    def course(self, z: Array, theta: Array | None = None) -> tuple[Array, Array, Array]:
        """Parameters; measured states (N, s); all states (N, nx), simulated, the measured ones put in their place."""
        theta = (self.problem.theta if theta is None else theta).copy()
        start = self.problem.starts[self.r].copy()
        for value, unknown in zip(z, self.problem.unknowns, strict=True):
            if unknown.kind == "parameter":
                theta[unknown.at] = value
            elif unknown.kind == "start" and unknown.recording == self.r:
                start[unknown.at] += value
        theta = theta[: len(self.whole.parameters)]
        dt_s = float(np.median(np.diff(self.track.time_s)))
        substeps = int(np.ceil(dt_s / self.machine.step_s - 1e-6))
        x, y = (a[0] for a in simulate(self.whole, self.track.u[None], start, theta, dt_s, substeps))
        slopes = [s.slope for s in self.shown]
        measured = x[:, self.states] + (self.readings - y[:, [s.output for s in self.shown]]) / slopes
        x[:, self.states] = self.smooth(measured)
        return theta, measured, x

    def rates(self, x: Array, u: Array, theta: Array) -> Array:
        """Derivatives (N, s) of the measured states.

        An input holds until the next sample, so a difference around a sample sees the mean of two.
        """
        out = np.empty_like(x)
        mean = 0.5 * (u + np.concatenate((u[:1], u[:-1])))
        equations = compiled(self.whole)
        loop = _rates if equations.native else _rates.py_func
        loop(equations.rhs, np.ascontiguousarray(x), mean, theta, out)
        return out[:, self.states]

    def term(self, variant: Variant, theta: Array, x: Array, rate: Array) -> Array:
        """What a candidate adds at its typical size, (N, s)."""
        candidate = self.machine.candidates[variant.candidate]
        mechanism, first = candidate.mechanism, candidate.mechanism.parameters[0]
        share = PROBE_SIZE if candidate.null[0] + PROBE_SIZE * typical(candidate) <= first.high else -PROBE_SIZE
        full = self.problem.theta.copy()
        full[: len(theta)] = theta
        there = switched(self.machine, full, variant, share * typical(candidate))
        u = self.track.u
        if isinstance(mechanism, Series):
            if mechanism.port.place != "input":
                return np.zeros_like(rate)
            u = self._faulty(mechanism, there[list(candidate.at)])
        elif isinstance(mechanism, Term) and mechanism.states:
            x = x.copy()
            own = len(self.machine.simulator.states)
            run = switched(self.machine, full, variant, _PRESENT * typical(candidate))
            x[:, own:] = self.course(self.z, run)[2][:, own:]
        changed = self.rates(x, u, there[: len(theta)])
        return (changed - rate) / share

    def _faulty(self, fault: Series, own: Array) -> Array:
        """The inputs (N, nu) that the machine got, of a fault with parameters (p,) of its own."""
        column = fault.port.index(self.machine.simulator)
        u = self.track.u.copy()
        u[:, column] = fault.series(self.track.time_s, u[:, column].copy(), own)
        return u


def _shown(c: Calibrated) -> list[Shown]:
    """States that an output shows by itself, judged at the middle of the first recording."""
    machine, track = c.fit.problem.machine, c.found.tracks[0]
    output = compiled(machine.whole).output
    theta = machine.theta[: len(machine.whole.parameters)].copy()
    for value, unknown in zip(c.fit.z, c.fit.problem.unknowns, strict=True):
        if unknown.kind == "parameter":
            theta[unknown.at] = value
    x = np.array([v.nominal for v in machine.states])
    u = track.u[len(track.u) // 2]
    y = output(x, u, theta)
    own = machine.simulator.states
    slopes = np.zeros((len(y), len(own)))
    for i, v in enumerate(own):
        ahead = x.copy()
        ahead[i] += 0.01 * v.scale
        slopes[:, i] = (output(ahead, u, theta) - y) / (0.01 * v.scale)
    found: dict[int, Shown] = {}
    for j, row in enumerate(slopes):
        seen = np.flatnonzero(np.abs(row) * [v.scale for v in own] > 1e-9 * machine.simulator.outputs[j].scale)
        if len(seen) == 1 and np.isfinite(track.y[:, j]).any():
            found.setdefault(int(seen[0]), Shown(int(seen[0]), j, float(row[seen[0]])))
    return list(found.values())


def _filled(values: Array) -> Array:
    """Readings (N,) with lines across what is missing."""
    seen = np.flatnonzero(np.isfinite(values))
    return np.interp(np.arange(len(values)), seen, values[seen])


@njit(types.void(FUNCTION, MATRIX, MATRIX, VECTOR, MATRIX), cache=True, error_model="numpy")
def _rates(rhs, x, u, theta, out):  # type: ignore[no-untyped-def]
    for k in range(x.shape[0]):
        out[k] = rhs(x[k], u[k], theta)
