"""The fit of what was chosen, by forward runs: one that stalls far off is begun anew, one that fits is left alone."""

from __future__ import annotations

import numpy as np
import pytest
from motor import MOTOR
from motor_case import record
from motor_friction import CATALOGUE

from twinbench.mismatch import stage_prove
from twinbench.mismatch.asked import Asked
from twinbench.mismatch.naming.weighed import weighed
from twinbench.mismatch.solve import solve
from twinbench.mismatch.stage_prove import HOPS


def dry_friction(t, x, u):
    return np.array([0.0, -1.2 * np.tanh(x[1] / 0.5), 0.0])


@pytest.fixture(scope="module")
def found():
    return weighed(Asked(MOTOR, [record(f"run {s}", s, dry_friction) for s in (1, 2)], [], CATALOGUE))


def misfit(found) -> float:
    return stage_prove.tested(found.answer, found.fit, found.seen.floor).answer.found[0].evidence["misfit"]


@pytest.mark.parametrize("stalled", [0, 2, 2 + 2 * HOPS])
def test_a_fit_that_stalls_far_off_is_begun_anew(found, monkeypatch, stalled):
    """Each fit solves twice."""
    asked = []

    def stalling(problem, z, *args, **kwargs):
        asked.append(z)
        if len(asked) > stalled:
            return solve(problem, z, *args, **kwargs)
        off = problem.z0 if len(asked) == 1 else z
        return off, problem.cost(off)

    assert found.answer.found
    good = misfit(found)
    monkeypatch.setattr(stage_prove, "solve", stalling)
    reached = misfit(found)
    if stalled <= 2:
        assert reached == pytest.approx(good, abs=0.05)
        assert len(asked) == 2 + stalled
    else:
        assert reached > good + 3.0, "all stalled, so this is as far as it goes"
        assert len(asked) == 2 + 2 * HOPS
