"""Courses of inputs: held levels joined by ramps."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from twinbench.machines.coordinates import Array


def pieces(
    rng: np.random.Generator,
    seconds: float,
    limits: tuple[float, float],
    lean: float,
    hold_s: tuple[float, float],
    ramp_s: tuple[float, float],
) -> Array:
    """Knots (n, 2), seconds and values in the unit of the limits, of held levels joined by ramps.

    Args:
        rng: what levels and times are drawn from.
        seconds: how long it goes on at least.
        limits: of the levels.
        lean: in [0, 1], tilts the levels to the low or the high end.
        hold_s: shortest and longest that a level is held.
        ramp_s: shortest and longest that a ramp takes.
    """
    power = 2.0 ** (1.0 - 2.0 * lean)

    def level() -> float:
        return limits[0] + (limits[1] - limits[0]) * float(rng.random()) ** power

    knots = [(0.0, level())]
    while knots[-1][0] < seconds:
        leave = knots[-1][0] + rng.uniform(*hold_s)
        knots += [(leave, knots[-1][1]), (leave + rng.uniform(*ramp_s), level())]
    return np.array(knots)


def along(knots: Array, time_s: Array) -> Array:
    """Values (N,) of knots at times.

    Args:
        knots: (n, 2) seconds and values in any unit.
        time_s: (N,) seconds.
    """
    return np.interp(time_s, knots[:, 0], knots[:, 1])


def joined(*courses: Array) -> Callable[[Array], Array]:
    """Several courses as the inputs (N, nu) over times (N,).

    Args:
        courses: of every input, knots (n, 2): seconds and values in its unit.
    """

    def drive(time_s: Array) -> Array:
        return np.stack([along(knots, time_s) for knots in courses], axis=-1)

    return drive
