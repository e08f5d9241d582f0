"""Steps of sensors: when one is seen, what is left out, and when health goes back."""

from __future__ import annotations

import numpy as np
import pytest
from augmented_filter import COLOURED, OFF, WHITE, corrected, machine, off_by, ticked
from hypothesis import given, settings
from hypothesis import strategies as st

from twinbench.data.batch import SAMPLE_PERIOD_S
from twinbench.methods.deeponet_kalman.augmented import SHIFTS, SLOW, WANDERING
from twinbench.methods.deeponet_kalman.cycle import SAID, UNKNOWN_S, scratch, update
from twinbench.methods.deeponet_kalman.model import BIAS, NOISE, PROBE, SIZE, ZETA
from twinbench.methods.deeponet_kalman.safeguards import (
    FROZEN,
    INFLATING,
    INFLATION_UPDATES,
    OUTSIDE_MOST,
    UPDATES,
    empty_safety,
)
from twinbench.methods.deeponet_kalman.steps import (
    FITS_UPDATES,
    KEEP_UPDATES,
    KEPT_PLACES,
    LEFT_OUT_UPDATES,
    LIMIT_SD,
    MOST_SD,
    SLACK_SD,
    STEPS,
    free_to_return,
    moved,
    note_way,
    shifted,
)
from twinbench.methods.estimator import FLAG_GATED

SD = 0.02
NOTHING = (np.nan, np.nan, np.nan)


def alarms(innovations: np.ndarray) -> list[int]:
    """When a channel is said to have shifted."""
    sums = np.zeros((2, 3))
    return [k for k, x in enumerate(innovations) if shifted(sums, SD * x, SD, 1)]


@settings(deadline=None)  # the first call compiles
@given(st.lists(st.floats(-8.0, 8.0), max_size=60))
def test_an_alarm_is_where_the_largest_sum_since_any_moment_reaches_the_limit(innovations):
    capped = np.clip(innovations, -MOST_SD, MOST_SD)
    since, expected = 0, []
    for k in range(len(capped)):
        sums = [
            side * capped[j : k + 1].sum() - SLACK_SD * (k + 1 - j) for j in range(since, k + 1) for side in (1, -1)
        ]
        if abs(max(sums) - LIMIT_SD) < 1e-9:
            return  # a tie, which rounding decides
        if max(sums) > LIMIT_SD:
            expected.append(k)
            since = k + 1
    assert alarms(np.array(innovations)) == expected


def test_chance_and_single_outliers_are_no_step_and_what_lasts_is_one():
    rng = np.random.default_rng(0)
    assert not alarms(rng.normal(size=100_000))
    lone = rng.normal(size=2000)
    lone[::20] = 1e3
    assert not alarms(lone)
    for shift in (3.0, -3.0):
        noise = rng.normal(size=40)
        noise[20:] += shift
        assert 20 < alarms(noise)[0] < 30


