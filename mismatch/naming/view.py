"""Everything linearised around one fit: columns of unknowns, candidates and discrepancy, and their Gram matrices."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from twinbench.mismatch.course import Acts, Course, together
from twinbench.mismatch.fit import Problem, parallel
from twinbench.mismatch.machine import Candidate
from twinbench.mismatch.naming.discrepancy import Discrepancy
from twinbench.mismatch.variants import Variant, switched, typical
from twinbench.physics.simulator import Array

WANDERS = 0.05
HARDLY = WANDERS / 10.0
"""Prior sd of how much an effect's size differs from place to place, as a share of it: either, as likely as not. Most
forms of a catalogue are not exact; but where parameters hide most of a large effect, not even a hundredth goes unseen.
"""


@dataclass(frozen=True)
class View:
    """Columns around a fit, per recording (B, ny, K), in the outputs' units.

    The columns are per prior standard deviation of an unknown, or per typical size of a candidate, or per cent of
    discrepancy.

    Attributes:
        z: (K,) where the problem's unknowns stand, each in its own unit.
        residuals: (B, ny) per recording, in the outputs' units.
    """

    problem: Problem
    z: Array
    courses: tuple[Course, ...]
    residuals: tuple[Array, ...]

    @classmethod
    def around(cls, problem: Problem, z: Array) -> View:
        """A view of a fit.

        Args:
            z: (K,) where the problem's unknowns stand, each in its own unit.
        """
        every = range(len(problem.tracks))
        courses = parallel([lambda r=r: problem.course(r, z) for r in every])
        return cls(problem, z, tuple(courses), tuple(problem.residuals(z)))

    def unknowns(self, by_runs: bool = False) -> list[Array]:
        """Columns of the problem's unknowns, (B, ny, K) per recording, per prior sd.

        Args:
            by_runs: as of ``Problem.columns``.
        """
        spreads = self.problem.spreads
        return [c * spreads for c in self.problem.columns(self.z, self.courses, by_runs)]

    def wandering(
        self, d: Discrepancy, sizes: Sequence[int], share: float, added: Mapping[int, Sequence[Array]] | None = None
    ) -> list[Array]:
        """Columns of effects whose sizes differ a little from place to place, (B, ny, E M) per recording.

        Args:
            sizes: E positions of the sizes among the unknowns.
            share: by which share of themselves they differ (sd).
            added: by position, what a size has more than it has throughout, (S,) per recording, in its unit.
        """

        def of(r: int) -> Array:
            course = self.courses[r]
            functions = d.functions(course) @ d.main
            found = [np.zeros((*self.residuals[r].shape, 0))]
            for k in sizes:  # one after the other: all at once take gigabytes of twelve effects
                u = self.problem.unknowns[k]
                step = u.nudge(self.z[k])
                theta = course.setting.theta.copy()
                theta[u.at] += step
                one = course.of_present(theta, step, self.problem.begun_s(r, u))
                much = share * (self.z[k] - u.mean)
                if added and k in added:
                    much = much + share * added[k][r][:, None, None]
                found.append(course.columns(Acts(one.rates * much, one.reads * much).times(functions)))
            return np.concatenate(found, axis=2)

        return parallel([lambda r=r: of(r) for r in range(len(self.courses))])

    def of_variants(self, variants: Sequence[Variant], probes: Array, since_s: Sequence[float] = ()) -> list[Array]:
        """Columns of absent candidates, (B, ny, V (1 + T)) per recording and per typical size.

        Args:
            probes: (V,) dimensionless share of the typical size that each is tried with.
            since_s: T times; each variant also as it would be from then on.
        """
        return parallel(
            [lambda r=r: self.of_variants_in(r, variants, probes, since_s) for r in range(len(self.courses))]
        )

    def of_variants_in(
        self, r: int, variants: Sequence[Variant], probes: Array, since_s: Sequence[float] = ()
    ) -> Array:
        """As ``of_variants``, of recording r: (B, ny, V (1 + T)).

        Args:
            probes: (V,) dimensionless share of the typical size that each is tried with.
            since_s: T times.
        """
        if not variants:
            return np.zeros((*self.residuals[r].shape, 0))
        course = self.courses[r]
        many = 1 + len(since_s)
        acts, direct = [], []
        course.remember([self._tried(course, v, probe)[:2] for v, probe in zip(variants, probes, strict=True)])
        for v, probe in zip(variants, probes, strict=True):
            candidate, theta, step = self._tried(course, v, probe)
            if candidate.acts_on_output:
                acts.append(course.none(many))
                direct.append(course.of_sensor(theta, (-np.inf, *since_s)) / probe * np.sign(step))
            else:
                unit = typical(candidate)
                acts.append(Acts(*(part * unit for part in course.begun(candidate, theta, step, since_s))))
                direct.append(np.zeros((*self.residuals[r].shape, many)))
        return course.columns(together(acts)) + np.concatenate(direct, axis=2)

    def _tried(self, course: Course, variant: Variant, probe: float) -> tuple[Candidate, Array, float]:
        candidate = self.problem.machine.candidates[variant.candidate]
        step, first = probe * typical(candidate), candidate.mechanism.parameters[0]
        if not first.low <= candidate.null[0] + step <= first.high:
            step = -step
        return candidate, switched(self.problem.machine, course.setting.theta, variant, step), step

    def of_discrepancy(self, d: Discrepancy, ports: Sequence[int]) -> list[Array]:
        """Columns of the random functions at some ports, (B, ny, P R) per recording."""

        def of(r: int) -> Array:
            course = self.courses[r]
            functions = d.functions(course)
            return course.columns(together([d.acts(course, p, functions) for p in ports]))

        return parallel([lambda r=r: of(r) for r in range(len(self.courses))])


def prior_mean(view: View) -> Array:
    """(K,) prior mean of a view's unknowns from where they stand, in prior sds."""
    return (view.problem.z0 - view.z) / view.problem.spreads
