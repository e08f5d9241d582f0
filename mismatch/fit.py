"""What a fit is about: a machine, its recordings, what is unknown of them, and the residuals that it leaves."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from typing import Self

import numpy as np

from twinbench.common.jobs import cores
from twinbench.mismatch.course import NUDGED, Acts, Course
from twinbench.mismatch.machine import Candidate, Machine, Setting
from twinbench.mismatch.stepped import SteppedCourse, SteppedMachine
from twinbench.mismatch.tracks import Grid, Track
from twinbench.physics.simulator import Array

KNOTS_LEAST, KNOT_EVERY_S = 5, 180.0
"""Knots of a parameter that drifts, per recording: at least so many, and one every three minutes."""
ENDLESS = 1e100
"""Of any reading, in any unit. Nothing depends on it but that its square is a number and no machine reads it."""


@dataclass(frozen=True)
class Unknown:
    """One number to be found.

    Attributes:
        at: its place: in theta (shared by all recordings, or drifting), or in the start state.
        recording: -1 for what all recordings share.
        knot: which knot of a drift; -1 for what is constant.
        mean: of the prior, Gaussian.
        sd: of the prior; an infinite one is none.
        scale: typical size of change.
    """

    name: str
    kind: str  # "parameter", "mechanism", "start" or "drift"
    at: int
    low: float
    high: float
    mean: float
    sd: float
    scale: float
    recording: int = -1
    knot: int = -1

    def nudge(self, value: float) -> float:
        """Step of a difference quotient from a value, in its unit; down where up leaves the bounds."""
        step = NUDGED * self.scale
        return -step if value + step > self.high else step

    @property
    def spread(self) -> float:
        """Its unit in columns: the prior standard deviation; a hundred scales where it has none."""
        return float(self.sd) if np.isfinite(self.sd) else 100.0 * float(self.scale)


@dataclass
class Problem:
    """A machine, its recordings, and what is unknown about them.

    ``z`` (K,) holds the unknowns' values. Residuals are measured minus simulated block means.

    Attributes:
        machine: the simulator with its candidates.
        tracks: the recordings.
        unknowns: what is to be found.
        sd: (ny,) of errors that are to be expected of block means, in the outputs' units.
        starts: one per recording, the state (nx,) that it starts from but for unknowns, each in its unit; that of
            the simulator's ``initial`` if left out.
        theta: (n_theta,) what the parameters are that are no unknowns, each in its unit; the machine's own if left
            out.
        since: the time from which candidates are there, per recording, s; from the beginning if left out.
        offsets: what a run sample by sample adds to one block by block, (B, ny) per recording, in the outputs'
            units; nothing if left out.
    """

    machine: Machine
    tracks: Sequence[Track]
    unknowns: tuple[Unknown, ...]
    sd: Array
    starts: Sequence[Array] = field(default_factory=list)
    theta: Array = field(default_factory=lambda: np.empty(0))
    since: tuple[float, ...] = ()
    offsets: Sequence[Array] = ()
    _last: tuple[Array, list[Array]] | None = field(default=None, init=False, repr=False)

    def __post_init__(self) -> None:
        if not len(self.theta):
            self.theta = self.machine.theta
        known = len(self.machine.theta)
        if len(self.theta) != known:  # compiled code would read beyond its end
            raise ValueError(f"theta has {len(self.theta)} values; the machine has {known} parameters")
        if not self.starts:
            self.starts = [self.machine.start(track) for track in self.tracks]

    @property
    def z0(self) -> Array:
        return np.array([u.mean for u in self.unknowns])

    @property
    def spreads(self) -> Array:
        """(K,) of the unknowns, each in its own unit."""
        return np.array([u.spread for u in self.unknowns])

    def white(self, values: Array) -> Array:
        """Residuals or columns in standard deviations.

        Args:
            values: (B, ny) or (B, ny, K), in the outputs' units.
        """
        return np.asarray(values / self.sd.reshape(-1, *(1,) * (values.ndim - 2)))

    def readings(self, r: int, z: Array) -> Array:
        """Simulated readings (N, ny) of recording r, sample by sample.

        Args:
            z: (K,) where the problem's unknowns stand, each in its own unit.
        """
        return self.machine.run(self.setting(r, z, self.tracks[r].fine))

    def states(self, r: int, z: Array) -> Array:
        """Simulated states (B, nx) of recording r, candidates' own last.

        Args:
            z: (K,) where the problem's unknowns stand, each in its own unit.
        """
        return self.machine.clean(self.setting(r, z, self.machine.grid(self.tracks[r])), blocks=True, states=True)

    def residual(self, r: int, z: Array, theta: Array | None = None) -> Array:
        """Block means measured minus simulated, (B, ny).

        Args:
            z: (K,) where the problem's unknowns stand, each in its own unit.
            theta: (n_theta,) in place of the problem's own, each in its parameter's unit.
        """
        track = self.tracks[r]
        y = self.machine.run(self.setting(r, z, self.machine.grid(track), theta), blocks=True)
        y = np.where(np.abs(y) < ENDLESS, y, np.nan)  # as good as diverged: sums of its squares are no numbers
        return track.means - y - (self.offsets[r] if len(self.offsets) else 0.0)

    def refined(self, z: Array) -> Self:
        """The problem with ``offsets`` such that residuals at z are those of runs sample by sample.

        Args:
            z: (K,) where the problem's unknowns stand, each in its own unit.
        """
        by_blocks = list(self.residuals(z))
        if len(self.offsets):
            by_blocks = [e + o for e, o in zip(by_blocks, self.offsets, strict=True)]

        def offset(r: int) -> Array:
            track = self.tracks[r]
            found = track.means - track.block_means(self.readings(r, z))
            return np.nan_to_num(by_blocks[r] - found)

        made = replace(self, offsets=parallel([lambda r=r: offset(r) for r in range(len(self.tracks))]))
        made._last = z.copy(), [e - o for e, o in zip(by_blocks, made.offsets, strict=True)]
        return made

    def setting(self, r: int, z: Array, grid: Grid, theta: Array | None = None) -> Setting:
        """What a run of recording r goes over and begins with.

        Args:
            z: (K,) where the problem's unknowns stand, each in its own unit.
            theta: (n_theta,) in place of the problem's own, each in its parameter's unit.
        """
        theta = (self.theta if theta is None else theta).copy()
        x0 = self.starts[r].copy()
        drifts: dict[int, dict[int, float]] = {}
        for value, unknown in zip(z, self.unknowns, strict=True):
            if unknown.kind in ("parameter", "mechanism"):
                theta[unknown.at] = value
            elif unknown.recording == r and unknown.kind == "start":
                x0[unknown.at] += value
            elif unknown.recording == r:
                drifts.setdefault(unknown.at, {})[unknown.knot] = value
        time_s = self.tracks[r].time_s
        values = np.empty((len(grid.time_s), len(drifts)))
        for i, (at, knots) in enumerate(drifts.items()):
            values[:, i] = theta[at] + np.interp(
                grid.time_s, np.linspace(time_s[0], time_s[-1], len(knots)), [knots[k] for k in sorted(knots)]
            )
        since_s = self.since[r] if self.since else -np.inf
        return Setting(self.tracks[r], theta, x0, np.array(list(drifts), dtype=np.int64), values, since_s)

    def squares(self, r: int, z: Array, readings: Array | None = None) -> Array:
        """Mean square error (ny,) of recording r sample by sample, not in blocks.

        Args:
            z: (K,) where the problem's unknowns stand, each in its own unit.
            readings: simulated (N, ny), in the outputs' units, if they are known.
        """
        with np.errstate(invalid="ignore"):
            e2 = (self.tracks[r].y - (self.readings(r, z) if readings is None else readings)) ** 2
        return np.array([np.mean(c[np.isfinite(c)]) if np.isfinite(c).any() else np.nan for c in e2.T])

    def residuals(self, z: Array) -> list[Array]:
        """Of all recordings; those of the last point asked for are kept, a fit asks twice.

        Args:
            z: (K,) where the problem's unknowns stand, each in its own unit.
        """
        if self._last is None or not np.array_equal(self._last[0], z):
            found = parallel([lambda r=r: self.residual(r, z) for r in range(len(self.tracks))])
            self._last = (z.copy(), found)
        return self._last[1]

    def cost(self, z: Array) -> float:
        """Whitened sum of squares plus prior; infinite where the machine diverges.

        Args:
            z: (K,) where the problem's unknowns stand, each in its own unit.
        """
        total = float(np.sum(self._prior(z) ** 2))
        for r, residual in enumerate(self.residuals(z)):
            if np.isnan(residual[np.isfinite(self.tracks[r].means)]).any():
                return np.inf
            total += float(np.nansum(self.white(residual) ** 2))
        return total

    def _prior(self, z: Array) -> Array:
        return np.array([(v - u.mean) / u.sd for v, u in zip(z, self.unknowns, strict=True)])

    def course(self, r: int, z: Array) -> Course:
        """The run of recording r, linearised.

        Args:
            z: (K,) where the problem's unknowns stand, each in its own unit.
        """
        machine, setting = self.machine, self.setting(r, z, self.machine.grid(self.tracks[r]))
        return SteppedCourse(machine, setting) if isinstance(machine, SteppedMachine) else Course(machine, setting)

    def columns(self, z: Array, courses: Sequence[Course] = (), by_runs: bool = False) -> list[Array]:
        """d(simulated block means)/dz per recording, (B, ny, K); zero for unknowns of other recordings.

        Args:
            z: (K,) where the problem's unknowns stand, each in its own unit.
            courses: the runs there, if they are known.
            by_runs: those of what all recordings share by a forward run each, slower and as exact as the runs are?
        """

        def of(r: int) -> Array:
            course = courses[r] if len(courses) else self.course(r, z)
            mine = [k for k, u in enumerate(self.unknowns) if u.recording in (-1, r)]
            out = np.zeros((*self.tracks[r].means.shape, len(self.unknowns)))
            out[:, :, mine] = self._columns_of(r, course, z, mine, by_runs)
            return out

        return parallel([lambda r=r: of(r) for r in range(len(self.tracks))])

    def _columns_of(self, r: int, course: Course, z: Array, mine: Sequence[int], by_runs: bool) -> Array:
        acts, start = course.none(len(mine)), np.zeros((len(course.active), len(mine)))
        direct = np.zeros((*self.tracks[r].means.shape, len(mine)))
        drifts: dict[tuple[int, float], Acts] = {}  # a parameter's knots all step it alike
        runs: dict[int, Array] = {}
        for i, k in enumerate(mine):
            u = self.unknowns[k]
            if u.kind == "start":
                # What an effect remembers is no state where the effect is nothing.
                start[course.active == u.at, i] = 1.0
                continue
            step = u.nudge(z[k])
            theta = course.setting.theta.copy()
            theta[u.at] += step
            candidate = self._candidate_at(u)
            if candidate is not None and candidate.acts_on_output:
                direct[:, :, i] = course.of_sensor(theta, self.since[r : r + 1] or (-np.inf,))[:, :, 0] / step
                continue
            if by_runs and u.recording < 0:
                runs[i] = self._by_a_run(r, course, z, k)
                continue
            if u.kind == "drift":
                if (u.at, step) not in drifts:
                    drifts[u.at, step] = course.of_always(theta, step)
                one = drifts[u.at, step].times(self._hat(r, k, course)[:, None])
            elif candidate is None:
                one = course.of_always(theta, step)
            elif candidate.acts_on_input or course.setting.theta[candidate.at[0]] == candidate.null[0]:
                one = course.of_candidate(candidate, theta, step, self.begun_s(r, u))
            else:
                one = course.of_present(theta, step, self.begun_s(r, u))
            acts.rates[:, :, i], acts.reads[:, :, i] = (part[:, :, 0] for part in one)
        columns = course.columns(acts, start)
        for i, run in runs.items():
            columns[:, :, i] = run
        return course.through_sensors(columns) + direct

    def _by_a_run(self, r: int, course: Course, z: Array, k: int) -> Array:
        """What one unknown does to what sound sensors read, (B, ny), in the outputs' units per its own."""
        moved = z.copy()
        moved[k] += (step := self.unknowns[k].nudge(z[k]))
        ahead = self.machine.clean(self.setting(r, moved, self.machine.grid(self.tracks[r])), blocks=True)
        return np.nan_to_num((ahead - course.clean) / step)

    def _candidate_at(self, unknown: Unknown) -> Candidate | None:
        """The candidate that an unknown belongs to; None of what the simulator has itself."""
        if unknown.kind != "mechanism":
            return None
        return next((c for c in self.machine.candidates if unknown.at in c.at), None)

    def begun_s(self, r: int, unknown: Unknown) -> float:
        """When what an unknown is about begins in recording r, s."""
        return self.since[r] if unknown.kind == "mechanism" and self.since else -np.inf

    def _hat(self, r: int, k: int, course: Course) -> Array:
        """(S,) share of a drift's knot along a course."""
        u, time_s = self.unknowns[k], self.tracks[r].time_s
        n = sum(v.kind == "drift" and v.at == u.at and v.recording == r for v in self.unknowns)
        return np.interp(course.grid.time_s, np.linspace(time_s[0], time_s[-1], n), np.eye(n)[u.knot])

    @property
    def _precision(self) -> Array:
        return np.array([u.sd**-2 for u in self.unknowns])

    def normal(self, z: Array) -> tuple[Array, list[Array]]:
        """Normal matrix (K, K) with the prior in it, and the whitened columns, (B, ny, K) per recording.

        Args:
            z: (K,) where the problem's unknowns stand, each in its own unit.
        """
        whitened, G = [self.white(c) for c in self.columns(z)], np.diag(self._precision)
        for J, _ in self._seen(z, whitened):
            G += J.T @ J
        return G, whitened

    def right_side(self, z: Array, whitened: Sequence[Array]) -> Array:
        """Right-hand side (K,) with the prior in it.

        Args:
            z: (K,) where the problem's unknowns stand, each in its own unit.
            whitened: columns (B, ny, K) per recording, dimensionless, as ``normal`` has them here or nearby.
        """
        b = self._precision * (self.z0 - z)
        for J, r in self._seen(z, whitened):
            b += J.T @ r
        return b

    def _seen(self, z: Array, whitened: Sequence[Array]) -> Iterator[tuple[Array, Array]]:
        """Whitened columns (n, K) and residuals (n,) of each recording where both are numbers."""
        for column, residual in zip(whitened, self.residuals(z), strict=True):
            r = self.white(residual)
            seen = np.isfinite(r) & np.isfinite(column).all(axis=-1)
            yield column[seen], r[seen]


def parallel(tasks: Sequence) -> list:  # type: ignore[type-arg]
    """Run thunks on the machine's cores; the compiled loop lets go of Python's lock."""
    threads = min(cores(), len(tasks))
    if threads <= 1:
        return [task() for task in tasks]
    with ThreadPoolExecutor(threads) as pool:
        return list(pool.map(lambda task: task(), tasks))
