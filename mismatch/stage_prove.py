"""Last stages: what calibration leaves is tested, and the best explanation is proved on held-out recordings."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

from twinbench.mismatch.explanation import Explanation, fitted_again
from twinbench.mismatch.many import MANY, completed
from twinbench.mismatch.picture import Picture
from twinbench.mismatch.proof import BorneOut, Gain, Held, Worse, borne_out, gain, held_out, worse_outputs
from twinbench.mismatch.rivals import Rivals, alternatives, losses, nearest, rivals
from twinbench.mismatch.stage_calibrate import Calibration
from twinbench.mismatch.stage_search import Search, Searched
from twinbench.mismatch.transfer import Transfer, transfer
from twinbench.mismatch.weigh import Beside, HeldBack, by_chance, contended, plainest_that_predicts, refusal

PROVED = 3
"""Times that a plainer explanation than the last is looked for."""


@dataclass(frozen=True)
class Judgement:
    """What the held-out recordings say of the best explanation; nothing is said without any."""

    share: Gain | None = None
    there: BorneOut | None = None
    transferred: Transfer | None = None
    worse: tuple[Worse, ...] = ()
    refused: str = ""


@dataclass(frozen=True)
class Proved:
    """What stands in the end; ``Diagnosis`` says what each is."""

    best: Explanation | None
    held_before: Held | None
    held_after: Held | None
    judgement: Judgement
    fitted: list[Explanation]
    shown: Picture
    compared: int
    rivals: list[Rivals] = field(default_factory=list)
    losses: dict[frozenset[str], float] = field(default_factory=dict)

    @property
    def chosen(self) -> Explanation | None:
        """The best, if it is accepted."""
        return None if self.judgement.refused else self.best


@dataclass
class _Candidate:
    """The explanation that is to be proved; it changes as others turn out to predict better, or as well and plainer."""

    best: Explanation
    shown: Picture
    fitted: list[Explanation]
    held: Held | None = None


def proved(found: Searched, calibration: Calibration, search: Search) -> Proved:
    """Choose among explanations that the fitted recordings cannot tell apart, accept or refuse, and name the rivals."""
    before, held, progress = found.before, calibration.held, search.progress
    back = HeldBack(held, calibration.own)
    held_before = held_out(before.problem, before.z, held, calibration.own, calibration.held_first) if held else None
    if found.best is None:
        return Proved(None, held_before, None, Judgement(), list(found.tried), found.shown, 0)
    at = _completed(found, search)
    compared = _weighed(at, found, held_before, back, search) if held_before is not None else 0
    judgement = _judged(at, held_before, calibration, search)
    progress("prove", 0.9)
    at.fitted += found.finalists
    if by_chance(at.best, before, found.threshold, judgement.refused, judgement.share):
        return Proved(None, held_before, None, Judgement(), at.fitted, at.shown, compared)
    at.fitted += nearest(before, at.best, at.shown, at.fitted)
    also = () if at.held is None else (Beside(at.best, at.held, back).behind,)
    others = rivals(before, at.best, at.fitted, *also)
    behind = losses(before, at.best, at.fitted, *also)
    return Proved(at.best, held_before, at.held, judgement, at.fitted, at.shown, compared, others, behind)


def _completed(found: Searched, search: Search) -> _Candidate:
    """The best with the physics besides that is likely where much is missing, and what could stand in its place."""
    best, shown, problem = found.best, found.shown, found.before.problem
    assert best is not None
    if len(best.names) >= MANY and (fuller := completed(best, shown)) is not best:
        best = fitted_again(replace(problem, offsets=best.problem.offsets), fuller)
        shown = search.pictured(best.bare, best)
    others = alternatives(
        found.before, best, shown, search.guards.pairs, lambda share: search.progress("prove", 0.3 * share)
    )
    return _Candidate(best, shown, [*found.tried, *others])


def _weighed(at: _Candidate, found: Searched, held_before: Held, back: HeldBack, search: Search) -> int:
    """The candidate weighed against all others on held-out recordings; how many were compared there."""
    before, progress, pairs = found.before, search.progress, search.guards.pairs
    at.held = back.predicted(at.best)
    chosen = contended(
        before, at.best, at.fitted, found.finalists, at.held, back, lambda share: progress("prove", 0.3 + 0.2 * share)
    )
    for turn in range(PROVED):
        progress("prove", 0.5 + 0.4 * turn / PROVED)
        if chosen is not at.best:
            at.best = fitted_again(before.problem, chosen)
            at.held = back.predicted(at.best, at.held)
            at.shown = search.pictured(replace(before.problem, offsets=at.best.problem.offsets), at.best)
            at.fitted += alternatives(before, at.best, at.shown, pairs)
        chosen = plainest_that_predicts(before, at.best, at.fitted, at.shown, held_before, at.held, back)
        if chosen is at.best:
            break
    return len(back.asked) if len(back.asked) > 1 else 0


def _judged(at: _Candidate, held_before: Held | None, calibration: Calibration, search: Search) -> Judgement:
    """Is the explanation borne out where it has learnt nothing?"""
    if held_before is None or at.held is None:
        return Judgement()
    variance = at.best.problem.whitener.variance()
    share, there = gain(held_before, at.held, variance), borne_out(held_before, at.held, variance)
    worse = worse_outputs(held_before, at.held, at.best.problem.machine.simulator.outputs)
    many = len(at.best.names) >= MANY
    transferred = transfer(at.best, at.held, calibration.held, calibration.own) if many else None
    refused = refusal(share, there, worse) if search.guards.held_out_gate else ""
    return Judgement(share, there, transferred, worse, refused)
