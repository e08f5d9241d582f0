"""What many files here begin with."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from helpers.tiny_run import run_here


@pytest.fixture(scope="module")
def in_this_process() -> Iterator[None]:
    """Cells one after the other in this process, as on a machine with one core, and no figures of runs."""
    with pytest.MonkeyPatch.context() as patch:
        run_here(patch)
        yield
