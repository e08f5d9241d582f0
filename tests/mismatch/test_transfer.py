"""Sizes learnt on some recordings against those that others want."""

from __future__ import annotations

import numpy as np
import pytest
from motor import MOTOR
from motor_case import NOISE, record
from scipy.stats import chi2

from twinbench.mismatch.calibrate import own_unknowns, shared_unknowns
from twinbench.mismatch.explanation import Explanation, rewhitened
from twinbench.mismatch.fit import Problem
from twinbench.mismatch.machine import Machine
from twinbench.mismatch.noise import Whitener
from twinbench.mismatch.proof import held_out
from twinbench.mismatch.solve import solve
from twinbench.mismatch.tracks import prepare
from twinbench.mismatch.transfer import Transfer, transfer


@pytest.fixture(scope="module")
def learnt():
    """The motor fitted to two recordings."""
    machine = Machine(MOTOR, ())
    tracks = prepare([record(f"train_{k}", k) for k in (1, 2)], MOTOR)
    machine.settle_step(tracks, NOISE)
    unknowns = (*shared_unknowns(MOTOR), *own_unknowns(MOTOR, tracks))
    problem = Problem(machine, tracks, unknowns, Whitener(np.zeros((3, 0)), NOISE))
    z, _ = solve(problem, problem.z0)
    problem = rewhitened(problem.refined(z), z, 0.1 * NOISE, 3)
    return Explanation((), (), problem, *solve(problem, z))


def asked(learnt: Explanation, *recordings) -> Transfer:  # type: ignore[no-untyped-def]
    tracks = prepare(recordings, MOTOR)
    own = own_unknowns(MOTOR, tracks)
    return transfer(learnt, held_out(learnt.problem, learnt.z, tracks, own), tracks, own)


def test_the_same_machine_wants_what_was_learnt(learnt):
    found = asked(learnt, record("held", 7, reach=0.7))
    assert 4 <= found.sizes <= len(shared_unknowns(MOTOR))
    assert found.chi2 < 2.0 * chi2.isf(0.01, found.sizes)
    assert not found.fails


def test_a_machine_with_something_else_in_it_wants_other_sizes(learnt):
    found = asked(learnt, record("held", 7, extra=lambda t, x, u: np.array([0.0, -0.08 * x[1], 0.0]), reach=0.7))
    assert found.fails
