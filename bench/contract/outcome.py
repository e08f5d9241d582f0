"""How a promise says no."""

from __future__ import annotations

import numpy as np


class Broken(Exception):
    """The promise is not kept; the message says by how much."""


class NotOffered(Exception):
    """The estimator does not make this promise; the message says why."""


def at_most(value: float, limit: float, says: str) -> str:
    """The detail of a measured number; broken where it is above the limit or NaN."""
    line = f"{says} {value:.2g}, at most {limit:g} allowed"
    if not value <= limit:
        raise Broken(line)
    return line


def need(kept: bool | np.bool_, otherwise: str) -> None:
    """Broken unless kept."""
    if not kept:
        raise Broken(otherwise)
