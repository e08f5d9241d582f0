"""How large an effect was over time: the courses that it may have taken, with their probabilities."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from twinbench.mismatch.history.axis import Axis
from twinbench.mismatch.history.linear import Line
from twinbench.mismatch.history.patterns import CONSTANT, PATTERNS, RAMP, STEP, Pattern, Weighed, patterns, weigh
from twinbench.mismatch.mixture import having, interval_of, numbers_of
from twinbench.mismatch.naming.answer import shares
from twinbench.mismatch.naming.ground import Ground
from twinbench.mismatch.naming.name import NEAR, Naming
from twinbench.mismatch.naming.settle import Settled
from twinbench.physics.simulator import Array, Variable

MOVES = 2
"""Times that a size which is not constant is linearised anew, where its course has its posterior mean."""

PLACE = ("recording", "time_s")


class Point(NamedTuple):
    """The size at one time of a recording, with its 90 % interval, in the effect's unit."""

    recording: str
    time_s: float
    size: float
    low: float
    high: float


class Part(NamedTuple):
    """The size by one of several courses.

    Attributes:
        log: its evidence, nats.
        mean: (Q,) of the size at each knot, in the effect's unit.
        sd: (Q,) likewise.
    """

    log: float
    mean: Array
    sd: Array


class Interval(NamedTuple):
    """A number with its 90 % interval."""

    value: float
    low: float
    high: float


@dataclass(frozen=True)
class History:
    """An effect's size over all recordings that were learnt from.

    Attributes:
        size: the effect's first parameter.
        axis: of time, on which recordings stand one after the other.
        odds: probability of each of ``PATTERNS``.
        points: the size at each knot, recording by recording, all courses counted in.
        rate: of a ramp, in the size's unit per second; of one throughout, where the size is constant.
        change: of a step, in the size's unit.
        since: on the axis, when a ramp began or a step was, s; by the one of them that is likelier.
    """

    size: Variable
    axis: Axis
    odds: Mapping[str, float]
    points: tuple[Point, ...]
    rate: Interval
    change: Interval
    since: Interval

    @property
    def likeliest(self) -> str:
        """One of ``PATTERNS``."""
        return max(PATTERNS, key=lambda kind: self.odds[kind])

    @property
    def in_time(self) -> list[Point]:
        """The points, the earliest first."""
        return [self.points[q] for q in self.axis.order]

    @property
    def plain(self) -> dict[str, Any]:
        """As ``verdict.json`` has it."""
        kind, unit = self.likeliest, self.size.unit
        begun, earliest, latest = (dict(zip(PLACE, self.axis.place(t), strict=True)) for t in self.since)
        return {
            "pattern": kind,
            "probability": dict(self.odds),
            "clock": self.axis.clock,
            "unit": unit,
            "rate_per_s": self.rate._asdict() if kind in (CONSTANT, RAMP) else None,
            "change": self.change._asdict() if kind == STEP else None,
            "since": {**begun, "earliest": earliest, "latest": latest} if kind in (RAMP, STEP) else None,
            "points": [p._asdict() for p in self.points],
        }


def history_of(naming: Naming, chosen: Settled, place: int, floor: Array) -> History:
    """How large an effect of a hypothesis was over time.

    Args:
        place: of the effect in the hypothesis.
        floor: (ny,) noise of block means by their second differences, in the outputs' units.
    """
    axis = Axis.over(chosen.problem.tracks)
    first = Line.first(chosen, place, axis, naming.around(chosen), naming.ground)
    several, ground = patterns(axis, first.large), first.with_noise(floor)
    line, weighed = first, _weighed(first, first, ground, several)
    for _ in range(MOVES):
        best = max(weighed, key=lambda w: w.log).pattern
        ahead = line.moved(best, ground) if first.may_move and best.kind != CONSTANT else None
        if ahead is None:
            break
        line, ground = ahead, ahead.with_noise(floor)
        weighed = _weighed(first, line, ground, several)
    return _read(weighed, line, _told_in_all(naming, chosen.candidates[place]))


def _told_in_all(naming: Naming, candidate: int) -> list[tuple[float, float, float]]:
    """A constant size as the verdict tells it, by each hypothesis that has the effect: its share in nats, mean, sd."""
    those = having(naming.hypotheses, candidate)
    numbers = [numbers_of(h, h.candidates.index(candidate))[0] for h in those]
    logs = np.log(np.maximum(shares([h.log for h in those]), np.finfo(float).tiny))
    return [(float(log), mean, sd) for log, (mean, sd) in zip(logs, numbers, strict=True)]


