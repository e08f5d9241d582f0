"""Names for the places in a vector, so that an equation reads ``theta[P.K_s]`` and not ``theta[27]``."""

from __future__ import annotations

from collections import namedtuple
from collections.abc import Iterable
from typing import Any


def places(names: Iterable[str]) -> Any:
    """Where each name stands: ``places(("a", "b")).b`` is 1.

    The numbers come from the list itself, so that a name put into its middle moves those behind it along. numba takes
    the record as a constant.
    """
    names = tuple(names)
    return namedtuple("Places", names)(*range(len(names)))  # type: ignore[misc]
