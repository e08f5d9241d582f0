"""Rivals brought to their fixed points on recordings, or as the simulator has them where there are no recordings."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from twinbench.common.errors import BadInput
from twinbench.common.shown import shown as quoted
from twinbench.mismatch.asked import Asked, Progress, forward, silent
from twinbench.mismatch.fit import Problem
from twinbench.mismatch.machine import Machine
from twinbench.mismatch.naming.discrepancy import discrepancy
from twinbench.mismatch.naming.ground import Ground
from twinbench.mismatch.naming.name import FAR_OFF, begun, common
from twinbench.mismatch.naming.picture import Painter, Picture
from twinbench.mismatch.naming.settle import Settled, settled
from twinbench.mismatch.naming.view import View
from twinbench.mismatch.stage_audit import Audited, audited
from twinbench.mismatch.stage_calibrate import calibration
from twinbench.mismatch.told import nearest
from twinbench.mismatch.variants import variants
from twinbench.mismatch.visited import moved, resized
from twinbench.physics.simulator import Array, Mechanism


class Gathered(NamedTuple):
    """Rivals at their fixed points, the noise and the discrepancy that all of them share, and what was seen."""

    rivals: list[Settled]
    ground: Ground
    seen: Audited


def only(catalogue: Sequence[Mechanism], names: Sequence[str]) -> tuple[Mechanism, ...]:
    """Mechanisms of these names.

    Raises:
        BadInput: the catalogue has none of a name.
    """
    known = {m.name: m for m in catalogue}
    for name in names:
        if name not in known:
            raise BadInput(f"rival {quoted(name)} is not in the catalogue{nearest(name, list(known))}")
    return tuple(known[name] for name in dict.fromkeys(names))


def by_recordings(
    asked: Asked, sets: Sequence[Sequence[str]], since_s: float = -np.inf, progress: Progress = silent
) -> Gathered:
    """Calibrate, learn noise and discrepancy, and bring each set of effects to its own fixed point.

    Args:
        asked: whose catalogue holds the effects of all sets and nothing else.
        sets: names of the effects that each rival is made of; none for the simulator as it is.
        since_s: from when they are there, on the recordings' clock.

    Raises:
        BadInput: recordings too short, a simulator that diverges, or an effect that has no size to be fitted.
    """
    progress = forward(progress)
    seen = audited(asked, progress)
    check_fitted(seen.machine, sets)
    fit = calibration(seen, progress)
    machine, problem = seen.machine, fit.problem
    # What needs a reversal that nobody has seen is offered all the same: the experiment may bring one.
    sized = {c.name: c for c in resized(machine.candidates, problem, fit.z, seen.period_s)}
    machine.candidates = [sized.get(c.name, c) for c in machine.candidates]
    progress("calibrate", 1.0)
    view = View.around(problem, fit.z)
    there = common(view, moved(problem, fit.z))
    ground = Ground.learnt(view, discrepancy(view.courses, there), seen.floor)
    painter = Painter(view, ground, variants(machine.candidates))
    late = since_s > -np.inf
    picture = painter.picture([since_s] if late else (), range(len(painter.listed)) if late else ())
    rivals = []
    for k, names in enumerate(sets):
        progress("screen", k / len(sets))
        rivals.append(_settled(problem, fit.z, painter, picture, names, since_s))
    progress("screen", 1.0)
    return Gathered(rivals, ground, seen)


def check_fitted(machine: Machine, sets: Sequence[Sequence[str]]) -> None:
    """Refuse effects that no fit can find the size of.

    Raises:
        BadInput: one of them is none of the machine's candidates.
    """
    known = {c.name for c in machine.candidates}
    for name in (name for names in sets for name in names):
        if name not in known:
            raise BadInput(
                f"rival {quoted(name)} has no size that a fit could find: it is a parameter that calibration moves "
                "anyway, or is told by itself; leave it out"
            )


def _settled(
    problem: Problem, z: Array, painter: Painter, picture: Picture, names: Sequence[str], since_s: float
) -> Settled:
    """A set in the forms that the picture says most of, at its own fixed point."""
    key: tuple[int, ...] = ()
    for name in names:
        forms = [i for i, n in enumerate(picture.names) if n == name and picture.since[i] == since_s]
        key = max(((*key, i) for i in forms), key=lambda k: picture.sets.score(k).log)
    s = picture.sets.score(key).learnt.s
    if not names:
        return settled(problem, z, (), painter.ground, s)
    there, sizes = painter.start(picture, key, s)
    since = begun(problem, since_s) if since_s > -np.inf else problem
    return settled(since, there, picture.effects(key, sizes), painter.ground, s, picture.excess > FAR_OFF)
