"""Explanations weighed by recordings that were held back: which predicts best, which does with least, which will do.

Training residuals cannot tell a false name from a right one. Of explanations that are tied there, the held-out
recordings choose; what they say of the chosen one is by so much the kinder.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from twinbench.mismatch.explanation import Explanation, refit
from twinbench.mismatch.fit import Unknown
from twinbench.mismatch.many import MANY, each_of_many
from twinbench.mismatch.picture import Picture
from twinbench.mismatch.proof import NO_DIFFERENCE, BorneOut, Gain, Held, Worse, clearly_worse, held_out, lost
from twinbench.mismatch.rivals import NEAR_UNITS, fresh_rounds, slack
from twinbench.mismatch.search import EFFECT_PENALTY
from twinbench.mismatch.tracks import Track

FORM_MISS, PLAINER = 0.05, 4
"""Share of what is gained, and of the removable held-out error, that a form may miss of it, being inexact; so many
plainer explanations within that are weighed."""
HELD_AGAINST_LIKELY, HELD_AGAINST_MOST = 6, 100.0
"""Explanations of each number of effects that are held against the best on held-out recordings; of many effects so
many in all, if they are no more units behind it."""
LEAST_SHARE, LEAST_LOW, LEAST_EXCESS = 0.75, 0.5, 0.025
"""Share of the removable held-out error that an explanation must remove, the lower end of its interval, and the
error, in noise variances, that there must be."""
LEAST_RATIO, PLAIN_GAIN = 0.75, 200.0
"""Share of what it adds to the outputs that must be in held-out readings, as the lower end of an interval, to accept
it whatever else is there, and no more than its inverse; and units by which their error must fall."""
UNSURE, MOST_DOUBT = 0.015, 0.25
"""By so much of itself the noise's variance is not known; of a small error that is a good share, up to so much."""


class HeldBack:
    """The recordings that were held back, and which explanations were asked to predict them.

    Attributes:
        tracks: the recordings, whose ``own`` unknowns are found anew.
        asked: the names of the explanations that were.
    """

    def __init__(self, tracks: Sequence[Track], own: Sequence[Unknown]) -> None:
        self.tracks, self.own = tracks, own
        self.asked: set[frozenset[str]] = set()

    def predicted(self, e: Explanation, near: Held | None = None) -> Held:
        """How an explanation does there."""
        self.asked.add(frozenset(e.names))
        return held_out(e.problem, e.z, self.tracks, self.own, near)


def contended(
    before: Explanation,
    best: Explanation,
    fitted: Sequence[Explanation],
    finalists: Sequence[Explanation],
    held_best: Held,
    back: HeldBack,
    advance: Callable[[float], None] = lambda share: None,
) -> Explanation:
    """Of explanations that the fitted recordings do not tell apart for sure, the one that predicts best.

    What was fitted and what was held out count alike: a name that is a little better on the one and far off on the
    other is wrong. Those of gross errors only the held-out recordings weigh.
    """
    beside = Beside(best, held_best, back)
    # Of many effects several sets predict alike, but for how far the forms of drifts suit each.
    many = len(best.names) >= MANY
    each = min(each_of_many(best), EFFECT_PENALTY) if many else EFFECT_PENALTY
    most = min(before.cost, best.score(each) + HELD_AGAINST_MOST) if many else before.cost
    ranked = sorted((e for e in fitted if e.names and e.score(each) < most), key=lambda e: e.score(each))
    sizes: dict[int, dict[tuple[str, ...], Explanation]] = {}
    for e in ranked:
        sizes.setdefault(len(e.names), {}).setdefault(e.names, e)
    likely = [e for same in sizes.values() for e in list(same.values())[:HELD_AGAINST_LIKELY]]
    likely = sorted(likely, key=lambda e: e.score(each))[:HELD_AGAINST_LIKELY] if many else likely
    total = {}
    for place, e in enumerate(likely):
        advance(place / (len(likely) + len(finalists)))
        total[e.names] = e.score(each) + beside.behind(e), e
    least, first = min(total.values(), key=lambda t: t[0], default=(np.inf, best))
    variance = best.problem.whitener.variance()
    better = least < best.score(each) - (slack(before.cost - best.cost) if many else NEAR_UNITS)
    if better and (not many or clearly_worse(held_best, beside.held(first), variance)):
        best, held_best = first, beside.held(first)
    for place, e in enumerate(finalists):
        advance((len(likely) + place) / (len(likely) + len(finalists)))
        if clearly_worse(held_best, found := back.predicted(e, held_best), variance):
            best, held_best = e, found
    return best


