"""How many things run at once."""

from __future__ import annotations

import os

import joblib
import pytest

from twinbench.common.errors import BadInput
from twinbench.common.jobs import VARIABLE, at_most, cores


def test_at_most_so_many_and_afterwards_as_before(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv(VARIABLE, raising=False)
    whole = cores()
    with at_most(1):
        assert cores() == joblib.cpu_count() == 1
    with at_most(None):
        assert cores() == whole
    assert VARIABLE not in os.environ
    monkeypatch.setenv(VARIABLE, "1")
    with at_most(7):
        assert os.environ[VARIABLE] == "7"
    assert os.environ[VARIABLE] == "1"


@pytest.mark.parametrize("jobs", [0, -1, 100_000])
def test_no_such_number_is_refused(jobs: int) -> None:
    with pytest.raises(BadInput, match=f"--jobs is {jobs}, must lie in"), at_most(jobs):
        pass
