"""Which added sensor would do in the place of another experiment."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from twinbench.mismatch.design.candidates import Candidate
from twinbench.mismatch.design.clock import Clock
from twinbench.mismatch.design.hand import Hand
from twinbench.mismatch.design.separation import Expected, expected
from twinbench.mismatch.design.trials import states_of, tried, with_sensor
from twinbench.physics.simulator import Array

SAME_COURSE = 0.9999
"""Correlation of a state with a reading from which it is measured already."""
STANDS = 1e-6
"""Share of its scale below which a state does not move."""


class Added(NamedTuple):
    """What one more sensor promises.

    Attributes:
        state: its name.
        sd: of the sensor's noise in block means, in the state's unit.
    """

    state: str
    sd: float
    expected: Expected


def sensors(candidate: Candidate, hand: Hand, clock: Clock, groups: np.ndarray) -> list[Added]:
    """Each sensor that could be added to an experiment, the best first; none where all states are measured.

    Args:
        groups: (m,) dimensionless labels of rivals, as ``expected`` takes them.
    """
    trial = tried(candidate, hand, clock)
    if trial is None:
        return []
    courses, found = states_of(hand.rivals[0], candidate, clock), []
    machine = hand.rivals[0].problem.machine
    for k, v in enumerate(machine.simulator.states):
        moves = np.std(courses[:, k]) > STANDS * v.scale
        if not moves or _is_read(courses[:, k], trial.shown[0].means[:, hand.measured]):
            continue
        sd = _like(hand, clock, k)
        more = with_sensor(trial, hand, clock, k, sd)
        if more is not None:
            found.append(Added(v.name, sd, expected(hand, more, groups)))
    return sorted(found, key=lambda a: (-round(a.expected.right, 2), -a.expected.worst))


def _is_read(course: Array, readings: Array) -> bool:
    """Does a sensor read a state (B,), among readings (B, n)? Its zero and its unit do not count."""
    moving = readings[:, np.std(readings, axis=0) > 0.0]
    return any(abs(np.corrcoef(course, column)[0, 1]) > SAME_COURSE for column in moving.T)


def _like(hand: Hand, clock: Clock, state: int) -> float:
    """Noise of a sensor of a state: that of one in its unit, or as large a share of its scale as usual."""
    simulator, sds = hand.rivals[0].problem.machine.simulator, np.sqrt(clock.noise.variance)
    v = simulator.states[state]
    pairs = [(o, float(sd)) for o, sd, there in zip(simulator.outputs, sds, hand.measured, strict=True) if there]
    alike = [sd for o, sd in pairs if o.unit == v.unit]
    return max(alike) if alike else float(np.median([sd / o.scale for o, sd in pairs])) * v.scale
