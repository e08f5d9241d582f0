"""The experiment to make next: all candidates tried on paper, the best of them looked at closely."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import ndtr

from twinbench.common.errors import BadInput
from twinbench.mismatch.design.candidates import Candidate
from twinbench.mismatch.design.clock import Clock
from twinbench.mismatch.design.hand import Hand, at_hand
from twinbench.mismatch.design.precision import gained
from twinbench.mismatch.design.separation import SCATTER, Expected, expected, groups_of, nats, worst
from twinbench.mismatch.design.trials import Trial, course_of, tried
from twinbench.mismatch.naming.decision import CREDIBLE
from twinbench.mismatch.naming.discrepancy import discrepancy
from twinbench.mismatch.naming.ground import Ground
from twinbench.mismatch.naming.name import common
from twinbench.mismatch.naming.power import WANTED
from twinbench.mismatch.naming.settle import Settled
from twinbench.mismatch.naming.view import View
from twinbench.mismatch.visited import moved
from twinbench.physics.simulator import Array

ANCHORED = 12
"""Candidates whose runs say, beside the recordings, where the discrepancy has to be described."""
FINALISTS = 5
"""Candidates that are simulated: so many of the likeliest to be enough, and so many of those that reach out least."""
SURELY, CAME_TRUE = 2.0, 0.5
"""Sds of its scatter by which evidence has to exceed what a name takes, for a candidate to be surely enough; and which
share of the evidence counts. Forms of a catalogue are not exact, so elsewhere the discrepancy is learnt larger: on
concealed machines about half of what was foretold came true."""
TIMES = (1, 2, 3, 4, 6, 8)
"""How often an experiment may be made: what eight times do not tell, more hardly will."""
PARTS = (0.25, 0.5, 0.75)
AS_GOOD = 0.02
"""Probability that a shorter experiment, or one that reaches out less, may lose and still do."""


@dataclass(frozen=True)
class Choice:
    """The best of candidates.

    Attributes:
        trial: it.
        groups: (m,) dimensionless labels of rivals, one for those that no experiment here tells apart.
        expected: what it promises, made once; None where nothing is contested.
        made: all candidates that can be made.
        worth: (C,) dimensionless, nats of each of them: the worst pair's, or what parameters gain.
        left_out: candidates that could not be made.
    """

    trial: Trial
    groups: np.ndarray
    expected: Expected | None
    made: tuple[Candidate, ...]
    worth: Array
    left_out: int

    @property
    def scattered(self) -> bool:
        """Does chance move the closest pair's evidence further than any candidate does? Then none settles it."""
        return self.expected is not None and float(self.worth[0]) < SCATTER


@dataclass(frozen=True)
class Proposal(Choice):
    """The experiment to make next.

    Attributes:
        times: how often it has to be made for a name with probability ``WANTED``; 0 if no number tried is enough.
        repeated: probability of the right name if it is made so often, or as often as was tried.
        enough_s: the shortest part of it, from its beginning on, that promises as much.
    """

    times: int
    repeated: float
    enough_s: float


