"""What one experiment would show: each rival's run of it, and the columns of all that each leaves open."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from twinbench.mismatch.course import Course
from twinbench.mismatch.design.candidates import Candidate
from twinbench.mismatch.design.clock import Clock
from twinbench.mismatch.design.hand import Folded, Hand, folded_out, functions_of, own_columns, own_of, shared
from twinbench.mismatch.fit import ENDLESS, Problem
from twinbench.mismatch.naming.input_noise import InputNoise, Moves
from twinbench.mismatch.naming.settle import Settled
from twinbench.mismatch.naming.view import View
from twinbench.mismatch.place import CLOCK
from twinbench.mismatch.sensors import SensorNoise
from twinbench.mismatch.tracks import Track
from twinbench.physics.simulator import Array

HOLDS, RESTED, ENDLESSLY = 20, 1e-3, 0.9
"""An experiment begins where its first inputs lead: they are held as often as this for as long as it lasts, or until
nothing moves by more than this share of its scale. A machine that takes longer begins a little off its rest. One that
in the end moves by this share of what it moved at first has none, as an angle that turns on."""


class Shown(NamedTuple):
    """What an experiment shows under one rival.

    Attributes:
        own: (n, K) whitened columns of its unknowns, the experiment's own among them.
        alone: (k,) positions of those that are the experiment's own.
        white: (n,) whitened readings that it foretells.
        means: (B, ny) the same in the outputs' units.
    """

    own: Array
    alone: np.ndarray
    white: Array
    means: Array


@dataclass(frozen=True)
class Trial:
    """One experiment on paper.

    Attributes:
        shown: under each rival.
        functions: (n, F) whitened columns of the discrepancy.
        track: its blocks.
    """

    candidate: Candidate
    shown: tuple[Shown, ...]
    functions: Array
    track: Track

    def until(self, share: float) -> Trial:
        """Its first part alone."""
        rows = len(self.functions) // len(self.shown[0].means) * round(share * len(self.shown[0].means))
        shown = tuple(s._replace(own=s.own[:rows], white=s.white[:rows]) for s in self.shown)
        return replace(self, shown=shown, functions=self.functions[:rows])

    @cached_property
    def grams(self) -> list[Array]:
        """(K + F, K + F) products of the columns of each rival's unknowns, the discrepancy's last."""
        FF, found = self.functions.T @ self.functions, []
        for own in (s.own for s in self.shown):
            across = own.T @ self.functions
            found.append(np.block([[own.T @ own, across], [across.T, FF]]))
        return found

    def kept(self, rival: int, weights: Array) -> Array:
        """(n, M) whitened, what M values of all that the experiment shares with the recordings do to its readings.

        Args:
            weights: (L, M) these values, as ``Known`` has their order, dimensionless: in prior sds, or per cent.
        """
        own = np.delete(self.shown[rival].own, self.shown[rival].alone, axis=1)
        return own @ weights[: own.shape[1]] + self.functions @ weights[own.shape[1] :]

    def folded(self, rival: int, readings: Array) -> tuple[Folded, Array]:
        """What readings say of a rival's shared unknowns, and their squares (M,) less what it foretells.

        Args:
            readings: (n, M) whitened.
        """
        shown = self.shown[rival]
        e = readings - shown.white[:, None]
        right = np.concatenate((shown.own.T @ e, self.functions.T @ e))
        folded = folded_out(self.grams[rival], right, shown.alone, np.zeros(len(shown.alone)))
        return folded, np.einsum("nm,nm->m", e, e)


def track_of(candidate: Candidate, clock: Clock, measured: np.ndarray) -> Track:
    """An experiment's blocks; its readings are nothing, and missing where no sensor is.

    Args:
        measured: (ny,) bool, is there a sensor?
    """
    y = np.where(measured, 0.0, np.nan) * np.ones((len(candidate.time_s), 1))
    starts = np.arange(0, len(y), clock.block)
    return Track("experiment", candidate.time_s + clock.begin_s, candidate.u, y, starts, y[starts], linear=clock.linear)


def tried(candidate: Candidate, hand: Hand, clock: Clock) -> Trial | None:
    """An experiment on paper; None if a rival's run of it goes beyond all numbers, or beyond the outputs' bounds."""
    track = track_of(candidate, clock, hand.measured)
    shown, functions = [], np.empty((0, 0))
    for k, rival in enumerate(hand.rivals):
        problem, z = _begun(rival, track)
        (residual,) = problem.residuals(z)
        if not _allowed(-residual, hand):
            return None
        made = _shown(View(problem, z, (problem.course(0, z),), (residual,)), hand, k, clock.noise)
        if made is None:
            return None
        shown.append(made[0])
        functions = functions if k else made[1]
    return Trial(candidate, tuple(shown), functions, track)


def _shown(view: View, hand: Hand, k: int, noise: SensorNoise) -> tuple[Shown, Array] | None:
    """What a view shows under rival k, and under the first the discrepancy's columns; None beyond all numbers."""
    rival = hand.rivals[k]
    common = shared(rival)
    parts = own_columns(view, rival, hand.ground, [common.index(i) for i in rival.wanders])
    many = parts[0].shape[2]
    if not k:
        parts += functions_of(view, hand.ground)
    columns = np.concatenate(parts, axis=2)
    if not np.abs(columns).max(initial=0.0) < ENDLESS:
        return None
    white = _whitened(view, columns, noise)
    alone = np.flatnonzero([u.recording == 0 for u in view.problem.unknowns])
    return Shown(white[:, :many], alone, -white[:, -1], -view.residuals[0]), white[:, many:-1]


