"""From what a user asks to a proposal: everything read and checked first, then the engine."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from twinbench.data.recording import Recording
from twinbench.mismatch.asked import Asked, Progress, silent
from twinbench.mismatch.design.added import Added, sensors
from twinbench.mismatch.design.candidates import Candidate, drawn, of_recordings, usual
from twinbench.mismatch.design.choice import Proposal, hand_of, proposed
from twinbench.mismatch.design.clock import Clock, clock_of
from twinbench.mismatch.design.found import Found, read_found, rivals_of
from twinbench.mismatch.design.gather import by_recordings, only
from twinbench.mismatch.design.hand import Hand, weighed_as
from twinbench.mismatch.design.limits import Limits, check_run, read_limits
from twinbench.mismatch.design.separation import Expected, expected
from twinbench.mismatch.design.trials import tried
from twinbench.mismatch.design.unseen import without_recordings
from twinbench.mismatch.joining import HELD, LINEAR
from twinbench.mismatch.model import Model, load_catalogue, load_model, whole_catalogue
from twinbench.mismatch.naming.ground import Ground
from twinbench.mismatch.naming.settle import Settled
from twinbench.mismatch.recordings import read_recordings
from twinbench.mismatch.told import read_told
from twinbench.physics.simulator import Simulator


@dataclass(frozen=True)
class DesignRequest:
    """What a user wants designed, as given.

    Attributes:
        spec: the simulator, as ``load_simulator`` takes it.
        rivals: names of effects; those that the verdict contests if left out.
        limits: the file of limits.
        verdict: the file of an earlier verdict, or None.
        catalogue: the file of a user's own mechanisms, or nothing.
        trust: run the Python that a ``model.toml`` names wherever it lies.
    """

    spec: str
    rivals: Sequence[str]
    limits: Path
    verdict: Path | None = None
    catalogue: str = ""
    trust: bool = False


class Again(NamedTuple):
    """What an old recording promises if its inputs are made again, and with which sensor added."""

    says: str
    expected: Expected
    added: tuple[Added, ...]


class Designed(NamedTuple):
    """A proposal with all that it rests on.

    Attributes:
        beside: names of what is there besides the rivals.
        old: what the recordings at hand promise if their inputs are made again, the best first.
    """

    proposal: Proposal
    hand: Hand
    clock: Clock
    limits: Limits
    beside: tuple[str, ...]
    old: tuple[Again, ...]


def design(asked: DesignRequest, progress: Progress = silent) -> Designed:
    """The experiment to make next.

    Raises:
        BadInput: the simulator, the limits, the verdict or a recording cannot be used.
    """
    given = load_model(asked.spec, asked.trust)
    limits = read_limits(asked.limits, given.simulator)
    candidates = candidates_of(limits, given.simulator)
    if asked.verdict is None:
        basis = _without(asked, given, limits, candidates)
    else:
        basis = _by_recordings(asked, given, limits, read_found(asked.verdict), progress)
    tracks = basis.rivals[0].problem.tracks
    if tracks and not limits.runs:
        candidates = drawn(given.simulator, limits, usual(tracks))
    weighed = all(name in basis.weights for name in basis.names)
    likely = [basis.weights[n] if weighed else h.log for n, h in zip(basis.names, basis.rivals, strict=True)]
    order = np.argsort(-np.array(likely), kind="stable")
    settled, names = [basis.rivals[i] for i in order], [basis.names[i] for i in order]
    hand = weighed_as(hand_of(settled, names, basis.ground, candidates, basis.clock), basis.weights)
    best = proposed(hand, candidates, basis.clock, lambda share: progress("design", share))
    old = tuple(_again(hand, basis, best.groups)) if len(settled) > 1 else ()
    return Designed(best, hand, basis.clock, limits, basis.beside, old)


def _again(hand: Hand, basis: _Basis, groups: np.ndarray) -> Iterator[Again]:
    """What the recordings at hand promise if their inputs are made again, the best one with added sensors too.

    Args:
        groups: (m,) dimensionless labels of rivals, as ``expected`` takes them.
    """
    made = []
    for one, clock in zip(of_recordings(basis.recordings, _simulator(hand)), basis.clocks, strict=True):
        trial = tried(one, hand, clock)
        if trial is not None:
            made.append((expected(hand, trial, groups), one, clock))
    made.sort(key=lambda of: -of[0].right)
    for k, (promised, one, clock) in enumerate(made):
        yield Again(one.says, promised, tuple(sensors(one, hand, clock, groups)) if not k else ())


def _simulator(hand: Hand) -> Simulator:
    return hand.rivals[0].problem.machine.simulator


def candidates_of(limits: Limits, simulator: Simulator) -> list[Candidate]:
    """Those that limits allow: the user's own, or drawn ones.

    Raises:
        BadInput: a run of the user's cannot be read, or leaves the limits.
    """
    if not limits.runs:
        return drawn(simulator, limits)
    listed = of_recordings(read_recordings(limits.runs, simulator), simulator)
    for one in listed:
        check_run(limits, one.says, one.u, simulator)
    return listed


class _Basis(NamedTuple):
    """What a design rests on: rivals with their names, what is there besides, the noise, and recordings with clocks."""

    rivals: list[Settled]
    names: list[str]
    beside: tuple[str, ...]
    weights: Mapping[str, float]
    ground: Ground
    clock: Clock
    recordings: list[Recording]
    clocks: list[Clock]


def _by_recordings(asked: DesignRequest, given: Model, limits: Limits, found: Found, progress: Progress) -> _Basis:
    simulator, settings = given.simulator, found.settings
    (names, beside), catalogue = rivals_of(asked.rivals, found), asked.catalogue or settings["catalogue"]
    own = load_catalogue(catalogue, simulator) if catalogue else ()
    recordings = read_recordings([*found.recordings, *found.hold_out], simulator, settings["map"])
    learnt, held = recordings[: len(found.recordings)], recordings[len(found.recordings) :]
    period_s = float(np.median(np.concatenate([np.diff(r.time_s) for r in learnt])))
    listed = only(whole_catalogue(simulator, own, period_s), [*names, *beside])
    prior = [odds for odds in settings["prior"] if odds.rpartition("=")[0] in names]
    told = read_told((), prior, settings["measured"], simulator)
    engine = Asked(simulator, learnt, held, listed, given.faults, LINEAR if found.linear else HELD, told)
    rivals, ground, seen = by_recordings(
        engine, [(*beside, name) for name in names] or [beside], found.since_s, progress
    )
    clock, *clocks = (
        clock_of(seen.tracks, ground.noise, sampling_s, found.linear)
        for sampling_s in (limits.sampling_s, *(float(np.median(np.diff(r.time_s))) for r in learnt))
    )
    return _Basis(rivals, list(names) or [""], beside, found.weights, ground, clock, learnt, clocks)


def _without(asked: DesignRequest, given: Model, limits: Limits, candidates: Sequence[Candidate]) -> _Basis:
    own = load_catalogue(asked.catalogue, given.simulator) if asked.catalogue else ()
    names = tuple(dict.fromkeys(asked.rivals))
    listed = only(whole_catalogue(given.simulator, own, limits.sampling_s), names)
    linear = given.inputs == LINEAR
    rivals, ground, clock = without_recordings(given.simulator, given.faults, listed, limits, candidates, linear)
    return _Basis(rivals, list(names) or [""], (), {}, ground, clock, [], [])