def plainest_that_predicts(
    before: Explanation,
    best: Explanation,
    fitted: Sequence[Explanation],
    shown: Picture,
    held_before: Held,
    held_best: Held,
    back: HeldBack,
) -> Explanation:
    """The plainest explanation that predicts the held-out recordings no worse than the best.

    Effects that do little for held-out recordings go, and several that a plainer explanation, which fits nearly as
    well, replaces: no form is exact, and what a form lacks is soon made up by others. Together they may do no more
    than that.

    Args:
        fitted: other explanations.
        shown: a picture around the best.
        held_before: errors of the calibrated model on the held-out recordings.
        held_best: errors of the best there.
    """
    variance = best.problem.whitener.variance()

    def missed(found: Held) -> float:
        return lost(found, held_best, held_before, variance)

    thinner = _without_idle(best, shown, held_best, back, missed)
    if thinner is None or len(thinner[0].names) >= MANY:
        return best
    now, held_now = thinner
    nearly = now.cost + FORM_MISS * (before.cost - now.cost)
    plainer = [e for e in fitted if 0 < len(e.names) < len(now.names) and e.cost < nearly]
    for e in sorted(plainer, key=lambda e: (len(e.names), e.cost))[:PLAINER]:
        if missed(back.predicted(e, held_now)) < FORM_MISS:
            return e
    # Of as many effects the set that fits best, unless it predicts less.
    fits = min((e for e in fitted if len(e.names) == len(now.names)), key=lambda e: e.cost, default=now)
    if fits.cost < now.cost and lost(back.predicted(fits, held_now), held_now, held_before, variance) < NO_DIFFERENCE:
        return fits
    return now


def _without_idle(
    best: Explanation, shown: Picture, held_best: Held, back: HeldBack, missed: Callable[[Held], float]
) -> tuple[Explanation, Held] | None:
    """The best without effects that do little for held-out recordings; None where nothing plain will do.

    Args:
        missed: share of what the best removes of the held-out error that other errors there lack.
    """
    now, held_now, chosen = best, held_best, list(range(len(best.chosen)))

    def subset(chosen: Sequence[int]) -> tuple[Explanation, Held]:
        e = refit(best.bare, best.z[: best.first], shown, chosen, fresh_rounds(best))
        return e, back.predicted(e, held_now)

    while len(chosen) > 1:
        without: dict[int, tuple[Explanation, Held]] = {}
        missing: dict[int, float] = {}
        for i in sorted(chosen, key=lambda i: shown.gain([j for j in chosen if j != i])):
            without[i] = subset([j for j in chosen if j != i])
            missing[i] = missed(without[i][1])
            if sum(m > NO_DIFFERENCE for m in missing.values()) >= MANY:
                # Where nothing plain will do, what is small is not what the form of something large lacks.
                return None
        idle = [i for i in chosen if missing[i] < FORM_MISS]
        if not idle:
            break
        rest = [i for i in chosen if i not in idle]
        together = subset(rest) if rest and len(idle) > 1 else None
        if together is None or missed(together[1]) > FORM_MISS:
            least = min(idle, key=lambda i: missing[i])
            rest, together = [i for i in chosen if i != least], without[least]
        chosen, (now, held_now) = rest, together
    return now, held_now


class Beside:
    """Explanations beside the best on the held-out recordings, under its noise; each is fitted there once."""

    def __init__(self, best: Explanation, held_best: Held, back: HeldBack) -> None:
        self.whitener, self.best, self.back = best.problem.whitener, held_best, back
        self.known: dict[int, Held] = {}

    def held(self, e: Explanation) -> Held:
        """Its errors there."""
        if id(e) not in self.known:
            self.known[id(e)] = self.back.predicted(e, self.best)
        return self.known[id(e)]

    def behind(self, e: Explanation) -> float:
        """Units that it lies behind the best."""
        return self._units(self.held(e)) - self._units(self.best)

    def _units(self, found: Held) -> float:
        return float(sum(np.nansum(self.whitener(r) ** 2) for r in found.residuals))


def by_chance(
    best: Explanation, before: Explanation, threshold: float, refused: str = "", share: Gain | None = None
) -> bool:
    """Could noise alone gain as much? Twice as much, if the held-out recordings refuse it; whatever it gains, if they
    show nothing to explain."""
    gained = (before.cost - best.cost) / len(best.names)
    nothing = bool(refused) and share is not None and share.excess < LEAST_EXCESS
    return nothing or gained < threshold * (2.0 if refused else 1.0)


def refusal(share: Gain | None, there: BorneOut | None, worse: Sequence[Worse] = ()) -> str:
    """Why the best explanation is not accepted; empty if it is.

    Args:
        worse: held-out outputs that it spoils, whatever it does for the others.
    """
    if worse:
        spoilt = "; ".join(f"{w.channel} from {w.before:.3g} to {w.after:.3g}" for w in worse)
        return f"on held-out recordings errors grow by more than chance: {spoilt}"
    if share is None or there is None or is_there(there):
        return ""
    if share.excess < LEAST_EXCESS:
        return f"held-out errors of the calibrated model exceed the noise by {100 * max(share.excess, 0.0):.2g} % only"
    doubt = min(UNSURE / max(share.excess, UNSURE), MOST_DOUBT)
    if share.share < LEAST_SHARE - doubt or share.low < LEAST_LOW - doubt:
        return f"on held-out recordings it removes {share.says}"
    return ""


def is_there(there: BorneOut) -> bool:
    """Do the held-out recordings plainly show what the explanation adds, and as much of it?"""
    return there.units > PLAIN_GAIN and there.low > LEAST_RATIO and there.ratio < 1.0 / LEAST_RATIO
