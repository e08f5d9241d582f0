"""One recording's run under a fit, linearised: columns of anything that acts on its rates, readings or start."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from twinbench.mismatch import tangent
from twinbench.mismatch.machine import WHISPER, Candidate, Machine, Setting
from twinbench.mismatch.tracks import Grid, Track
from twinbench.physics.simulator import Array, Port

NUDGED = 0.01
"""Step of a difference quotient in an unknown, in scales of it; and the largest change of a reading, in scales of its
output, by which is told how a faulty sensor reads a change."""


_Pair = tuple[Array, Array]
"""Rates (S, na) of the active states, and readings (S, ny)."""


class Acts(NamedTuple):
    """Changes that act along a course.

    Attributes:
        rates: (S, na, K) of the active states' rates, in the states' units per second.
        reads: (S, ny, K) of the readings, in the outputs' units.
    """

    rates: Array
    reads: Array

    def times(self, weights: Array) -> Acts:
        """Each of K changes times each of R courses: K R changes, those of the first change first.

        Args:
            weights: (S, R) dimensionless.
        """
        many = [
            (part[:, :, :, None] * weights[:, None, None, :]).reshape(*part.shape[:2], -1)
            for part in (self.rates, self.reads)
        ]
        return Acts(*many)


class Course:
    """A recording's run, stretch by stretch, as ``tangent`` sees it.

    Args:
        setting: what the run begins with, block by block.

    Attributes:
        active: (na,) positions of the states that may change: the simulator's, and those of present candidates.
        means: (S, nx) the mean states of the stretches.
        u: (S, nu) the inputs that the machine got.
    """

    def __init__(self, machine: Machine, setting: Setting) -> None:
        self.machine, self.setting = machine, setting
        self.track: Track = setting.track
        self.grid: Grid = machine.driven(self.setting, blocks=True)
        self._varying, self._values = machine.fading(self.setting, self.grid, blocks=True)
        drifting = self.setting.values
        self._plain = self.setting.varying, np.empty((len(self.grid.u), 0)) if drifting is None else drifting
        present = [c for c in machine.candidates if self.setting.theta[c.at[0]] != c.null[0]]
        own = [i for c in present for i in machine.own_states(c)]
        self.active = np.array([*range(len(machine.simulator.states)), *own], dtype=np.int64)
        self.scales = np.array([machine.states[i].scale for i in self.active], dtype=np.float64)
        self.u = np.ascontiguousarray(self.grid.u)
        self.means = self._means(self.setting.theta, self._varying, self._values)
        s, n, ny = len(self.u), len(self.active), len(machine.simulator.outputs)
        self._E, self._G = np.empty((s, n, n)), np.empty((s, n, n))
        self._Yx, self._Yf = np.empty((s, ny, n)), np.empty((s, ny, n))
        rhs, output = machine.equations
        machine.loop(tangent.stretches)(
            rhs,
            output,
            self.u,
            self.grid.seconds,
            self.grid.samples,
            self.means,
            machine.ode(self.setting.theta),
            self._varying,
            self._values,
            self.active,
            self.scales,
            self._E,
            self._G,
            self._Yx,
            self._Yf,
        )
        self._present: dict[tuple[bytes, float], Acts] = {}
        self._memories: dict[tuple[str, tuple[float, ...]], Array] = {}
        self._base = self._rates_and_readings()

    @property
    def sizes(self) -> tuple[int, int, int]:
        """Stretches, active states and outputs."""
        return len(self.u), len(self.active), self._Yx.shape[1]

    @property
    def visited(self) -> Array:
        """(S, n) where the machine was: states and inputs, in their units."""
        return np.concatenate((self.means[:, : len(self.machine.simulator.states)], self.u), axis=1)

    def columns(self, acts: Acts, start: Array | None = None) -> Array:
        """Changes of the block means, (B, ny, K), in the outputs' units per unit of each change.

        Args:
            start: (na, K) changes of the start state, in the states' units.
        """
        many = acts.rates.shape[2]
        out = np.empty((*acts.reads.shape[:2], many))
        begin = np.zeros((len(self.active), many)) if start is None else np.ascontiguousarray(start)
        rates, reads = (np.ascontiguousarray(part) for part in acts)
        self.machine.loop(tangent.columns)(self._E, self._G, self._Yx, self._Yf, rates, reads, begin, out)
        seen = out[self.grid.samples > 0].reshape(-1, acts.reads.shape[1] * many)
        return self.track.joined(seen, self.grid).reshape(-1, acts.reads.shape[1], many)

    def transposed(self, values: Array) -> Acts:
        """The transpose of ``columns``: what one change has to do with weighted block means.

        Args:
            values: (B, ny) the weights, per the outputs' units.
        """
        reads = np.zeros((len(self.u), values.shape[1]))
        reads[self.grid.samples > 0] = self.track.spread(values, self.grid)
        rates = np.empty((len(self.u), len(self.active)))
        self.machine.loop(tangent.transposed)(self._E, self._G, self._Yx, self._Yf, reads, rates)
        return Acts(rates[:, :, None], reads[:, :, None])

    def none(self, many: int) -> Acts:
        """So many changes that do nothing yet."""
        s, n, ny = self.sizes
        return Acts(np.zeros((s, n, many)), np.zeros((s, ny, many)))

    def of_always(self, theta: Array, step: float) -> Acts:
        """As ``of_parameters``, for what holds all the time: what is there beside it begins when it does.

        Args:
            theta: (n_theta,) the parameters after the step, each in its unit.
        """
        if self._varying is self._plain[0]:  # nothing begins late
            return self.of_parameters(theta, step)
        return self.of_parameters(theta, step, faded=True)

    def of_present(self, theta: Array, step: float, since_s: float = -np.inf) -> Acts:
        """As ``of_parameters``, for those of an effect that is there; kept, since what wanders of it asks alike.

        Args:
            theta: (n_theta,) the parameters after the step, each in its unit.
        """
        key = theta.tobytes(), since_s
        if key not in self._present:
            self._present[key] = self.of_parameters(theta, step, since_s)
        return self._present[key]

    def of_parameters(
        self,
        theta: Array,
        step: float,
        since_s: float = -np.inf,
        *,
        u: Array | None = None,
        means: Array | None = None,
        read: bool = True,
        faded: bool = False,
    ) -> Acts:
        """What other parameters, inputs or mean states do, per unit of a step; one change.

        Args:
            theta: (n_theta,) the parameters after the step, each in its unit.
            step: in the changed parameter's unit.
            since_s: time from which they hold, on the recording's clock.
            u: (S, nu) the inputs after the step, in their units.
            means: (S, nx) the mean states after the step, in their units.
            read: may they change what a sensor reads of a state?
            faded: does what begins late do so?
        """
        base = self._faded_base if faded else self._base
        weights = (self.late(since_s) if since_s > -np.inf else np.ones(len(self.u))) / step
        u, means = self.u if u is None else u, self.means if means is None else means
        found = self._compared(theta, u, means, base, weights, read, faded)
        for changes in found:
            if not np.isfinite(changes.sum()):
                np.nan_to_num(changes, copy=False)
        return Acts(*(changes[:, :, None] for changes in found))

    def of_candidate(self, candidate: Candidate, theta: Array, step: float, since_s: float = -np.inf) -> Acts:
        """As ``of_parameters``, for a candidate that is absent: its own states and faulty inputs follow the course.

        Args:
            theta: (n_theta,) the parameters after the step, each in its unit.
        """
        if candidate.acts_on_input:
            return self.of_input(theta, step)
        read = candidate.mechanism.port.place not in ("balance", "flux")
        if not self.machine.own_states(candidate):
            return self.of_parameters(theta, step, since_s, read=read)
        return self.of_parameters(theta, step, since_s, means=self._remembered(candidate, theta), read=read)

    def begun(self, candidate: Candidate, theta: Array, step: float, since_s: Sequence[float]) -> Acts:
        """As ``of_candidate``: all the time, then from each of T times on; 1 + T changes.

        Args:
            theta: (n_theta,) the parameters after the step, each in its unit.
        """
        late = np.stack([np.ones(len(self.u)), *(self.late(s) for s in since_s)], axis=-1)
        return self.of_candidate(candidate, theta, step).times(late)

    def forced(self, port: Port, unit: float, functions: Array) -> Acts:
        """What forces at a port do, each a function of the machine's course; R changes.

        Args:
            unit: of the forces, in the port's unit, per second at a balance.
            functions: (S, R) along the course, dimensionless.
        """
        theta = self.setting.theta.copy()
        theta[self.machine.force_at[port]] += unit
        return self.of_parameters(theta, 1.0).times(functions)

    def _remembered(self, candidate: Candidate, theta: Array) -> Array:
        """The mean states with an absent candidate's own states as they go along the course; each is run once."""
        self.remember([(candidate, theta)])
        means, own = self.means.copy(), self.machine.own_states(candidate)
        means[:, own.start : own.stop] = self._memories[_memory(candidate, theta)]
        return means

    def remember(self, several: Sequence[tuple[Candidate, Array]]) -> None:
        """Run the own states of several absent candidates at once, each with the shape that its parameters say.

        Args:
            several: each with all parameters (n_theta,), every one in its unit.
        """
        todo = [(c, theta) for c, theta in several if self.machine.own_states(c)]
        todo = [(c, theta) for c, theta in todo if _memory(c, theta) not in self._memories]
        while todo:
            quiet, now, later = self.setting.theta.copy(), {}, []
            for c, theta in todo:
                if c.name in now:
                    later.append((c, theta))
                    continue
                now[c.name] = c, theta
                quiet[list(c.at)] = theta[list(c.at)]
                quiet[c.at[0]] = c.null[0] + WHISPER * (theta[c.at[0]] - c.null[0])
            means = self._means(quiet, self._varying, self._values)
            for c, theta in now.values():
                own = self.machine.own_states(c)
                self._memories[_memory(c, theta)] = means[:, own.start : own.stop].copy()
            todo = later

    def of_input(self, theta: Array, step: float) -> Acts:
        """As ``of_parameters``, for those of a faulty input, since when it is faulty.

        Args:
            theta: (n_theta,) the parameters after the step, each in its unit.
        """
        return self.of_inputs(self.machine.driven(replace(self.setting, theta=theta), blocks=True).u, step)

    def of_inputs(self, u: Array, step: float = 1.0) -> Acts:
        """What other inputs do, per unit of a step; one change.

        Args:
            u: (S, nu) the inputs after the step, in their units.
        """
        return self.of_parameters(self.setting.theta, step, u=np.ascontiguousarray(u))

    @cached_property
    def clean(self) -> Array:
        """(B, ny) block means that sound sensors would read, in the outputs' units."""
        return self.machine.clean(self.setting, blocks=True)

    def of_sensor(self, theta: Array, since_s: Sequence[float]) -> Array:
        """What other parameters of a faulty sensor change of the block means, (B, ny, T), in the outputs' units.

        Args:
            theta: (n_theta,) the parameters after the step, each in its unit.
            since_s: T times from which they hold, on the recording's clock.
        """
        base = self.machine.read(self.track, self.setting.theta, self.clean, self.setting.since_s)
        changed = [self.machine.read(self.track, theta, self.clean, s) - base for s in since_s]
        return np.nan_to_num(np.stack(changed, axis=-1))

    def through_sensors(self, columns: Array) -> Array:
        """Columns (B, ny, K) as the sensors read them that are faulty along this course, in the outputs' units.

        A sensor that moves in steps follows what is larger than its step: it is left out.

        Args:
            columns: (B, ny, K) as sound sensors would read them, in the outputs' units per unit of each change.
        """
        theta, since_s = self.setting.theta, self.setting.since_s
        if not self.machine.bends(theta):
            return columns
        base = self.machine.read(self.track, theta, self.clean, since_s, rounding=False)
        scales = np.array([v.scale for v in self.machine.simulator.outputs])
        out = np.empty_like(columns)
        for k in range(columns.shape[2]):
            step = NUDGED / max(float((np.abs(columns[:, :, k]) / scales).max(initial=0.0)), 1e-300)
            ahead = self.machine.read(self.track, theta, self.clean + step * columns[:, :, k], since_s, rounding=False)
            out[:, :, k] = (ahead - base) / step
        return np.nan_to_num(out)

    def late(self, since_s: float) -> Array:
        """(S,) the share of each stretch from a time on."""
        ends = self.grid.time_s + 0.5 * self.grid.seconds
        return np.clip((ends - since_s) / np.maximum(self.grid.seconds, 1e-12), 0.0, 1.0)

    def _means(self, theta: Array, varying: np.ndarray, values: Array) -> Array:
        machine = self.machine
        means = np.empty((len(self.u), len(machine.states)))
        machine.loop(tangent.path)(
            machine.equations[0],
            self.u,
            self.grid.seconds,
            np.ascontiguousarray(self.setting.x0),
            machine.ode(theta),
            varying,
            np.ascontiguousarray(values),
            machine.block_step_s,
            machine.scheme,
            machine.limit,
            means,
        )
        return means

    @cached_property
    def _faded_base(self) -> _Pair:
        return self._rates_and_readings(faded=True)

    def _rates_and_readings(self, faded: bool = False) -> _Pair:
        """Rates (S, na) of the active states and readings (S, ny) at the mean states, in their units."""
        s, n, ny = self.sizes
        nothing = np.zeros((s, n)), np.zeros((s, ny))
        return self._compared(self.setting.theta, self.u, self.means, nothing, np.ones(s), True, faded)

    def _compared(
        self, theta: Array, u: Array, means: Array, base: _Pair, weights: Array, read: bool, faded: bool
    ) -> _Pair:
        s, n, ny = self.sizes
        rates, reads = np.empty((s, n)), np.zeros((s, ny))
        varying, values = (self._varying, self._values) if faded else self._plain
        # A parameter that drifts is nudged along its whole course.
        values = values + (theta - self.setting.theta)[varying]
        self.machine.loop(tangent.acting)(
            *self.machine.equations,
            u,
            means,
            self.machine.ode(theta),
            varying,
            np.ascontiguousarray(values),
            self.active,
            read,
            *base,
            weights,
            rates,
            reads,
        )
        return rates, reads


def _memory(candidate: Candidate, theta: Array) -> tuple[str, tuple[float, ...]]:
    """What a candidate's own states depend on: it, and its shape."""
    return candidate.name, tuple(theta[list(candidate.at[1:])])


def together(several: Sequence[Acts]) -> Acts:
    """All changes of several, in their order."""
    return Acts(*(np.concatenate(parts, axis=2) for parts in zip(*several, strict=True)))