def test_the_ring_holds_the_last_two_minutes_and_tells_whether_health_moved():
    way, at = np.zeros((KEPT_PLACES, 5)), 2
    health = np.array([0.1, -0.2, 0.3, 0.0, 0.5])
    note_way(way, 0, health)
    assert (way == health).all()
    z, P = np.zeros(9), 0.01 * np.eye(9)
    z[at : at + 5] = health
    updates = (KEPT_PLACES + 3) * KEEP_UPDATES
    for k in range(1, updates):
        note_way(way, k, health + (0.01 * k / KEEP_UPDATES))
    oldest = way[(updates - 1) // KEEP_UPDATES + 1 - KEPT_PLACES]
    assert oldest == pytest.approx(health + 0.01 * 3)
    assert sorted(way[:, 0]) == pytest.approx(health[0] + 0.01 * np.arange(3, KEPT_PLACES + 3))
    z[at : at + 5] = oldest
    for off, far in ((0.19, False), (0.21, True), (-0.21, True)):
        z[at + 4] = oldest[4] + off
        assert moved(way, updates, z, P, at) == far


def test_health_is_free_to_return_to_each_place_on_its_way():
    rng = np.random.default_rng(1)
    way, z, P = rng.normal(size=(KEPT_PLACES, 5)), rng.normal(size=9), np.eye(9)
    before = P.copy()
    free_to_return(way, z, P, 3)
    away = way - z[3:8]
    assert P[3:8, 3:8] == pytest.approx(before[3:8, 3:8] + away.T @ away)
    P[3:8, 3:8] = before[3:8, 3:8]
    assert np.array_equal(P, before)


def settled(problem, updates=1, at=None):
    """A filter with steps, its safety after so many updates, and a sure P."""
    z = problem[3].copy()
    safety = empty_safety(1)
    safety["counts"][0][UPDATES] = updates
    safety["steps"]["way"] = z[ZETA:NOISE] if at is None else at
    return problem[1]._replace(settings=OFF._replace(steps=True)), safety, z, 1e-6 * np.eye(SIZE)


def stepping(problem, channel, sd=20.0, **setting):
    """Model, safety, z, P and what was used in the update in which a step of a channel is seen."""
    model, safety, z, P = settled(problem, **setting)
    step = np.where(np.arange(3) == channel, sd, 0.0)
    for _ in range(2):
        before = z.copy()
        z, P, _, used, *_ = corrected(problem, safety, z, P, off_by(z, step), WHITE, COLOURED, 6.0, model)
    return model, safety, z, P, used, before


@pytest.mark.parametrize("channel", range(3))
def test_a_channel_that_steps_is_left_out_and_let_in_when_it_fits_again(problem, channel):
    model, safety, z, P, used, before = stepping(problem, channel)
    assert np.isnan(used).tolist() == [c == channel for c in range(3)]
    assert z[SHIFTS[channel]] == pytest.approx(before[SHIFTS[channel]], abs=0.01)
    k = SHIFTS[channel]
    for _ in range(FITS_UPDATES - 1):
        z, P, _, used, *_ = corrected(problem, safety, z, P, off_by(z, 0.0), WHITE, COLOURED, 6.0, model)
        assert np.isnan(used[channel])
    z, P, _, used, *_ = corrected(problem, safety, z, P, off_by(z, 0.0), WHITE, COLOURED, 6.0, model)
    assert np.isfinite(used).all()
    assert safety["steps"]["out"][0][channel] == 0
    assert P[k, k] < 1e-5


@pytest.mark.parametrize("channel", range(3))
def test_a_shift_that_lasts_is_let_in_at_last_and_put_down_to_what_it_may_be(problem, channel):
    model, safety, z, P, *_ = stepping(problem, channel, 8.0)
    step = np.where(np.arange(3) == channel, 8.0, 0.0)
    k, at = SHIFTS[channel], z.copy()
    measured = off_by(at, step)
    for _ in range(LEFT_OUT_UPDATES[channel]):
        assert safety["steps"]["out"][0][channel] > 0
        assert z[k] == pytest.approx(at[k], abs=0.01)
        z, P, innovation, *_ = corrected(problem, safety, z, P, measured.copy(), WHITE, COLOURED, np.inf, model)
    assert safety["steps"]["out"][0][channel] == 0
    left = measured - off_by(z, 0.0)
    assert abs(left[channel]) < 0.3 * abs(innovation[channel])


def test_without_the_safeguard_a_step_is_corrected_by_at_once(problem):
    _, safety, z, P = settled(problem)
    for _ in range(2):
        z, P, _, used, *_ = corrected(problem, safety, z, P, off_by(z, 20.0), WHITE, COLOURED, 6.0)
    assert np.isfinite(used).all()
    assert not safety["steps"]["out"].any()


@pytest.mark.parametrize("channel", [0, 2])
def test_health_that_moved_goes_back_when_a_channel_steps(problem, channel):
    was = problem[3][ZETA:NOISE] + np.array([0.3, -0.2, 0.1, 0.0, 0.4])
    _, safety, z, P, used, before = stepping(problem, channel, at=was)
    assert np.isfinite(used[channel])
    assert not safety["steps"]["out"].any()
    # Nothing but the reading that stepped says where on its way health is, and that may be its state's doing.
    assert z[ZETA:NOISE] == pytest.approx(was, abs=0.02)
    assert (np.diag(P)[[ZETA, ZETA + 1, BIAS]] > 0.01).all()
    # The discharge temperature reads what it read.
    assert off_by(z, 0.0)[1] == pytest.approx(off_by(before, 0.0)[1], abs=0.05)
    assert z[PROBE] != pytest.approx(before[PROBE], abs=0.1)


def test_a_step_of_the_temperature_never_sends_health_back(problem):
    was = problem[3][ZETA:NOISE] + 0.3
    _, safety, z, _, used, before = stepping(problem, 1, at=was)
    assert np.isnan(used[1])
    assert safety["steps"]["out"][0].tolist() == [0, LEFT_OUT_UPDATES[1], 0]
    assert z[ZETA:NOISE] == pytest.approx(before[ZETA:NOISE], abs=0.01)


def test_while_the_query_is_unknown_no_reading_is_a_step(problem):
    model, safety, z, P = settled(problem)
    safety["unknown"] = 5
    for _ in range(4):
        z, P, _, used, *_ = corrected(problem, safety, z, P, off_by(z, 20.0), WHITE, COLOURED, 6.0, model)
        assert np.isfinite(used).all()
    assert not safety["steps"]["sums"].any()


@pytest.mark.parametrize("channel", [0, 2, 4, 5])
def test_health_stays_while_the_query_is_unknown_and_as_long_as_the_window_holds_it(problem, channel):
    weights = problem[0]
    twin, memory = machine(problem)
    said, room = np.zeros(1, SAID), scratch(weights)
    rng = np.random.default_rng(0)
    mean = twin["front"]["mean"][0]
    lost = round((UNKNOWN_S + 2.0) / SAMPLE_PERIOD_S)
    held = memory["stream"]["values"].shape[1]
    moves = []
    for k in range(lost + held + 40):
        measured = (mean * (1.0 + 1e-3 * rng.normal(size=7)))[None]
        if 10 <= k < 10 + lost:
            measured[0, channel] = np.nan
        before = memory["z"][0, ZETA:NOISE].copy()
        update(weights, twin, memory, measured, np.zeros((1, 7)), said, room)
        moves.append((memory["z"][0, ZETA:NOISE] != before).any())
    begins, ends = 10 + round(UNKNOWN_S / SAMPLE_PERIOD_S), 10 + lost + held
    if channel == 5:  # none of the query's
        assert all(moves)
    else:
        assert moves[begins - 2]
        assert not any(moves[begins + 1 : ends - 1])
        assert all(moves[ends + 1 :])


def test_while_the_query_is_unknown_nothing_slow_is_corrected_and_health_is_not_rolled_back(problem):
    model, safety, z, P = settled(problem)
    model = model._replace(settings=OFF._replace(rollback=True, inflation=4.0))
    P = problem[4]
    safety["unknown"] = 100
    for _ in range(2 * OUTSIDE_MOST):
        before = z.copy()
        z, P, *_ = corrected(problem, safety, z, P, off_by(z, 40.0), WHITE, COLOURED, 6.0, model)
        slow = np.isin(np.arange(SIZE), SLOW)
        assert np.array_equal(z[slow], before[slow])
        assert (z[~slow] != before[~slow]).all()
    assert not safety["counts"][0][[FROZEN, INFLATING]].any()
    assert np.linalg.eigvalsh(P)[0] > 0.0


def test_while_the_query_is_unknown_the_states_may_go_anywhere(problem):
    known, unknown = (ticked(problem, NOTHING, unknown=left)[1] for left in (0, 3))
    more = np.diag(unknown - known)
    assert more[:5] == pytest.approx((WANDERING * problem[1].increment) ** 2)
    assert not more[5:].any()


def test_what_is_left_out_is_flagged(problem):
    steps = np.zeros(1, STEPS)
    assert not ticked(problem, NOTHING, steps=steps)[2]["flags"][0] & FLAG_GATED
    steps["out"][0, 2] = 7
    assert ticked(problem, NOTHING, steps=steps)[2]["flags"][0] & FLAG_GATED


def test_after_an_inconsistent_spell_health_is_free_to_return(problem):
    was = problem[3][ZETA:NOISE] + np.array([0.0, 0.7, 0.0, 0.0, 0.0])
    P_health = []
    for inflating in (0, INFLATION_UPDATES):
        _, safety, z, P = settled(problem, at=was)
        safety["counts"][0][INFLATING] = inflating
        P_health.append(corrected(problem, safety, z, P, off_by(z, 0.0), WHITE, COLOURED, 6.0)[1][ZETA + 1, ZETA + 1])
    assert P_health[1] - P_health[0] == pytest.approx(KEPT_PLACES * 0.7**2)
