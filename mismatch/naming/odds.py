"""Prior odds: of each candidate, and of how many there are."""

from __future__ import annotations

import numpy as np
from scipy.special import gammaln

from twinbench.mismatch.machine import Machine
from twinbench.physics.simulator import Array


def log_odds(machine: Machine) -> Array:
    """(C,) log prior odds of each of a machine's candidates, dimensionless: as told, or one of all of them."""
    common = 1.0 / max(len(machine.candidates), 1)
    return np.log([common if c.odds is None else c.odds for c in machine.candidates])


def of_number(effects: int, candidates: int) -> float:
    """Log odds of so many effects, beside those of each: any number is as likely as any other.

    Of one it is nothing. Where many act, one more is no surprise, and odds of one in all for each would take the weaker
    half of them for chance (Scott and Berger 2010).
    """
    effects = min(effects, candidates)  # what may be beside all of them is one of them again
    ways = gammaln(candidates + 1) - gammaln(effects + 1) - gammaln(candidates - effects + 1)
    return float(effects * np.log(max(candidates, 1)) - ways)


def one_more(effects: int, candidates: int) -> float:
    """Log odds of one effect more than there are, beside that effect's own."""
    return of_number(effects + 1, candidates) - of_number(effects, candidates)
