"""What the readings tell of an effect's size over time: columns of its knots, and all else integrated out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.linalg import cho_solve

from twinbench.mismatch.course import Course
from twinbench.mismatch.fit import parallel
from twinbench.mismatch.history.axis import Axis
from twinbench.mismatch.history.patterns import WALKS, Pattern, Told, walk
from twinbench.mismatch.machine import WHISPER, Candidate
from twinbench.mismatch.naming.bounded import Bounds
from twinbench.mismatch.naming.ground import Ground
from twinbench.mismatch.naming.marginal import DISCREPANCY_PCT, Reduced, eliminated, factored
from twinbench.mismatch.naming.settle import Settled, columns_of
from twinbench.mismatch.naming.steady import UNSTEADY
from twinbench.mismatch.naming.view import WANDERS, View, prior_mean
from twinbench.physics.simulator import Array, Series

DRIFTS_PCT = (1.0, 4.0, 16.0)
"""What wanders at a port from the first recording's beginning to the last one's end (sd), in per cent of what is
common there."""


@dataclass(frozen=True)
class Line:
    """A hypothesis whose effect has some size at each knot, linearised there.

    Attributes:
        place: of the effect in the hypothesis.
        view: around where it is linearised.
        ground: that the hypothesis stands on.
        added: (Q,) what the size has there at each knot beside its constant part, dimensionless: in prior sds.
    """

    chosen: Settled
    place: int
    axis: Axis
    view: View
    ground: Ground
    added: Array

    @cached_property
    def size(self) -> int:
        """Position of the size among the unknowns."""
        return int(self.chosen.entries(self.place)[0])

    @classmethod
    def first(cls, chosen: Settled, place: int, axis: Axis, view: View, ground: Ground) -> Line:
        """Where the hypothesis stands: a size that is constant, from when it begins."""
        bare = cls(chosen, place, axis, view, ground, np.zeros(len(axis.along_s)))
        large = (view.z[bare.size] - bare.candidate.null[0]) / view.problem.unknowns[bare.size].spread
        absent = np.concatenate(axis.knots) < chosen.since_s
        return replace(bare, added=-(1.0 - WHISPER) * large * absent)

    @property
    def large(self) -> float:
        """How large the effect is in the hypothesis, in prior sds of its size."""
        return abs(float(self.chosen.sizes[self.place])) / self.chosen.problem.unknowns[self.size].spread

    @cached_property
    def candidate(self) -> Candidate:
        """What the effect is."""
        chosen = self.chosen
        return chosen.problem.machine.candidates[chosen.effects[self.place].variant.candidate]

    @cached_property
    def kept(self) -> list[int]:
        """Positions of what is unknown and at no bound, the size last."""
        low, high = Bounds.of(self.chosen.problem).around(self.view.z)
        held = {*np.flatnonzero((low >= 0.0) | (high <= 0.0)), self.size}
        return [*(k for k in range(len(self.chosen.mean)) if k not in held), self.size]

    @cached_property
    def mean(self) -> Array:
        """(U,) prior mean of what is kept, in prior sds from where it is linearised."""
        whole = np.zeros(len(self.chosen.mean))
        whole[: len(self.view.z)] = prior_mean(self.view)
        return whole[self.kept]

    @cached_property
    def columns(self) -> list[Array]:
        """(B, ny, U) of what is kept per recording, in the outputs' units per prior sd.

        A form that is not exact is off by a share of what the size is at each time, not of its constant part alone.
        """
        own = columns_of(self.view, self.ground, self.chosen.wanders, added={self.size: self._more})
        # An effect that begins late has a size at all times, too: it is none at first.
        whole = [k.sum(axis=2, keepdims=True) for k in self.knots]
        several = [c[:, :, self.kept[:-1]] for c in own]
        return [np.concatenate(pair, axis=2) for pair in zip(several, whole, strict=True)]

    @property
    def _more(self) -> list[Array]:
        """(S,) per recording: what the size has there beside its constant part, in its unit."""
        problem, grids = self.view.problem, [c.grid for c in self.view.courses]
        if problem.since:  # a form that is not exact is none before the effect begins
            return [np.zeros(len(g.time_s)) for g in grids]
        spread = problem.unknowns[self.size].spread
        return [spread * self.axis.hats(r, g.time_s) @ self.added for r, g in enumerate(grids)]

    @cached_property
    def knots(self) -> list[Array]:
        """(B, ny, Q) of what is added to the size at each knot per recording, in the outputs' units per prior sd."""
        problem, u = self.view.problem, self.view.problem.unknowns[self.size]

        def of(r: int) -> Array:
            course, step = self.view.courses[r], u.nudge(self.view.z[self.size])
            theta = course.setting.theta.copy()
            theta[u.at] += step
            if self.candidate.acts_on_output:
                ahead, here = (course.of_sensor(t, (-np.inf,))[:, :, 0] for t in (theta, course.setting.theta))
                column = (ahead - here) / step
                return column[:, :, None] * self.axis.hats(r, problem.tracks[r].block_time_s)[:, None, :] * u.spread
            acts_on_input = self.candidate.acts_on_input
            one = course.of_input(theta, step) if acts_on_input else course.of_present(theta, step)
            hats = self.axis.hats(r, course.grid.time_s)
            return course.through_sensors(course.columns(one.times(hats))) * u.spread

        return parallel([lambda r=r: of(r) for r in range(len(self.view.courses))])

    def with_noise(self, floor: Array) -> Ground:
        """The ground with its noise learnt anew, beside a size that wanders widely.

        Args:
            floor: (ny,) noise of block means by their second differences, in the outputs' units.
        """
        wandering = walk(self.axis, WALKS[-1] * self.large)
        columns = [np.concatenate((c, k @ wandering), axis=2) for c, k in zip(self.columns, self.knots, strict=True)]
        mean = np.concatenate((self.mean, np.zeros(wandering.shape[1])))
        return self.ground.relearnt(self._from_constant, columns, mean, floor)

    def told(self, ground: Ground) -> list[Told]:
        """What the readings tell beside the discrepancy of a constant size, and beside that of one that wanders.

        Beside each with a form that is inexact as forms are or off by far more, and with nothing or something that
        wanders in time at the effect's port: none of that must look like a course. Each is as likely.
        """
        drift = walk(self.axis, 1.0)
        G, b, squares = self._products(
            ground, [np.concatenate((k, f @ drift), axis=2) for k, f in zip(self.knots, self.forces, strict=True)]
        )
        own, many = len(self.kept), drift.shape[1] if self.forces[0].any() else 0
        at = np.flatnonzero(np.isin(self.kept, self.chosen.wandering(self.place)))
        first = own + drift.shape[0]
        block = np.array([*range(own - 1), *range(first, first + drift.shape[1])])
        mean = np.concatenate((self.mean[:-1], np.zeros(drift.shape[1])))
        found = []
        for wider in (1.0, UNSTEADY / WANDERS) if len(at) else (1.0,):
            for pct in (0.0, *DRIFTS_PCT) if many else (0.0,):
                by = np.ones(len(b))
                by[at], by[first : first + drift.shape[1]] = wider, pct
                inner = eliminated(G * by[:, None] * by, b * by, block, mean, np.ones(len(block)))
                several = self.chosen.learnt.s, ground.s
                found += [_beside(inner, s, float(self.mean[-1]), ground, squares) for s in several]
        return found

    @cached_property
    def forces(self) -> list[Array]:
        """(B, ny, Q) of something at the effect's port at each knot, in the outputs' units per cent of what is common.

        Nothing of what acts where nothing unnamed may.
        """
        d, port = self.ground.discrepancy, self.candidate.mechanism.port
        if not self.ground.ports or port not in d.ports:
            return [np.zeros_like(k) for k in self.knots]

        def of(r: int) -> Array:
            course = self.view.courses[r]
            return course.columns(d.acts(course, d.ports.index(port), self.axis.hats(r, course.grid.time_s)))

        return parallel([lambda r=r: of(r) for r in range(len(self.view.courses))])

    def moved(self, pattern: Pattern, ground: Ground) -> Line | None:
        """The same, linearised where a pattern has its posterior mean; None if the run diverges there."""
        turned = [k @ pattern.basis for k in self.knots]
        G, b, _ = self._products(ground, turned)
        own, k = len(self.kept), pattern.basis.shape[1]
        precision = np.concatenate((np.ones(own + k), ground.precision(ground.s)))
        right = b.copy()
        right[:own] += self.mean
        scale, L = factored(G + np.diag(precision))
        found = scale * cho_solve((L, True), scale * right)
        z, bounds = self.view.z.copy(), Bounds.of(self.view.problem)
        for step, at in zip(found[:own], self.kept, strict=True):
            if at < len(z):
                z[at] += step * bounds.scale[at]
        z = np.clip(z, bounds.low, bounds.high)
        added = pattern.basis @ found[own : own + k]
        view = self._around(z, added)
        return None if view is None else replace(self, view=view, added=added)

    @property
    def _from_constant(self) -> View:
        """The view with residuals as they would be, to first order, with nothing added to the size."""
        pairs = zip(self.view.residuals, self.knots, strict=True)
        return replace(self.view, residuals=tuple(r + k @ self.added for r, k in pairs))

    def _products(self, ground: Ground, beside: Sequence[Array]) -> tuple[Array, Array, float]:
        columns = [np.concatenate(pair, axis=2) for pair in zip(self.columns, beside, strict=True)]
        return ground.products(self._from_constant, columns).over()

    def _around(self, z: Array, added: Array) -> View | None:
        """A view around a run in which something is added to the size; None if it diverges.

        Args:
            z: (K,) where the problem's unknowns stand, each in its own unit.
            added: (Q,) at each knot, in prior sds.
        """
        problem = replace(self.view.problem, since=())
        machine, u = problem.machine, problem.unknowns[self.size]

        def of(r: int) -> tuple[Course, Array]:
            grid = machine.grid(problem.tracks[r])
            plain = problem.setting(r, z, grid)
            size = plain.theta[u.at] + u.spread * self.axis.hats(r, grid.time_s) @ added
            size = np.clip(size, u.low, u.high)[:, None]
            values = size if plain.values is None else np.concatenate((plain.values, size), axis=1)
            setting = replace(plain, varying=np.append(plain.varying, u.at), values=values)
            offset = problem.offsets[r] if len(problem.offsets) else 0.0
            return Course(machine, setting), problem.tracks[r].means - machine.run(setting, blocks=True) - offset

        found = parallel([lambda r=r: of(r) for r in range(len(problem.tracks))])
        courses, residuals = zip(*found, strict=True)
        pairs = zip(residuals, problem.tracks, strict=True)
        if any(not np.isfinite(e[np.isfinite(t.means)]).all() for e, t in pairs):
            return None
        return View(problem, z, courses, residuals)

    @property
    def may_move(self) -> bool:
        """Can a run have another size at each time? A fault of a channel has one size."""
        return not isinstance(self.candidate.mechanism, Series)


def _beside(inner: Reduced, s: Array, mean: float, ground: Ground, squares: float) -> Told:
    """What is left beside a discrepancy of some sizes (P,), per cent.

    Args:
        squares: of the whitened residuals.
    """
    block = np.arange(len(inner.b) - len(ground.group), len(inner.b))
    if not len(block):
        return Told(inner.G, inner.b, inner.log - 0.5 * squares, mean)
    left = eliminated(inner.G, inner.b, block, np.zeros(len(block)), ground.precision(s))
    prior = -0.5 * float(np.sum((s / DISCREPANCY_PCT) ** 2))
    return Told(left.G, left.b, inner.log + left.log + prior - 0.5 * squares, mean)
