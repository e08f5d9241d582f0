"""What the catalogue offers and no truth is drawn for: its own forms, run on the twin at the truth's constants.

Whoever names an effect may name any of these instead, so the ideal observer has to tell the effect from them too.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from twinbench.mismatch.naming.answer import PERIODIC
from twinbench.mismatch.periods import loudest_periods_s
from twinbench.mismatch.variants import Variant, switched, typical, variants
from twinbench.physics.simulator import Array
from twinbench.proof.concealed.on_twin import OnTwin

PROBED = 0.5
"""Severity near which a candidate's column is taken: that of what it may stand for."""
PROBED_FACTOR = 30.0
"""A form's size is changed by this factor at most, up or down, to come near that severity."""


class Form(NamedTuple):
    """A name of the catalogue with one trial shape.

    Attributes:
        columns: (ny, N) per take, changes of its readings in the channels' units; zero where it is held out.
        severity: of that change, in training.
    """

    name: str
    columns: tuple[Array, ...]
    severity: float


def forms(run: OnTwin, covered: Collection[str], changes: Sequence[Mapping[int, Array]] = ()) -> list[Form]:
    """The forms of a machine's catalogue but for those names that have a truth or a fault of their own.

    Args:
        covered: names that are looked at by truth's own equations.
        changes: what periodic forces of the case do to the readings of each take that may be learnt from, (N, ny), in
            the channels' units: others of their period are looked at too.
    """
    names = [c.name for c in run.twin.candidates]
    tried = [v for v in variants(run.twin.candidates) if names[v.candidate] not in covered]
    tried += [v for change in changes for v in in_step(run, loudest_s(run, change)[1])]
    found = [(names[v.candidate], *_probed(run, v)) for v in tried]
    return [Form(name, columns, severity) for name, columns, severity in found if severity > 0.0]


def loudest_s(run: OnTwin, change: Mapping[int, Array]) -> tuple[float, float, float]:
    """Period at which a change of the readings is loudest, between the least and the greatest that it may be, s.

    Args:
        change: of each take that may be learnt from, (N, ny), in the channels' units.
    """
    tracks, sigma = list(run.tracks.values()), run.yardstick.machine.sigma()
    white = [
        np.add.reduceat(c, t.starts) / t.coarse.samples[:, None] / sigma
        for t, c in zip(tracks, change.values(), strict=True)
    ]
    return loudest_periods_s(tracks, white, max(float(np.ptp(t.time_s)) for t in tracks))


def in_step(run: OnTwin, period_s: float) -> list[Variant]:
    """Periodic forces of one period anywhere, in each quarter of it.

    Their sizes have no sign, so two phases would leave half of all forces without a rival next door.
    """
    places = [i for i, c in enumerate(run.twin.candidates) if c.name.startswith(PERIODIC)]
    quarters = (-0.5 * math.pi, 0.0, 0.5 * math.pi, math.pi)
    return [Variant(i, (period_s, phase)) for i in places for phase in quarters]


def _probed(run: OnTwin, variant: Variant) -> tuple[tuple[Array, ...], float]:
    """A form's columns and severity; severity 0 where it does nothing, or where the twin cannot run with it."""
    size, shortest = (
        typical(run.twin.candidates[variant.candidate]),
        min(run.tracks, key=lambda i: len(run.tracks[i].y)),
    )
    columns, severity = _at(run, variant, size, [shortest])
    if severity == 0.0:
        return columns, severity
    size *= np.clip(PROBED / severity, 1.0 / PROBED_FACTOR, PROBED_FACTOR)
    return _at(run, variant, size, list(run.tracks))


def _at(run: OnTwin, variant: Variant, size: float, takes: Sequence[int]) -> tuple[tuple[Array, ...], float]:
    candidate, base = run.twin.candidates[variant.candidate], run.yardstick.base
    first, null = candidate.mechanism.parameters[0], candidate.null[0]
    size = float(np.clip(null + size, first.low, first.high) - null)
    theta = switched(run.twin, run.twin.theta, variant, size)
    columns = [np.zeros(y.T.shape) for y in base]
    for i in takes:
        columns[i] = (run.readings(run.tracks[i], theta) - run.tracks[i].y).T
    if not all(np.isfinite(column).all() for column in columns):
        return tuple(columns), 0.0
    changed = [y + column.T for y, column in zip(base, columns, strict=True)]
    return tuple(columns), run.yardstick.measure(changed)[1]
