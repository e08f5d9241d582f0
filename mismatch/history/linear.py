"""What the readings tell of an effect's size over time: columns of its knots, and all else integrated out."""

from __future__ import annotations

import numpy as np

from twinbench.mismatch.fit import parallel
from twinbench.mismatch.history.axis import Axis
from twinbench.mismatch.history.patterns import WALKS, Told, walk
from twinbench.mismatch.naming.bounded import Bounds
from twinbench.mismatch.naming.ground import Ground
from twinbench.mismatch.naming.marginal import DISCREPANCY_PCT, Reduced, eliminated
from twinbench.mismatch.naming.settle import Settled, columns_of
from twinbench.mismatch.naming.view import WANDERS, View
from twinbench.physics.simulator import Array


def told_of(chosen: Settled, place: int, ground: Ground, view: View, axis: Axis, floor: Array) -> list[Told]:
    """What the readings tell beside the discrepancy of a constant size, and beside that of one that wanders.

    Args:
        place: of the effect in the hypothesis.
        view: around where the hypothesis stands.
        floor: (ny,) noise of block means by their second differences, in the outputs' units.
    """
    size, wanders = int(chosen.entries(place)[0]), np.arange(len(chosen.z), len(chosen.mean))
    own, knots = columns_of(view, ground, chosen.wanders), knot_columns(view, chosen, size, axis)
    for columns in own:
        columns[:, :, wanders] *= chosen.share / WANDERS
    low, high = Bounds.of(chosen.problem).around(chosen.z)
    held = {*np.flatnonzero((low >= 0.0) | (high <= 0.0))} - {size}
    rest = [k for k in range(len(chosen.mean)) if k != size and k not in held]
    # The size comes last of what is unknown, so that the walk stands behind it.
    every, mean = [c[:, :, [*rest, size]] for c in own], chosen.mean[[*rest, size]]
    wandering = walk(axis, WALKS[-1] * size_of(chosen, place))
    beside = [np.concatenate((c, k @ wandering), axis=2) for c, k in zip(every, knots, strict=True)]
    mean_beside = np.concatenate((mean, np.zeros(wandering.shape[1])))
    ground = ground.relearnt(view, beside, mean_beside, floor)
    G, b, _ = ground.products(view, [np.concatenate(pair, axis=2) for pair in zip(every, knots, strict=True)]).over()
    inner = eliminated(G, b, np.arange(len(rest)), mean[:-1], np.ones(len(rest)))
    return [_beside(inner, s, float(mean[-1]), ground) for s in (chosen.learnt.s, ground.s)]


def _beside(inner: Reduced, s: Array, mean: float, ground: Ground) -> Told:
    """What is left beside a discrepancy of some sizes (P,), per cent."""
    block = np.arange(len(inner.b) - len(ground.group), len(inner.b))
    if not len(block):
        return Told(*inner, mean)
    left = eliminated(inner.G, inner.b, block, np.zeros(len(block)), ground.precision(s))
    prior = -0.5 * float(np.sum((s / DISCREPANCY_PCT) ** 2))
    return Told(left.G, left.b, inner.log + left.log + prior, mean)


def size_of(chosen: Settled, place: int) -> float:
    """How large an effect is, in prior sds of its size."""
    return abs(float(chosen.sizes[place])) / chosen.problem.unknowns[int(chosen.entries(place)[0])].spread


def knot_columns(view: View, chosen: Settled, size: int, axis: Axis) -> list[Array]:
    """Columns of what is added to a size at each knot, (B, ny, Q) per recording, in the outputs' units per prior sd.

    Args:
        size: its position among the unknowns.
    """
    problem = view.problem
    u = problem.unknowns[size]
    candidate = next(c for c in problem.machine.candidates if u.at in c.at)

    def of(r: int) -> Array:
        course, step = view.courses[r], u.nudge(view.z[size])
        theta = course.setting.theta.copy()
        theta[u.at] += step
        if candidate.acts_on_output:
            column = course.of_sensor(theta, (-np.inf,))[:, :, 0] / step
            return column[:, :, None] * axis.hats(r, problem.tracks[r].block_time_s)[:, None, :] * u.spread
        one = course.of_input(theta, step) if candidate.acts_on_input else course.of_present(theta, step)
        hats = axis.hats(r, course.grid.time_s)
        return course.through_sensors(course.columns(one.times(hats))) * u.spread

    return parallel([lambda r=r: of(r) for r in range(len(view.courses))])