def _weighed(first: Line, line: Line, ground: Ground, several: Sequence[Pattern]) -> list[Weighed]:
    """All patterns: that of a constant size where that stands, the others where they are likelier."""
    there = line.told(ground) if line is not first else []
    near, far = [weigh(there, p) for p in several] if there else [], first.told(ground)
    # All means count from where the line is.
    shift = (first.view.z[first.size] - line.view.z[line.size]) / first.view.problem.unknowns[first.size].spread
    found = []
    for k, p in enumerate(several):
        one = weigh(far, p)
        one = one._replace(mean=one.mean + shift)
        found.append(near[k] if near and p.kind != CONSTANT and near[k].log > one.log else one)
    return found


def _parts(weighed: Sequence[Weighed], line: Line, constant: Sequence[tuple[float, float, float]]) -> list[Part]:
    """The size at each knot by each course that is not so far behind that it adds nothing."""
    spread, level = line.view.problem.unknowns[line.size].spread, float(line.view.z[line.size])
    found = []
    for w in _near(weighed):
        if w.pattern.kind == CONSTANT:
            same = np.ones_like(w.mean)
            found += [Part(w.log + log, mean * same, sd * same) for log, mean, sd in constant]
        else:
            found.append(Part(w.log, level + spread * w.mean, spread * w.sd))
    return found


def _read(weighed: Sequence[Weighed], line: Line, constant: Sequence[tuple[float, float, float]]) -> History:
    """The history of what was weighed.

    Args:
        constant: the size, if it is the same at all times, as ``_told_in_all`` gives it.
    """
    axis, v = line.axis, line.candidate.mechanism.parameters[0]
    spread, likely = line.view.problem.unknowns[line.size].spread, _parts(weighed, line, constant)
    points = []
    for q, r in enumerate(axis.of):
        numbers = [(float(p.mean[q]), float(p.sd[q])) for p in likely]
        mean = float(np.average([m for m, _ in numbers], weights=shares([p.log for p in likely])))
        low, high = interval_of(likely, numbers, v.low, v.high)
        points.append(Point(axis.names[r], float(np.concatenate(axis.knots)[q]), mean, min(low, mean), max(high, mean)))
    odds = dict.fromkeys(PATTERNS, 0.0)
    for w, p in zip(weighed, shares([w.log for w in weighed]), strict=True):
        odds[w.pattern.kind] += p
    ramps, steps = ([w for w in weighed if w.pattern.kind == kind] for kind in (RAMP, STEP))
    last = float(axis.along_s.max())

    def per_s(w: Weighed) -> float:
        return float(spread * w.pattern.basis.max() / (last - w.pattern.since_s))

    def in_all(w: Weighed) -> float:
        return float(spread * w.pattern.basis.max())

    likeliest = max(odds, key=lambda kind: odds[kind])
    trends = ramps[:1] if likeliest == CONSTANT else ramps  # one throughout
    begun = ramps if odds[RAMP] >= odds[STEP] else steps
    return History(v, axis, odds, tuple(points), _number(trends, per_s), _number(steps, in_all), _since(begun))


def _near(weighed: Sequence[Weighed]) -> list[Weighed]:
    """Those that are not so far behind that they add nothing."""
    best = max(w.log for w in weighed)
    return [w for w in weighed if w.log > best - NEAR]


def _number(some: Sequence[Weighed], unit: Callable[[Weighed], float]) -> Interval:
    """A pattern's own number over all times since which it may hold, ``unit`` per its sd."""
    likely = _near(some)
    numbers = [(float(unit(w) * w.added[0]), float(unit(w) * w.added_sd[0])) for w in likely]
    mean = float(np.average([m for m, _ in numbers], weights=shares([w.log for w in likely])))
    low, high = interval_of(likely, numbers)
    return Interval(mean, min(low, mean), max(high, mean))


def _since(some: Sequence[Weighed]) -> Interval:
    """When a pattern begins: the middle of what is likely, and the middle 90 %."""
    p = np.array(shares([w.log for w in some]))
    low, high = np.array([w.pattern.within_s for w in some]).T
    edges = np.unique(np.concatenate((low, high)))
    # Between two recordings that stand end to end there is no time.
    wide = np.maximum(high - low, 1e-9 * max(float(np.ptp(edges)), 1e-9))
    sums = np.clip((edges[:, None] - low) / wide, 0.0, 1.0) @ p
    middle, *ends = (float(np.interp(q, sums, edges)) for q in (0.5, 0.05, 0.95))
    return Interval(middle, *ends)
