"""Which experiment would tell rivals apart: on a linear machine against the closed form, and from file to file."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.signal import lsim

from twinbench.mismatch.design.added import sensors
from twinbench.mismatch.design.candidates import KINDS, Candidate, drawn
from twinbench.mismatch.design.choice import enough, proposed
from twinbench.mismatch.design.clock import Clock
from twinbench.mismatch.design.hand import Hand, at_hand
from twinbench.mismatch.design.limits import Limits
from twinbench.mismatch.design.separation import groups_of, nats, worst
from twinbench.mismatch.design.trials import tried, with_sensor
from twinbench.mismatch.fit import Problem, Unknown
from twinbench.mismatch.machine import Machine
from twinbench.mismatch.naming.discrepancy import discrepancy
from twinbench.mismatch.naming.effect import Effect
from twinbench.mismatch.naming.ground import Ground
from twinbench.mismatch.naming.settle import settled
from twinbench.mismatch.naming.view import View
from twinbench.mismatch.sensors import SensorNoise
from twinbench.mismatch.steps import settle_step
from twinbench.mismatch.tracks import Track
from twinbench.mismatch.variants import Variant
from twinbench.physics.simulator import Port, Simulator, Term, Variable

TAU_S, SD, SIZE, GIVEN = 5.0, 0.05, 0.2, 4.0
"""The machine's time constant, the sensor's noise, the size of what is missing, and the input that was recorded."""
TIME_S = np.arange(0.0, 100.0, 0.5)


def rhs(x, u, theta):
    return np.array([(theta[0] * u[0] - x[0]) / 5.0])


def output(x, u, theta):
    return np.array([x[0]])


def initial(u0, y0, theta):
    return np.array([y0[0]])


def draught(x, u, theta):
    return theta[-1]


def leak(x, u, theta):
    return -theta[-1] * x[0]


LINEAR = Simulator(
    "linear",
    states=(Variable("x", "1", -50.0, 50.0, 4.0, 1.0),),
    inputs=(Variable("u", "1", 0.0, 10.0, 4.0, 1.0),),
    outputs=(Variable("y", "1", -50.0, 50.0, 4.0, 1.0),),
    parameters=(Variable("gain", "1", 1.0, 1.0, 1.0, 1.0),),
    rhs=rhs,
    output=output,
    initial=initial,
)
"""Nothing of it is unknown but where it starts."""
EFFECTS = (
    Term("draught", "a constant rate", "balance:x", (Variable("c", "1/s", -5.0, 5.0, 0.1, 0.1),), term=draught),
    Term("leak", "a rate in proportion", "balance:x", (Variable("g", "1/s", -5.0, 5.0, 0.02, 0.02),), term=leak),
)


def response(u: np.ndarray, rate: np.ndarray, lost: float = 0.0) -> np.ndarray:
    """The linear machine's answer to an input and a rate, from rest under their first values."""
    slowness = 1.0 / TAU_S + lost
    start = (u[0] / TAU_S + rate[0]) / slowness
    system = ([[-slowness]], [[1.0 / TAU_S, 1.0]], [[1.0]], [[0.0, 0.0]])
    return lsim(system, np.stack([u, rate], axis=1), TIME_S, [start], interp=False)[1]


@cache
def hand() -> Hand:
    """A draught was recorded under one input: nobody can tell it from a leak."""
    machine = Machine(LINEAR, EFFECTS)
    u = np.full(len(TIME_S), GIVEN)
    y = response(u, np.full(len(u), SIZE))[:, None]
    track = Track("still", TIME_S, u[:, None], y, np.arange(len(u)), y)
    settle_step(machine, [track], np.array([SD]))
    start = Unknown("start of x", "start", 0, -np.inf, np.inf, 0.0, 4.0, 0.2, 0)
    problem = Problem(machine, [track], (start,), np.array([SD]))
    view = View.around(problem, problem.z0)
    noise = SensorNoise(np.array([SD**2]), np.array([1e-12]), np.array([1.0]))
    learnt = Ground.learnt(view, discrepancy(view.courses, {Port("balance", "x"): 1.0}), np.array([SD]))
    ground = replace(learnt.exact, noise=noise)
    wide = [Effect(Variant(k, ()), size, 10.0, 0.0) for k, size in enumerate((SIZE, -SIZE / GIVEN))]
    rivals = [settled(problem, problem.z0, (e,), ground, np.empty(0)) for e in wide]
    return at_hand(rivals, ("draught", "leak"), ground)


CLOCK = Clock(200.0, 1, False, SensorNoise(np.array([SD**2]), np.array([1e-12]), np.array([1.0])))


def run(kind: str, u: np.ndarray) -> Candidate:
    return Candidate(kind, kind, TIME_S, u[:, None])


STEP = run("step", np.where(TIME_S < 30.0, GIVEN, GIVEN + 1.0))
STAIRCASE = run("staircase", np.floor(TIME_S / 25.0) * 2.0 + 2.0)
STILL = run("still", np.full(len(TIME_S), GIVEN))


