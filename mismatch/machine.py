"""The simulator with everything that might be missing from it, ready to run over recordings.

One compiled function holds every candidate term and one free force per balance, flux, input and output; a candidate
that is absent costs a comparison. Everything the engine learns comes from forward runs of this machine.
"""

from __future__ import annotations

import functools
from collections.abc import Iterator, Sequence
from copy import copy
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numba import njit

from twinbench.mismatch.faults import channel_of, with_fault
from twinbench.mismatch.march import RUNGE_KUTTA, march
from twinbench.mismatch.place import CLOCK
from twinbench.mismatch.rounded import ROUNDS
from twinbench.mismatch.tracks import Grid, Track
from twinbench.physics.compile import compiled
from twinbench.physics.compose import compose
from twinbench.physics.jit import EQUATION, as_argument
from twinbench.physics.simulator import Amplitude, Array, Mechanism, Port, Series, Simulator, Term, Variable

WHISPER = 1e-9
"""Share of its typical size at which a mechanism's own states move, and nothing else does."""
_DIVERGED = 1e9  # in scales of a state: whatever runs there is no machine any more


@dataclass(frozen=True)
class Candidate:
    """A mechanism's place in the machine's parameter vector.

    Attributes:
        at: positions of its parameters, the size first.
        null: (n_parameters,) their values when the simulator is as it came, each in its unit.
        typical: (n_parameters,) their values when the mechanism is plainly there, each in its unit.
        odds: that it is there against its absence, as a user told; None if nobody did.
    """

    mechanism: Mechanism
    at: tuple[int, ...]
    null: Array
    typical: Array
    odds: float | None = None

    @property
    def name(self) -> str:
        return self.mechanism.name

    @property
    def acts_on_input(self) -> bool:
        """Is it a fault of an input, so that the machine gets another one than was recorded?"""
        return isinstance(self.mechanism, Series) and self.mechanism.port.place == "input"

    @property
    def acts_on_output(self) -> bool:
        """Is it a fault of a sensor, which leaves the machine's own course as it is?"""
        return isinstance(self.mechanism, Series) and self.mechanism.port.place == "output"

    @property
    def family(self) -> str:
        """The plainest effect that it can be: one of a family is enough."""
        return self.mechanism.contains or self.name


@dataclass(frozen=True)
class Setting:
    """What one run goes over and begins with.

    Attributes:
        theta: (np,) the machine's parameters, each in its own unit.
        x0: (nx,) the state at the recording's first sample, in the states' units.
        varying: (V,) positions in theta of parameters that change in time.
        values: (N, V) their values at the recording's samples; at those of ``Machine.grid`` for a run by blocks.
        since_s: time from which candidates are there, on the recording's clock.
    """

    track: Track
    theta: Array
    x0: Array
    varying: np.ndarray = field(default_factory=lambda: np.empty(0, dtype=np.int64))
    values: Array | None = None
    since_s: float = -np.inf


