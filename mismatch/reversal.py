"""Which variables turned round in the recordings. Laws that need a reversal are offered for those alone.

Dry friction unequal by direction, hysteresis, play and a dead zone do what a constant does while nothing turns round.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from twinbench.mismatch.limits import WIDTH
from twinbench.mismatch.series import held, play
from twinbench.physics.simulator import Array

RARE_SHARE = 0.02
"""Share of the time at either end that does not count as commonly."""
TURN_SHARE = 0.1
"""A signal has turned round when it went back by this share of its range: less may be noise."""


class Turned(NamedTuple):
    """Names of variables that ``crossed`` zero, came ``near`` zero, and whose course ``reversed``."""

    crossed: frozenset[str] = frozenset()
    near: frozenset[str] = frozenset()
    reversed: frozenset[str] = frozenset()

    @classmethod
    def seen(cls, courses: dict[str, list[Array]]) -> Turned:
        """As the courses say.

        Args:
            courses: per name one (N,) for each recording, in the variable's unit; NaN is missing.
        """
        tests = (crosses_zero, nears_zero, reverses)
        return cls(*(frozenset(n for n, runs in courses.items() if any(map(test, runs))) for test in tests))


def crosses_zero(values: Array) -> bool:
    """Was it on both sides of zero, and each time for a while and by a share of its range?

    Args:
        values: (N,) in any unit; NaN is missing.
    """
    low, high = _common(values)
    least = TURN_SHARE * (high - low)
    return bool(low < -least and high > least)


def nears_zero(values: Array) -> bool:
    """Did it cross zero, or come so near that a dead zone of typical width would have taken all of it?

    Args:
        values: (N,) in any unit; NaN is missing.
    """
    low, high = _common(values)
    # Half of the range is the scale that typical widths are shares of.
    width = 0.5 * WIDTH * (high - low)
    return bool(low < width and high > -width)


def reverses(values: Array) -> bool:
    """Did it go up and down again, or down and up, by a share of its range?

    Args:
        values: (N,) in any unit; NaN is missing.
    """
    low, high = _common(values)
    moved = np.diff(play(held(np.ascontiguousarray(values, dtype=np.float64)), TURN_SHARE * (high - low)))
    return bool((moved > 0.0).any() and (moved < 0.0).any())


def _common(values: Array) -> tuple[float, float]:
    """Where it commonly was, from and to."""
    seen = values[np.isfinite(values)]
    if not len(seen):
        return 0.0, 0.0
    low, high = np.quantile(seen, (RARE_SHARE, 1.0 - RARE_SHARE))
    return float(low), float(high)
