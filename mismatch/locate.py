"""The force at a port that would explain the recordings, whatever makes it: the discrepancy's posterior there."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from twinbench.mismatch.course import together
from twinbench.mismatch.diagnosis import Diagnosis
from twinbench.mismatch.naming.marginal import eliminated, learn
from twinbench.mismatch.naming.view import View, prior_mean
from twinbench.physics.simulator import Array, Port

FIRST_FORCE_PCT = 5.0
"""Where the search for the size of a force begins, in per cent of what is common at its port."""


@dataclass(frozen=True)
class Located:
    """A force at a port and its course.

    Attributes:
        force: per recording, times (S,) and force (S,), in the port's units, per second at a balance.
    """

    port: Port
    force: tuple[tuple[Array, Array], ...]


def locate(d: Diagnosis) -> Located | None:
    """The force at the first claim's port; None where there is none, or none can act there.

    A named effect is left out of the simulator: the force stands in its place. Something unnamed acts beside
    what is named.
    """
    if not d.claims:
        return None
    claim = d.claims[0]
    hypothesis, port = d.accepted if claim.found is None else d.answer.naming.null, claim.port
    problem, z, functions = hypothesis.problem, hypothesis.z, d.answer.naming.ground.discrepancy
    if port not in functions.ports:
        return None
    view, p = View.around(problem, z), functions.ports.index(port)
    along = [functions.functions(course) for course in view.courses]
    columns = [
        np.concatenate((own, course.columns(together([functions.acts(course, p, f)]))), axis=2)
        for own, course, f in zip(view.unknowns(), view.courses, along, strict=True)
    ]
    n, many = len(z), columns[0].shape[2]
    G, b, _ = d.answer.naming.ground.products(view, columns).over()
    inner = eliminated(G[:many, :many], b[:many], np.arange(n), prior_mean(view), np.ones(n))
    learnt = learn(inner.G, inner.b, np.zeros(many - n, dtype=int), np.array([FIRST_FORCE_PCT]), free=0)
    force = tuple(
        (course.grid.time_s, functions.units[p] * (f @ learnt.weights))
        for course, f in zip(view.courses, along, strict=True)
    )
    return Located(port, force)