def by_hand(u: np.ndarray) -> float:
    """c_A^2 (G_AA - G_AB^2 / G_BB) / 2 with a draught as A: old and new readings stacked, starts and B's size free."""
    still = np.full(len(u), GIVEN)
    draughts = [response(one, np.full(len(u), SIZE)) - response(one, np.zeros(len(u))) for one in (still, u)]
    # B's column is taken where B stands: at the size that explains the old readings.
    size, step = -SIZE / GIVEN, 1e-5
    leaks = [(response(v, 0.0 * v, size + step) - response(v, 0.0 * v, size - step)) / step for v in (still, u)]
    stands = np.concatenate([response(one, 0.0 * one, size) - response(one, 0.0 * one) for one in (still, u)])
    nothing = np.zeros(len(u))
    faded = np.exp(-TIME_S * (1.0 / TAU_S + size))
    X = np.stack([np.concatenate(leaks), np.concatenate([faded, nothing]), np.concatenate([nothing, faded])], axis=1)
    a = np.concatenate(draughts) - stands
    left = a - X @ np.linalg.lstsq(X, a, rcond=None)[0]
    return 0.5 * float(left @ left) / SD**2


@pytest.mark.parametrize("candidate", [STEP, STAIRCASE])
def test_expected_evidence_is_the_closed_form_of_a_linear_machine(candidate: Candidate):
    trial = tried(candidate, hand(), CLOCK)
    assert trial is not None
    assert nats(hand(), trial)[0, 1] == pytest.approx(by_hand(candidate.u[:, 0]), rel=0.02, abs=0.5)


def test_the_proposed_experiment_tells_apart_what_the_old_recordings_cannot():
    best = proposed(hand(), [STILL, STAIRCASE, STEP], CLOCK)
    assert best.trial.candidate.kind == "step", "the staircase tells more, and more than it takes"
    assert best.expected is not None
    assert best.expected.right > 0.95
    assert best.times == 1
    assert max(hand().probabilities) < 0.95
    assert best.worth[2] < 0.5 < best.worth[1] < best.worth[0]


def test_reach_is_how_far_the_farthest_channel_leaves_the_recordings():
    (track,) = hand().rivals[0].problem.tracks
    assert hand().reach(track.u, track.means) == 0.0
    assert hand().reach(track.u + 1.0, track.means - 2.0) == pytest.approx(2.0)


def test_a_sensor_of_what_is_read_already_is_none_to_add():
    assert sensors(STEP, hand(), CLOCK, np.arange(2)) == []


def test_one_sensor_more_is_one_row_more_of_evidence():
    """A second sensor like the first has the same readings: it halves the noise, and doubles what is told."""
    trial = tried(STEP, hand(), CLOCK)
    assert trial is not None
    more = with_sensor(trial, hand(), CLOCK, 0, SD)
    assert more is not None
    assert nats(hand(), more)[0, 1] == pytest.approx(nats(hand(), trial, times=2)[0, 1], rel=0.05)


def test_rivals_that_no_experiment_parts_are_one_group():
    apart, same = np.array([[0.0, 9.0], [9.0, 0.0]]), np.array([[0.0, 0.1], [9.0, 0.0]])
    assert len(set(groups_of([apart, same]))) == 2
    assert len(set(groups_of([same, same.T]))) == 2, "none of them may be taken for right"
    whole = np.array([[0.0, 1.0, 8.0], [1.0, 0.0, 6.0], [7.0, 5.0, 0.0]])
    assert worst(whole, groups_of([whole])) == 5.0


def test_candidates_keep_their_limits_and_come_again_from_the_same_seed():
    limits = Limits(np.array([2.0]), np.array([6.0]), np.array([0.5]), 100.0, 0.5, candidates=20)
    made = drawn(LINEAR, limits)
    assert {one.kind for one in made} == set(KINDS)
    for one, again in zip(made, drawn(LINEAR, limits), strict=True):
        assert np.array_equal(one.u, again.u)
        assert one.u.min() >= 2.0
        assert one.u.max() <= 6.0
        assert np.abs(np.diff(one.u[:, 0])).max() <= 0.25 + 1e-12
        assert np.ptp(one.u) > 0.5


def test_an_experiment_begins_at_rest_however_short_it_is():
    short = Candidate("short", "short", TIME_S[:4], np.full((4, 1), GIVEN + 2.0))
    trial = tried(short, hand(), CLOCK)
    assert trial is not None
    rests = GIVEN + 2.0 + SIZE * TAU_S, (GIVEN + 2.0) / (1.0 - SIZE * TAU_S / (GIVEN + SIZE * TAU_S))
    for shown, rest in zip(trial.shown, rests, strict=True):
        assert shown.means[:, 0] == pytest.approx(rest, abs=0.05)


def test_an_input_that_does_not_move_stays_where_the_recordings_had_it():
    two = replace(LINEAR, inputs=(*LINEAR.inputs, Variable("v", "1", 0.0, 10.0, 4.0, 1.0)))
    limits = Limits(np.array([2.0, 2.0]), np.array([6.0, 6.0]), np.array([0.5, 0.5]), 100.0, 0.5, candidates=10)
    for stay, expected in ((np.array([3.0, 9.0]), (3.0, 6.0)), (None, (4.0, 4.0))):
        made = drawn(two, limits, stay)
        still = {(i, float(one.u[0, i])) for one in made for i in range(2) if np.ptp(one.u[:, i]) == 0.0}
        assert still == {(0, expected[0]), (1, expected[1])}


def test_a_rival_that_is_hardly_likely_decides_little_of_what_is_enough():
    likely = replace(hand(), logs=np.log([0.6, 0.39, 0.01]))
    told = np.array([[0.0, 60.0, 10.0], [60.0, 0.0, 10.0], [10.0, 10.0, 0.0]])
    sure, chance = enough(likely, told, np.arange(3))
    assert not sure, "if it were true, ten nats would not make it likely"
    assert chance == pytest.approx(0.96, abs=0.01)
    assert enough(likely, 8.0 * told, np.arange(3))[0]
    assert enough(likely, 0.0 * told, np.arange(3)) == (False, 0.0)
