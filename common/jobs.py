"""How many things are done at once, in processes or in threads: one per core, or as many as somebody allows."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator

from twinbench.common.errors import BadInput

VARIABLE = "LOKY_MAX_CPU_COUNT"
"""Where joblib reads it, too; processes that this one starts inherit it."""
MOST_JOBS = 1024
"""More is a slip of the finger."""


def cores() -> int:
    """The cores that this process may use, or fewer if ``at_most`` says so."""
    import joblib

    return int(joblib.cpu_count())


@contextlib.contextmanager
def at_most(jobs: int | None) -> Iterator[None]:
    """Meanwhile no more than so many at once; None: as it was.

    Raises:
        BadInput: no such number.
    """
    if jobs is None:
        yield
        return
    if not 1 <= jobs <= MOST_JOBS:
        raise BadInput(f"--jobs is {jobs}, must lie in [1, {MOST_JOBS}]; leave it out for one job per core")
    before = os.environ.get(VARIABLE)
    os.environ[VARIABLE] = str(jobs)
    try:
        yield
    finally:
        if before is None:
            del os.environ[VARIABLE]
        else:
            os.environ[VARIABLE] = before
