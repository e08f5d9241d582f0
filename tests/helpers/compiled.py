"""A function that compiles in each process anew, and says in which one it was called."""

from __future__ import annotations

import os

from numba import njit


@njit
def _doubled(value):  # type: ignore[no-untyped-def]
    return 2.0 * value


def doubled(value: float) -> tuple[float, int]:
    """Twice the value, and the process."""
    return _doubled(value), os.getpid()
