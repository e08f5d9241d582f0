"""What anybody could tell of a fleet who knew truth's own equations and the noise.

The observer sees what an engine may learn from. Parameters, starts, ambient and ripple of each machine are unknown to
it, as those of ``concealed.observer`` are, and so is the size of every effect on every machine. It knows the shared
effect by its name when it looks for machines that have more. Distances are in sds of the noise: to first order, and by
a fit of all that is unknown from the nearest names.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from twinbench.physics.simulator import Array
from twinbench.proof.concealed.changes import change_of
from twinbench.proof.concealed.columns import Picture, picture
from twinbench.proof.concealed.observer import FITTED, SEEN_SQ, TOLD_SQ, without
from twinbench.proof.concealed.on_twin import OnTwin
from twinbench.proof.concealed.refit import refitted
from twinbench.proof.fleets.drawn import BACKGROUND_PCT, Drawn


class Observed(NamedTuple):
    """What the observer makes of a fleet.

    Attributes:
        shared_sq: squared distance of all machines together from none with the shared effect.
        told_sq: likewise from the nearest other name that is not of its class.
        same: the shared effect's class: catalogue names that nobody can tell from it on all machines together.
        odd_sq: of each odd machine, squared distance of its own effect from nothing beside the shared one.
    """

    shared_sq: float
    told_sq: float
    same: tuple[str, ...]
    odd_sq: dict[str, float]

    @property
    def names(self) -> bool:
        """Does it name the shared effect, or its class?"""
        return self.shared_sq >= SEEN_SQ and self.told_sq >= TOLD_SQ

    @property
    def found(self) -> tuple[str, ...]:
        """Odd machines that it finds."""
        return tuple(name for name, sq in self.odd_sq.items() if sq >= SEEN_SQ)


def observed(drawn: Drawn) -> Observed:
    """Of a fleet as it was drawn."""
    odd_sq, shared_sq = {}, 0.0
    apart: dict[str, float] = {}
    for name, one in drawn.machines.items():
        seen = picture(OnTwin(one.yardstick, -np.inf), one.sizes, BACKGROUND_PCT)
        places = {effect: seen.names.index(effect) for effect in one.sizes}
        if name in drawn.odd:
            odd_sq[name] = float(without(seen.gram, [places[drawn.shared]])[(places[drawn.own],) * 2])
        beside = [place for effect, place in places.items() if effect != drawn.shared]
        here = _apart(seen, without(seen.gram, beside), places[drawn.shared])
        shared_sq += here.pop(drawn.shared)
        for other, sq in here.items():
            apart[other] = apart.get(other, 0.0) + sq
    apart |= _fitted_anew(drawn, sorted(apart, key=lambda name: apart[name])[:FITTED])
    same = tuple(sorted(name for name, sq in apart.items() if sq < TOLD_SQ))
    told_sq = min((sq for sq in apart.values() if sq >= TOLD_SQ), default=np.inf)
    return Observed(shared_sq, min(told_sq, shared_sq), (drawn.shared, *same), odd_sq)


def _apart(seen: Picture, gram: Array, own: int) -> dict[str, float]:
    """Squared distance of one effect from each other name of the catalogue, of its own from none."""
    norms = np.diag(gram)
    along = gram[own] / np.sqrt(np.maximum(norms * norms[own], np.finfo(float).tiny))
    left = norms[own] * (1.0 - np.where(seen.two_sided | (along > 0.0), along**2, 0.0))
    found: dict[str, float] = {}
    for name, sq, foreign in zip(seen.names, left, seen.foreign, strict=True):
        if not foreign:
            found[name] = min(found.get(name, np.inf), float(sq))
    return {**found, seen.names[own]: float(norms[own])}


def _fitted_anew(drawn: Drawn, names: list[str]) -> dict[str, float]:
    """Squared distance of the shared effect from each of these, all machines together, all that is unknown fitted."""
    found: dict[str, float] = {}
    for one in drawn.machines.values():
        run = OnTwin(one.yardstick, -np.inf)
        change = {}
        for effect, size in one.sizes.items():
            made = change_of(one.yardstick, one.yardstick.machine.effect(effect)).of(size)
            change[effect] = {i: made[i] - one.yardstick.base[i] for i in run.tracks}
        beside = [change[effect] for effect in one.sizes if effect != drawn.shared]
        for name, sq in refitted(run, change[drawn.shared], beside, BACKGROUND_PCT, names).items():
            found[name] = found.get(name, 0.0) + sq
    return found