def hand_of(
    rivals: Sequence[Settled], names: Sequence[str], ground: Ground, candidates: Sequence[Candidate], clock: Clock
) -> Hand:
    """What is at hand, the discrepancy described wherever recordings and candidates go."""
    best, measured = rivals[0], np.ones(len(ground.noise.white), dtype=bool)
    if not ground.ports:
        return at_hand(rivals, names, ground)
    view = View.around(best.problem, best.z)
    some = candidates[:: max(1, len(candidates) // ANCHORED)]
    courses = [c for c in (course_of(best, one, clock, measured) for one in some) if np.isfinite(c.means).all()]
    if view.courses:
        there = common(view, moved(best.problem, best.z))
    else:
        there = common(replace(view, courses=tuple(courses)), best.problem.machine.simulator)
    whole = discrepancy([*view.courses, *courses], there)
    return at_hand(rivals, names, _where_it_counts(replace(ground, discrepancy=whole), rivals))


def _where_it_counts(ground: Ground, rivals: Sequence[Settled]) -> Ground:
    """With the discrepancy at ports where one was found, and where rivals act: there it does most like them.

    A machine may have twenty others, and each costs as much.
    """
    d, candidates = ground.discrepancy, rivals[0].problem.machine.candidates
    acting = {candidates[e.variant.candidate].mechanism.port for h in rivals for e in h.effects}
    some = [p for p, port in enumerate(d.ports) if port in ground.ports or port in acting]
    fewer = replace(d, ports=tuple(d.ports[p] for p in some), units=d.units[some])
    return replace(ground, discrepancy=fewer, kept=tuple((some.index(p), turn) for p, turn in ground.kept))


@dataclass(frozen=True)
class Ranked:
    """Candidates that can be made, the best first.

    Attributes:
        made: these.
        worth: (C,) dimensionless, nats of each: the closest pair's, or what parameters gain.
        sure: (C,) bool, does enough come, by ``SURELY``, for a name of whichever rival is true?
        chance: (C,) dimensionless probability that enough comes, by the rivals' probabilities; ``worth`` where nothing
            is contested.
        reach: (C,) dimensionless, how far each leaves what the recordings went through, in scales of its variables.
        groups: (m,) dimensionless labels of rivals, one for those that none of the candidates tells apart.
        left_out: candidates that cannot be made.
    """

    hand: Hand
    clock: Clock
    groups: np.ndarray
    made: tuple[Candidate, ...]
    worth: Array
    sure: np.ndarray
    chance: Array
    reach: Array
    left_out: int

    def finalists(self, many: int) -> list[Trial]:
        """Those that are enough for a name and reach out least, and the likeliest to be, so many of each.

        They are tried once more: all candidates at once would fill the memory.
        """
        sure = np.flatnonzero(self.sure)
        near = sure[np.argsort(self.reach[sure], kind="stable")][:many]
        some = dict.fromkeys([*near, *np.argsort(-self.chance, kind="stable")[:many]])
        again = (tried(self.made[i], self.hand, self.clock) for i in some)
        return [trial for trial in again if trial is not None]


def enough(hand: Hand, added: Array, groups: np.ndarray) -> tuple[bool, float]:
    """Does enough evidence come for a name of whichever rival is true? And with what probability does it?

    Args:
        added: (m, m) dimensionless, nats that a true rival (row) gains on another (column).
        groups: (m,) dimensionless labels of rivals.
    """
    apart = groups[:, None] != groups
    takes = np.log(CREDIBLE / (1.0 - CREDIBLE)) + hand.logs - hand.logs[:, None]
    comes = CAME_TRUE * np.maximum(added, 0.0)
    scatter = np.sqrt(2.0 * comes)
    sure = bool((comes - SURELY * scatter > takes)[apart].all())
    each = np.where(apart, ndtr((comes - takes) / np.maximum(scatter, np.finfo(float).eps)), 1.0)
    return sure, float(hand.probabilities @ each.min(axis=1))


def ranked(
    hand: Hand, candidates: Sequence[Candidate], clock: Clock, progress: Callable[[float], None] = lambda share: None
) -> Ranked:
    """Candidates by what they add for the closest pair of rivals; by what parameters gain where nothing is contested.

    Raises:
        BadInput: none of them can be made: the simulator leaves its outputs' bounds in all.
    """
    contested, made, worth, added = len(hand.rivals) > 1, list[Candidate](), list[float](), list[Array]()
    reach = list[float]()
    for k, one in enumerate(candidates):
        trial = tried(one, hand, clock)
        if trial is not None:
            made.append(one)
            reach.append(hand.reach(one.u, trial.shown[0].means))
            if contested:
                added.append(nats(hand, trial))
            else:
                worth.append(gained(hand, trial).nats)
        progress((k + 1) / len(candidates))
    if not made:
        raise BadInput(
            f"none of {len(candidates)} experiments can be made: the simulator leaves the bounds of its outputs in "
            "all of them; narrow the limits of the inputs, or mend the bounds"
        )
    groups = groups_of(added) if contested else np.zeros(1, dtype=int)
    values = np.array([worst(n, groups) for n in added] if contested else worth)
    there_is = [enough(hand, n, groups) for n in added] if contested else [(False, value) for value in worth]
    order = np.argsort(-values, kind="stable")
    sure, chance = (np.array(one)[order] for one in zip(*there_is, strict=True))
    left_out, there = len(candidates) - len(made), np.array(reach)[order]
    return Ranked(hand, clock, groups, tuple(made[i] for i in order), values[order], sure, chance, there, left_out)


def best_of(
    hand: Hand, candidates: Sequence[Candidate], clock: Clock, progress: Callable[[float], None] = lambda share: None
) -> Choice:
    """The best of candidates: of those that promise a name as surely, the one that reaches out least.

    Where the recordings were the simulator is known. The farther from there, the more of what nobody asked about shows.

    Raises:
        BadInput: none of them can be made.
    """
    order = ranked(hand, candidates, clock, progress)
    if len(hand.rivals) < 2:
        (best,) = order.finalists(1)
        return Choice(best, order.groups, None, order.made, order.worth, order.left_out)
    finalists = order.finalists(FINALISTS)
    looked_at = [expected(hand, trial, order.groups) for trial in finalists]
    # Chance decides between probabilities as near as this.
    least = max(e.right for e in looked_at) - AS_GOOD
    good = [i for i, e in enumerate(looked_at) if e.right >= least]
    k = min(good, key=lambda i: hand.reach(finalists[i].candidate.u, finalists[i].shown[0].means))
    return Choice(finalists[k], order.groups, looked_at[k], order.made, order.worth, order.left_out)


def proposed(
    hand: Hand, candidates: Sequence[Candidate], clock: Clock, progress: Callable[[float], None] = lambda share: None
) -> Proposal:
    """The best of candidates, with how often it has to be made and how long.

    Raises:
        BadInput: none of them can be made.
    """
    best = best_of(hand, candidates, clock, lambda share: progress(0.9 * share))
    times, repeated, enough_s = 1, np.nan, float(np.ptp(best.trial.track.time_s))
    if best.expected is not None:
        times, repeated = _how_often(hand, best.trial, best.expected, best.groups)
        enough_s = _how_long(hand, best.trial, best.expected, best.groups)
    progress(1.0)
    return Proposal(**vars(best), times=times, repeated=repeated, enough_s=enough_s)


def _how_often(hand: Hand, trial: Trial, once: Expected, groups: np.ndarray) -> tuple[int, float]:
    found = once.right
    for times in TIMES:
        found = once.right if times == 1 else expected(hand, trial, groups, times).right
        if found >= WANTED:
            return times, found
    return 0, found


def _how_long(hand: Hand, trial: Trial, whole: Expected, groups: np.ndarray) -> float:
    length_s = float(np.ptp(trial.track.time_s))
    for share in PARTS:
        if expected(hand, trial.until(share), groups).right >= whole.right - AS_GOOD:
            return share * length_s
    return length_s