class Machine:
    """A simulator, its candidates and forces.

    The parameter vector ``theta`` holds the simulator's own parameters, then one per force, then those of term
    mechanisms, then those of faults (series). Mechanisms' clocks show time since ``epoch_s``. ``known`` faults are
    there for good, at their nominal sizes. ``input_sds`` (nu,) is the noise of a sample of each input, in its unit.

    Attributes:
        equations: ``rhs`` and ``output`` of the whole, as arguments of compiled loops.
        limit: (nx,) beyond which a run has diverged, in the states' units.
        ports: where a force may act on the equations.
    """

    ports: tuple[Port, ...] = ()

    def __init__(self, simulator: Simulator, catalogue: Sequence[Mechanism], known: Sequence[Series] = ()) -> None:
        terms = [m for m in catalogue if isinstance(m, Term)]
        self.simulator = simulator
        self._compose(terms)
        n_own, n_forces = len(simulator.parameters), len(self.ports)
        self.force_at = {port: n_own + i for i, port in enumerate(self.ports)}
        theta = self.whole.theta()
        theta[n_own : n_own + n_forces] = 0.0
        at = n_own + n_forces
        self.candidates: list[Candidate] = []
        self._own_states: dict[str, range] = {}
        state = len(simulator.states)
        self._faults: list[tuple[Candidate, Series, str, int]] = []
        self._known: list[tuple[Array, Series, str, int]] = []
        for fault in known:
            self.take_for_granted(fault)
        extra: list[float] = []
        for mechanism in catalogue:
            nominal = np.array([v.nominal for v in mechanism.parameters])
            if isinstance(mechanism, Amplitude):
                positions = tuple(simulator.index(v.name) for v in mechanism.parameters)
                self.candidates.append(Candidate(mechanism, positions, theta[list(positions)].copy(), nominal))
                continue
            null = nominal.copy()
            null[0] = mechanism.off
            if isinstance(mechanism, Term):
                positions = tuple(range(at, at + len(nominal)))
                at += len(nominal)
                theta[list(positions)] = null
                self._own_states[mechanism.name] = range(state, state + len(mechanism.states))
                state += len(mechanism.states)
            else:
                first = len(theta) + len(extra)
                positions = tuple(range(first, first + len(nominal)))
                extra += null.tolist()
            candidate = Candidate(mechanism, positions, null, nominal)
            self.candidates.append(candidate)
            if isinstance(mechanism, Series):
                self._faults.append((candidate, mechanism, *channel_of(simulator, mechanism)))
        self.theta = np.concatenate((theta, extra))
        self.states = self.whole.states
        self.limit = _DIVERGED * np.array([v.scale for v in self.states])
        self._n_ode = len(theta)
        self.step_s = self.block_step_s = np.inf
        self.parts, self.scheme = 1, RUNGE_KUTTA
        self.epoch_s = 0.0
        self.input_sds = np.zeros(len(simulator.inputs))
        self._clocks = np.array([v.name.startswith(CLOCK) for v in self.states])
        self._clocks[: len(simulator.states)] = False

    def _compose(self, terms: Sequence[Term]) -> None:
        """Make the equations of the whole."""
        self.ports = _ports(self.simulator)
        self.whole = compose(self.simulator, (*map(_force, self.ports), *terms))
        made = compiled(self.whole)
        self.equations, self._native = (as_argument(made.rhs), as_argument(made.output)), made.native

    def take_for_granted(self, fault: Series) -> None:
        """A fault of a sensor or an input is there from now on, at its nominal size."""
        sizes = np.array([v.nominal for v in fault.parameters])
        self._known.append((sizes, fault, *channel_of(self.simulator, fault)))

    def reading_states(self) -> Machine:
        """The same with a sound sensor of every state in the place of its sensors."""
        made = copy(self)
        made.simulator = replace(self.simulator, outputs=self.states, reads=())
        made.equations = self.equations[0], as_argument(_state) if self._native else _state
        made._faults = [fault for fault in self._faults if fault[2] == "input"]
        made._known = [fault for fault in self._known if fault[2] == "input"]
        return made

    def loop(self, compiled_loop: Any) -> Any:
        """A loop over the equations: itself, or its plain Python where numba could not compile those."""
        return compiled_loop if self._native else compiled_loop.py_func

    def ode(self, theta: Array) -> Array:
        """Those of the parameters that the equations hold; faults' own stand behind them.

        Args:
            theta: (n_theta,) each in its parameter's unit.
        """
        return np.ascontiguousarray(theta[: self._n_ode])

    def own_states(self, candidate: Candidate) -> range:
        """Where a candidate's own states stand among the machine's."""
        return self._own_states.get(candidate.name, range(0))

    def start(self, track: Track) -> Array:
        """The state (nx,) that the simulator's ``initial`` makes of the first inputs and readings."""
        first = np.array([_first(column) for column in track.y.T])
        nominal = np.array([v.nominal for v in self.simulator.outputs])
        readings = np.where(np.isnan(first), nominal, first)
        x0 = np.asarray(self.whole.initial(track.u[0], readings, self.theta[: self._n_ode]), dtype=float)
        return x0 + self._clocks * (track.time_s[0] - self.epoch_s)

    def run(self, setting: Setting, blocks: bool = False) -> Array:
        """Simulated readings (N, ny) at the recording's samples, in the outputs' units; NaN from where it diverges.

        Args:
            blocks: step from block to block under their mean inputs: block means (B, ny), many times faster and nearly
                the same.
        """
        return self.read(setting.track, setting.theta, self.clean(setting, blocks), setting.since_s)

    def clean(self, setting: Setting, blocks: bool = False, states: bool = False) -> Array:
        """As ``run``, before the sensors' faults; or the ``states`` (N, nx), or (B, nx), in place of the readings."""
        track, theta = setting.track, setting.theta
        grid = self.driven(setting, blocks)
        varying, values = self.fading(setting, grid, blocks)
        y = np.full((len(grid.u), len(self.states if states else self.simulator.outputs)), np.nan)
        rhs, output = self.equations
        if states:
            output = as_argument(_state) if self._native else _state
        with np.errstate(all="ignore"):  # as in the compiled loop: a stretch without samples has no mean
            self.loop(march)(
                rhs,
                output,
                grid.u,
                grid.seconds,
                grid.samples,
                np.ascontiguousarray(setting.x0),
                self.ode(theta),
                varying,
                np.ascontiguousarray(values),
                self.block_step_s if blocks else self.step_s,
                self.scheme if blocks else RUNGE_KUTTA,
                self.limit,
                y,
            )
        y = y[grid.samples > 0]
        return track.joined(y, grid) if blocks else y

    def driven(self, setting: Setting, blocks: bool) -> Grid:
        """The stretches that a run goes through, with the inputs that the machine got."""
        track, u = setting.track, setting.track.u
        late = track.time_s < setting.since_s
        for fault, sizes, column, not_there in self._there("input", setting.theta, late):
            u = with_fault(fault, track.time_s, u, column, sizes, not_there)
        if u is track.u:
            return self.grid(track) if blocks else track.fine
        return track.split_grid(u, self.parts) if blocks else track.fine_grid(u)

    def fading(self, setting: Setting, grid: Grid, blocks: bool) -> tuple[np.ndarray, Array]:
        """What varies, (V,) and (N, V): the setting's own, and the sizes of candidates that are not there yet."""
        track, theta, varying, values = setting.track, setting.theta, setting.varying, setting.values
        if values is None:
            varying, values = np.empty(0, dtype=np.int64), np.empty((len(grid.u), 0))
        late = track.time_s < setting.since_s
        if not late.any():
            return varying, values
        # Of the stretch that the start falls into, the candidates are there in part.
        starts = track.split_starts(self.parts) if blocks else np.arange(len(track.u))
        ends = np.append(starts, len(track.u))
        absent = (np.add.reduceat(late, starts, dtype=float) / np.diff(ends))[grid.begun]
        # What remembers must see what goes on before its effect sets in, so none is ever quite off.
        absent = np.minimum(absent, 1.0 - WHISPER)
        there = [c for c in self.candidates if c.at[0] < self._n_ode and theta[c.at[0]] != c.null[0]]
        partly = [theta[c.at[0]] + absent * (c.null[0] - theta[c.at[0]]) for c in there]
        return (
            np.concatenate((varying, np.array([c.at[0] for c in there], dtype=np.int64))),
            np.concatenate((values, np.reshape(partly, (len(there), len(grid.u))).T), axis=1),
        )

    def grid(self, track: Track) -> Grid:
        """What a run by blocks goes through: the blocks, or as many parts of each as it takes."""
        return track.split(self.parts)

    def bends(self, theta: Array) -> bool:
        """Is a sensor faulty that does more than move in steps?

        Args:
            theta: the parameter vector, (n_theta,), each in its parameter's unit.
        """
        return any(not m.name.startswith(ROUNDS) for m, *_ in self._there("output", theta, np.zeros(0, dtype=bool)))

    def read(self, track: Track, theta: Array, y: Array, since_s: float = -np.inf, rounding: bool = True) -> Array:
        """What faulty sensors make of clean readings (N, ny) or block means (B, ny).

        Args:
            theta: the parameter vector, (n_theta,), each in its parameter's unit.
            y: (N, ny) readings or (B, ny) block means, in the outputs' units.
            rounding: do those that move in steps?
        """
        late = track.time_s < since_s
        for mechanism, sizes, column, not_there in self._there("output", theta, late):
            if not rounding and mechanism.name.startswith(ROUNDS):
                continue
            if len(y) == len(late):
                y = with_fault(mechanism, track.time_s, y, column, sizes, not_there)
                continue
            samples, y = np.interp(track.time_s, track.coarse.time_s, y[:, column])[:, None], y.copy()
            change = with_fault(mechanism, track.time_s, samples, 0, sizes, not_there) - samples
            y[:, column] += np.add.reduceat(change[:, 0], track.starts) / track.coarse.samples
        return y

    def _there(self, where: str, theta: Array, late: np.ndarray) -> Iterator[tuple[Series, Array, int, np.ndarray]]:
        """Faults at inputs or outputs: mechanism, its parameters, the channel's column, and when it is not there."""
        for sizes, mechanism, kind, column in self._known:
            if kind == where:
                yield mechanism, sizes, column, np.zeros_like(late)
        for candidate, mechanism, kind, column in self._faults:
            if kind == where and theta[candidate.at[0]] != candidate.null[0]:
                yield mechanism, theta[list(candidate.at)], column, late


@njit(EQUATION, cache=True)
def _state(x, u, theta):  # type: ignore[no-untyped-def]
    return x.copy()


def _ports(simulator: Simulator) -> tuple[Port, ...]:
    of = {"balance": "states", "flux": "fluxes", "input": "inputs", "output": "outputs"}
    return tuple(Port(place, v.name) for place, group in of.items() for v in getattr(simulator, group))


def _last(x: Array, u: Array, theta: Array) -> float:
    return theta[-1]


@functools.cache
def _force(port: Port) -> Term:
    """Something unknown that acts at a port: what ``locate`` lets vary in time."""
    return Term(f"force@{port}", "", port, (Variable(f"force@{port}", "", -np.inf, np.inf, 0.0),), term=_last)


def _first(values: Array) -> float:
    """Median of the first few readings that are there."""
    seen = values[~np.isnan(values)][:5]
    return float(np.median(seen)) if len(seen) else np.nan
