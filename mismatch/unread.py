"""What is left of a reading where nothing is named: is it a function of where the machine was?

Something without a name is sought at balances and fluxes. What a law of a reading lacks acts at none of them. No
function there is like it, so it is taken for noise of the sensor, however large. But a sensor's noise does not go with
the machine's states and inputs.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from twinbench.mismatch.course import Acts, Course
from twinbench.mismatch.naming.discrepancy import Discrepancy
from twinbench.mismatch.naming.ground import Ground
from twinbench.mismatch.naming.name import FAR_OFF
from twinbench.mismatch.naming.settle import Settled
from twinbench.mismatch.naming.whiteness import taken_for_noise
from twinbench.mismatch.proof import RESAMPLED_PIECES, resamples
from twinbench.mismatch.words import number
from twinbench.physics.simulator import Array

GOES_WITH = 0.5
"""Share of its squares by which a function of states and inputs has to make smaller what was taken for noise. Of 19
outputs of sound machines, most of them with ripples of 1 % of a flow, a function removes nothing. Of a pressure whose
law lacks a hatch it removes two thirds."""

LEAST_NOISE = 1e-9
"""Least share of a series' mean square that is noise: functions that are alike could not be told apart without any."""


def unread(chosen: Settled, ground: Ground, floor: Array) -> tuple[str, ...]:
    """Outputs of which what was taken for noise is a function of states and inputs, in words.

    Args:
        chosen: a hypothesis in which nothing is missing.
        floor: (ny,) noise of block means, in the outputs' units.
    """
    view, noise = taken_for_noise(chosen, ground)
    found = []
    for c, v in enumerate(chosen.problem.machine.simulator.outputs):
        left, gone = goes_with(_columns(view.courses, ground.discrepancy, c), [n[:, c] for n in noise], float(floor[c]))
        if gone > GOES_WITH and left > FAR_OFF * floor[c] ** 2:
            found.append(
                f"what is left of {v.name} is no noise: a function of the states and inputs that is added to this "
                f"reading takes away at least {number(100.0 * gone, 2)} % of its squares, on pieces of the recordings "
                "that the function was not learnt from. Nothing in the catalogue is this function"
            )
    return tuple(found)


def _columns(courses: Sequence[Course], d: Discrepancy, channel: int) -> list[Array]:
    """(B, R) of the functions added to one output, per recording."""
    found = []
    for course in courses:
        functions, (stretches, active, ny) = d.functions(course), course.sizes
        reads = np.zeros((stretches, ny, functions.shape[1]))
        reads[:, channel] = functions
        acts = Acts(np.zeros((stretches, active, functions.shape[1])), reads)
        found.append(course.columns(acts)[:, channel])
    return found


def goes_with(columns: Sequence[Array], series: Sequence[Array], floor: float) -> tuple[float, float]:
    """Mean square of series, and the share of it that columns remove from pieces that they were not fitted to.

    The share is its 5 % quantile where pieces are drawn anew.

    Args:
        columns: (B, R) per recording, each of prior variance one together with the others, dimensionless.
        series: (B,) per recording, in one unit; NaN where nothing was read.
        floor: noise of block means, in the same unit.
    """
    pieces = []
    for X, y in zip(columns, series, strict=True):
        for some in np.array_split(np.arange(len(y)), RESAMPLED_PIECES):
            seen = some[np.isfinite(y[some])]
            if len(seen):
                pieces.append((X[seen], y[seen]))
    squares = np.array([float(y @ y) for _, y in pieces])
    if len(pieces) < 2 or not squares.sum() > 0.0:
        return 0.0, 0.0
    mean = float(squares.sum()) / sum(len(y) for _, y in pieces)
    G, b = sum(X.T @ X for X, _ in pieces), sum(X.T @ y for X, y in pieces)
    ridge = max(floor**2 / mean, LEAST_NOISE) * np.eye(columns[0].shape[1])
    left = [float(np.sum((y - X @ np.linalg.solve(G - X.T @ X + ridge, b - X.T @ y)) ** 2)) for X, y in pieces]
    picks = resamples(len(pieces))
    shares = 1.0 - np.array(left)[picks].sum(axis=1) / squares[picks].sum(axis=1)
    return mean, float(np.quantile(shares, 0.05))