class Foretold(NamedTuple):
    """What a rival foretells.

    Attributes:
        means: (B, ny) block means, in the outputs' units.
        sds: (B, ny) of what the recordings leave open of them, the noise apart, likewise.
    """

    means: Array
    sds: Array


def foretold(candidate: Candidate, hand: Hand, clock: Clock) -> list[Foretold]:
    """The readings that each rival foretells, with what the recordings leave open of it."""
    track, found, functions = track_of(candidate, clock, hand.measured), [], np.empty(0)
    for k, rival in enumerate(hand.rivals):
        view, common = View.around(*_begun(rival, track)), shared(rival)
        (own,) = own_columns(view, rival, hand.ground, [common.index(i) for i in rival.wanders])
        functions = functions if k else functions_of(view, hand.ground)[0]
        alone = np.flatnonzero([u.recording == 0 for u in view.problem.unknowns])
        kept = np.delete(np.concatenate((own, functions), axis=2), alone, axis=2)
        mean, root = hand.truths[k]
        found.append(Foretold(kept @ mean - view.residuals[0], np.sqrt(np.sum((kept @ root) ** 2, axis=2))))
    return found


def with_sensor(trial: Trial, hand: Hand, clock: Clock, state: int, sd: float) -> Trial | None:
    """An experiment on paper with one sensor more, of a state.

    Args:
        sd: of the sensor's noise in block means, in the state's unit.
    """
    shown, functions = [], np.empty((0, 0))
    for k, (rival, before) in enumerate(zip(hand.rivals, trial.shown, strict=True)):
        machine = rival.problem.machine.reading_states()
        track = track_of(trial.candidate, clock, np.arange(len(machine.states)) == state)
        problem, z = _begun(rival, track)
        white = SensorNoise(*(np.full(len(machine.states), v) for v in (sd**2, 1e-6 * sd**2, 1.0)))
        made = _shown(View.around(replace(problem, machine=machine), z), hand, k, white)
        if made is None:
            return None
        more = made[0]
        own, readings = np.concatenate((before.own, more.own)), np.concatenate((before.white, more.white))
        shown.append(before._replace(own=own, white=readings))
        functions = functions if k else np.concatenate((trial.functions, made[1]))
    return Trial(trial.candidate, tuple(shown), functions, trial.track)


def course_of(rival: Settled, candidate: Candidate, clock: Clock, measured: np.ndarray) -> Course:
    """A rival's run of an experiment, linearised.

    Args:
        measured: (ny,) bool, is there a sensor?
    """
    problem, z = _begun(rival, track_of(candidate, clock, measured))
    return problem.course(0, z)


def states_of(rival: Settled, candidate: Candidate, clock: Clock) -> Array:
    """(B, nx) states along a rival's run of an experiment, in their units; effects' own last."""
    problem, z = _begun(rival, track_of(candidate, clock, np.ones(len(rival.problem.machine.simulator.outputs), bool)))
    return problem.states(0, z)


def _begun(rival: Settled, track: Track) -> tuple[Problem, Array]:
    """An experiment that begins at rest as a problem of its own, and where its unknowns stand under a rival."""
    learnt, common = rival.problem, shared(rival)
    unknowns = (*(learnt.unknowns[k] for k in common), *own_of(rival, track))
    z = np.concatenate((rival.z[common], [u.mean for u in unknowns[len(common) :]]))
    unread = np.full((len(track.time_s), len(learnt.machine.simulator.outputs)), np.nan)
    start = learnt.machine.start(replace(track, y=unread))
    problem = Problem(learnt.machine, [track], unknowns, learnt.sd, [start], learnt.theta)
    return replace(problem, starts=[_rested(problem, z)]), z


def _rested(problem: Problem, z: Array) -> Array:
    """(nx,) where the machine is after the first inputs were held for long; where it begins, if that has no end."""
    (track,) = problem.tracks
    held = replace(track, u=np.tile(track.u[0], (len(track.u), 1)))
    (start,), states = problem.starts, problem.machine.states
    clocks = np.array([v.name.startswith(CLOCK) for v in states])
    scales, now, moves = np.array([v.scale for v in states]), start, list[float]()
    for _ in range(HOLDS):
        end = np.where(clocks, start, replace(problem, tracks=[held], starts=[now]).states(0, z)[-1])
        if not np.isfinite(end).all():
            return start
        moves.append(float((np.abs(end - now) / scales).max()))
        now = end
        if moves[-1] <= RESTED:
            return now
    return now if moves[-1] < ENDLESSLY * moves[0] else start


def _allowed(readings: Array, hand: Hand) -> bool:
    """Are they numbers, within the bounds of the outputs?"""
    seen = readings[:, hand.measured]
    low, high = hand.low[hand.measured], hand.high[hand.measured]
    return bool(np.isfinite(seen).all() and (seen >= low).all() and (seen <= high).all())


def _whitened(view: View, columns: Array, noise: SensorNoise) -> Array:
    """Columns and last the residuals, whitened; with what a measured input's noise does, if one is measured."""
    (residual,), sds = view.residuals, view.problem.machine.input_sds
    white = noise.beside(columns, residual)
    if not sds.any():
        return white
    moved = Moves(view.courses[0], sds).felt(noise, residual)
    return InputNoise.of(noise.beside(moved, residual)[:, :-1]).whitened(white)
