"""When an effect begins: found where it does, and left alone where it was there all the time."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from motor import MOTOR
from motor_case import TRUE, record

from twinbench.mismatch.catalogue import generic
from twinbench.mismatch.fit import Problem, Unknown
from twinbench.mismatch.machine import Machine
from twinbench.mismatch.noise import Whitener
from twinbench.mismatch.onset import Onset, find_onsets, settled_onsets, told_onsets
from twinbench.mismatch.picture import picture, variants
from twinbench.mismatch.tracks import prepare

FLOOR = np.array([1.0, 0.5, 0.5])
SLIDING = [m for m in generic(MOTOR) if m.name in ("coulomb_friction@omega_rad_s", "loss_to_ambient@T_winding_K")]
BEGINS_S = 71.0


def rubbing(since_s: float, Nm: float = 4.0):
    """Dry friction of the shaft, from a time on."""
    return lambda t, x, u: np.array([0.0, -Nm / TRUE["J_kg_m2"] * np.tanh(x[1] / 1.5) * (t >= since_s), 0.0])


def starts(*since_s: float):
    """The problem of as many recordings at the motor's true parameters, and what ``find_onsets`` says of it."""
    tracks = prepare([record(str(i), 40 + i, rubbing(s)) for i, s in enumerate(since_s)], MOTOR)
    machine = Machine(MOTOR, tuple(SLIDING))
    machine.settle_step(tracks, FLOOR)
    theta = machine.theta.copy()
    for name, value in TRUE.items():
        theta[MOTOR.index(name)] = value
    unknowns = tuple(
        Unknown(f"start of {v.name}", "start", i, -np.inf, np.inf, 0.0, 10.0 * v.scale, 0.2 * v.scale, r)
        for r in range(len(tracks))
        for i, v in enumerate(MOTOR.states)
    )
    problem = Problem(machine, tracks, unknowns, Whitener(np.zeros((3, 0)), FLOOR))
    problem = replace(problem, theta=theta)
    shown = picture(problem, problem.z0, variants(machine.candidates))
    return problem, find_onsets(problem, problem.z0, shown)


def test_a_start_in_mid_recording_is_found_and_settles_within_seconds():
    problem, since = starts(np.inf, BEGINS_S)
    assert since is not None
    assert since[0] == np.inf
    assert since[1] == pytest.approx(BEGINS_S, abs=6.0)
    sliding = problem.machine.candidates[0]
    theta = problem.theta.copy()
    theta[list(sliding.at)] = sliding.typical
    theta[sliding.at[0]] = 4.0 / TRUE["J_kg_m2"]
    settled = settled_onsets(replace(problem, theta=theta, since=since), problem.z0)
    assert settled.since[0] == np.inf
    assert settled.since[1] == pytest.approx(BEGINS_S, abs=2.0)


@pytest.mark.parametrize("since_s", [(-np.inf, -np.inf), (np.inf, np.inf)])
def test_what_is_there_all_the_time_or_never_has_no_start(since_s):
    assert starts(*since_s)[1] is None


def test_what_begins_in_no_recording_has_no_time_but_is_told_recording_by_recording():
    """It was in one recording throughout and in another not at all: "since 0 s" would be false."""
    tracks = prepare([record("monday", 1, seconds=20.0), record("friday", 2, seconds=20.0)], MOTOR)
    assert told_onsets((np.inf, -np.inf), tracks) == (Onset("monday", "not"), Onset("friday", "throughout"))
    late = replace(tracks[1], time_s=tracks[1].time_s + 100.0)
    assert told_onsets((-np.inf, 107.0), (tracks[0], late)) == (
        Onset("monday", "throughout"),
        Onset("friday", "from", 107.0, 7.0),
    )
    assert told_onsets((-np.inf, -np.inf), tracks) == ()
