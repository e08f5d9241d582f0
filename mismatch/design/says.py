"""A proposal in words."""

from __future__ import annotations

from collections.abc import Iterator

from twinbench.mismatch.design.choice import TIMES, Proposal
from twinbench.mismatch.design.precision import gained
from twinbench.mismatch.design.request import Designed
from twinbench.mismatch.words import count, counted, listed, number, probable, sentence, with_unit


def headline(d: Designed) -> str:
    """What to do, in one sentence."""
    trial = d.proposal.trial
    every = d.limits.sampling_s
    lasts = float(trial.candidate.time_s[-1] + every)
    how = f"{trial.candidate.says}, for {with_unit(lasts, 's')} with a sample every {with_unit(every, 's')}"
    if d.proposal.expected is None:
        return sentence(f"nothing is contested, so make the experiment that tells most of the parameters: {how}")
    return sentence(f"to tell {listed(d.hand.names)} apart, make {how}")


def points(d: Designed) -> Iterator[str]:
    """What it promises, one thing a point."""
    p = d.proposal
    if p.expected is None:
        yield _precision(d)
    else:
        yield from _alike(d)
        yield from _promises(p)
        if p.enough_s < float(p.trial.track.time_s[-1] - p.trial.track.time_s[0]):
            yield sentence(f"its first {with_unit(p.enough_s, 's')} promise as much")
        yield from _again(d)
    made = len(p.worth)
    left_out = f"; {counted(p.left_out, 'other')} would leave the outputs' bounds" if p.left_out else ""
    yield sentence(f"it is the best of {counted(made, 'experiment')} within the limits{left_out}")


def _alike(d: Designed) -> Iterator[str]:
    """Rivals that no experiment tells apart, where others are told from them."""
    groups = d.proposal.groups.tolist()
    for g in sorted(set(groups)) if len(set(groups)) > 1 else ():
        names = [name for name, own in zip(d.hand.names, groups, strict=True) if own == g]
        if len(names) > 1:
            yield sentence(f"no experiment within these limits tells {listed(names)} apart, so they count as one")


def _promises(p: Proposal) -> Iterator[str]:
    assert p.expected is not None
    added = number(max(float(p.worth[0]), 0.0), 2)
    if p.scattered and not p.times:
        yield sentence(
            f"no experiment within these limits settles it: the best adds {added} nats for the closest pair, and "
            "chance moves them further than that"
        )
    once = f"made once, it leaves the right name alone with probability {probable(p.expected.right)}"
    yield sentence(f"{once}, and a wrong one with probability {probable(p.expected.wrong)}")
    if p.times > 1:
        yield sentence(f"make it {count(p.times)} times: the probability is then {probable(p.repeated)}")
    elif p.times == 0:
        most = count(TIMES[-1])
        yield sentence(f"even made {most} times it would do so with probability {probable(p.repeated)} only")


def _again(d: Designed) -> Iterator[str]:
    if not d.old:
        return
    best = d.old[0]
    yield sentence(f"with {best.says} made again the probability would be {probable(best.expected.right)}")
    if best.added:
        one = best.added[0]
        yield sentence(
            f"with these inputs and a sensor of {one.state} added it would be {probable(one.expected.right)}"
        )


def left_over(d: Designed) -> list[tuple[str, float]]:
    """Each parameter of the first rival, and the share of its standard deviation that the experiment leaves."""
    names = [u.name for u in d.hand.rivals[0].problem.unknowns if u.recording == -1]
    left = gained(d.hand, d.proposal.trial).shares
    return [(name, float(share)) for name, share in zip(names, left, strict=True)]


def _precision(d: Designed) -> str:
    each = listed([f"{name} {number(100.0 * share, 2)} %" for name, share in left_over(d)])
    return sentence(f"of the parameters' standard deviations it leaves: {each}")
