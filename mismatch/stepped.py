"""A machine that can only be stepped: it tells no rates, so whatever is asked of it is asked of whole runs.

Nothing can act on its balances. What can be asked are its sensors, its inputs and its parameters, and where it starts.
A column is the difference of two runs; that of a sensor's fault is exact.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from twinbench.common.errors import BadInput
from twinbench.mismatch.course import NUDGED, Acts, Course, together
from twinbench.mismatch.machine import Candidate, Machine, Setting
from twinbench.mismatch.tracks import Grid, Track
from twinbench.physics.compose import ONLY_STEPPED
from twinbench.physics.simulator import Array, Mechanism, Port, Series, Simulator, Term

NOT_ASKED = (
    "This simulator can only be stepped; it does not tell the rates of its states. So only sensors, inputs and "
    "parameters were asked. What its equations lack may look like one of these. Or it has no name: then the place says "
    "where it shows, not where it is."
)
"""What a verdict has to say of it."""
CANNOT_BE_ASKED = "only stepped: nothing can be added to its balances"


def machine_of(simulator: Simulator, catalogue: Sequence[Mechanism], known: Sequence[Series] = ()) -> Machine:
    """The machine of a simulator, whether it tells its rates or can only be stepped.

    Raises:
        BadInput: it can only be stepped, and is asked what needs its rates.
    """
    return (Machine if simulator.stepped is None else SteppedMachine)(simulator, catalogue, known)


class SteppedMachine(Machine):
    """A simulator that can only be stepped, and the faults of its sensors and inputs.

    A run goes from sample to sample, also where means over blocks are asked for: so it was recorded.
    """

    def _compose(self, terms: Sequence[Term]) -> None:
        who = f"simulator {self.simulator.name!r} {ONLY_STEPPED}"
        if terms:
            raise BadInput(f"mechanism {terms[0].name!r} is a term of the equations, but {who}; leave it out")
        if self.simulator.drifts:
            raise BadInput(f"parameter {self.simulator.drifts[0]!r} cannot drift: {who}; leave out drifts")
        self.whole = self.simulator

    def grid(self, track: Track) -> Grid:
        return track.fine

    def driven(self, setting: Setting, blocks: bool) -> Grid:
        return super().driven(setting, blocks=False)

    def clean(self, setting: Setting, blocks: bool = False, states: bool = False) -> Array:
        return self.ran(setting, self.driven(setting, blocks), blocks)[states]

    def ran(self, setting: Setting, grid: Grid, blocks: bool) -> tuple[Array, Array]:
        """Readings (N, ny) before the sensors' faults, and states (N, nx); of ``blocks`` the means (B, ny) and (B, nx).

        Args:
            grid: sample by sample, with the inputs that the machine got.
        """
        assert self.simulator.stepped is not None
        told = self.simulator.stepped(grid.u, grid.seconds, setting.x0, self.ode(setting.theta))[grid.samples > 0]
        if blocks:
            told = setting.track.joined(told, grid)
        ny = len(self.simulator.outputs)
        return told[:, :ny], told[:, ny:]


class SteppedCourse(Course):
    """A recording's run under a fit and what changes it: whole runs, each made once.

    Changes have no rates here. What they do to the readings stands in ``Acts.reads``, block by block.
    """

    machine: SteppedMachine

    def __init__(self, machine: SteppedMachine, setting: Setting) -> None:
        self.machine, self.setting, self.track = machine, setting, setting.track
        self.grid = self.track.coarse
        self.u = self.grid.u
        self.active = np.arange(len(machine.states))
        self.clean, self.means = machine.ran(setting, machine.driven(setting, blocks=True), blocks=True)
        self._runs: dict[tuple[bytes, bytes, float], Array] = {}

    @property
    def sizes(self) -> tuple[int, int, int]:
        return len(self.u), len(self.active), len(self.machine.simulator.outputs)

    @property
    def visited(self) -> Array:
        """(B, ny + nx + nu): readings, states and inputs tell best where the machine is."""
        return np.concatenate((self.clean, self.means, self.u), axis=1)

    def columns(self, acts: Acts, start: Array | None = None) -> Array:
        out = acts.reads.copy()
        for k in np.flatnonzero(start.any(axis=0)) if start is not None else ():
            out[:, :, k] += self._of_start(start[:, k])  # type: ignore[index]
        return out

    def of_always(self, theta: Array, step: float) -> Acts:
        return self._of_parameters(theta, step)

    def of_present(self, theta: Array, step: float, since_s: float = -np.inf) -> Acts:
        return self._of_parameters(theta, step)

    def of_candidate(self, candidate: Candidate, theta: Array, step: float, since_s: float = -np.inf) -> Acts:
        if not candidate.acts_on_input:
            return self._of_parameters(theta, step)
        # Its size may have one sign only, so there is no way back.
        here, there = (replace(self.setting, theta=t, since_s=since_s) for t in (self.setting.theta, theta))
        return self._acts((self._run(there) - self._run(here)) / step)

    def begun(self, candidate: Candidate, theta: Array, step: float, since_s: Sequence[float]) -> Acts:
        return together([self.of_candidate(candidate, theta, step, s) for s in (-np.inf, *since_s)])

    def of_inputs(self, u: Array, step: float = 1.0) -> Acts:
        samples = np.diff(np.append(self.track.starts, len(self.track.time_s)))
        pushed = self.track.u + np.repeat(u - self.u, samples, axis=0)
        setting = replace(self.setting, track=replace(self.track, u=pushed))
        return self._acts((self.machine.clean(setting, blocks=True) - self.clean) / step)

    def forced(self, port: Port, unit: float, functions: Array) -> Acts:
        at = port.index(self.machine.simulator)
        if port.place == "output":
            acts = self.none(functions.shape[1])
            acts.reads[:, at] = unit * functions
            return acts
        pushes = np.zeros((functions.shape[1], *self.u.shape))
        pushes[:, :, at] = unit * functions.T
        return together([self.of_inputs(self.u + push) for push in pushes])

    def _of_parameters(self, theta: Array, step: float) -> Acts:
        """What other parameters do, per unit of a step, by central differences."""
        move = theta - self.setting.theta
        ahead, behind = (self._run(replace(self.setting, theta=self.setting.theta + way * move)) for way in (1.0, -1.0))
        return self._acts(self._quotient(ahead, behind, step))

    def _of_start(self, direction: Array) -> Array:
        """(B, ny) what another start does, by central differences.

        Args:
            direction: (nx,) of the start state, in the states' units.
        """
        scales = np.array([v.scale for v in self.machine.states])
        step = NUDGED / np.abs(direction / scales).max()
        moves = (way * step * direction for way in (1.0, -1.0))
        ahead, behind = (self._run(replace(self.setting, x0=self.setting.x0 + move)) for move in moves)
        return np.nan_to_num(self._quotient(ahead, behind, step))

    def _quotient(self, ahead: Array, behind: Array, step: float) -> Array:
        """By the nearer side where the machine cannot go to the other."""
        both = np.isfinite(ahead).all() and np.isfinite(behind).all()
        if both:
            return (ahead - behind) / (2.0 * step)
        return (ahead - self.clean) / step if np.isfinite(ahead).all() else (self.clean - behind) / step

    def _run(self, setting: Setting) -> Array:
        """(B, ny) block means of a run, before the sensors' faults."""
        key = setting.theta.tobytes(), setting.x0.tobytes(), setting.since_s
        if key not in self._runs:
            self._runs[key] = self.machine.clean(setting, blocks=True)
        return self._runs[key]

    def _acts(self, reads: Array) -> Acts:
        return Acts(np.zeros((len(reads), len(self.active), 1)), np.nan_to_num(reads)[:, :, None])
