"""Steps of the readings: when one is seen, what is supposed of it, what is found, and when health goes back."""

from __future__ import annotations

import numpy as np
import pytest
from augmented_filter import (
    BIAS,
    COLOURED,
    NOISE,
    OFF,
    PARTS,
    PROBE,
    SIZE,
    WHITE,
    ZETA,
    corrected,
    machine,
    off_by,
    ticked,
)

from twinbench.machines.compressor import COMPRESSOR
from twinbench.methods.deeponet_kalman.augmented import readings
from twinbench.methods.deeponet_kalman.causes import (
    KEPT_PLACES,
    free_to_return,
    moved,
    note_way,
    stepped,
    steps_type,
    suppose,
    waits_of,
)
from twinbench.methods.deeponet_kalman.cycle import UNKNOWN_S, said_type, scratch, update
from twinbench.methods.deeponet_kalman.forecast import predict_mean
from twinbench.methods.deeponet_kalman.model import readings_of
from twinbench.methods.deeponet_kalman.safeguards import (
    FROZEN,
    INFLATING,
    INFLATION_UPDATES,
    OUTSIDE_MOST,
    UPDATES,
    empty_safety,
)
from twinbench.methods.deeponet_kalman.tick import WANDERING, tick
from twinbench.methods.estimator import FLAG_GATED
from twinbench.methods.weighing import LEAP, NOTHING, causes_of, likeliest

SAMPLE_PERIOD_S, WAITS, CAUSES = COMPRESSOR.sample_period_s, waits_of(COMPRESSOR), causes_of(COMPRESSOR)
SHIFTS, FAILING = readings_of(COMPRESSOR).shifts, CAUSES.failing.tolist()
STEPS = steps_type(PARTS)
NOTHING_READ = (np.nan, np.nan, np.nan)
BEGIN, WEIGHED_S = 100, 10.0


def watched(problem, leaps=None, fails=None, size=0.0, ticks=300):
    """A machine that the filter knows exactly, but for what happens to it in tick BEGIN.

    The operator's sensitivities to health are made five times as large: an untrained one hardly has any.

    Returns:
        Memory of the filter after so many ticks, true z, ticks in which causes were weighed, and the causes found.
    """
    weights, model, base, z, _ = problem
    weights, z, rng = weights.copy(), z.copy(), np.random.default_rng(0)
    weights["from_condition"][:, 5:9] *= 5.0
    z[NOISE:] = 0.0
    states = (0.02 * model.increment) ** 2
    Q = np.diag(np.r_[states, 1e-6, np.full(5, 1e-8), 1.0 - model.noise_keep**2, np.full(5, 1e-14)])
    model = model._replace(settings=OFF._replace(steps=True, weighed_s=WEIGHED_S), Q=Q)
    twin, memory = machine((weights, model, base, z, np.eye(SIZE)))
    known = np.r_[(0.01 * model.state_scale) ** 2, 0.1, np.full(5, 0.04**2), np.ones(3), np.full(5, 1e-12)]
    memory["P"], memory["safety"]["steps"]["way"] = np.diag(known), z[ZETA:NOISE]
    room, said, y = scratch(weights, PARTS), np.zeros(1, said_type(PARTS)), np.empty(3)
    weighed, found = [], []
    for k in range(ticks):
        predict_mean(weights[0], twin["filter"][0], base, z, room[0]["filter"])
        z[:5] += 0.02 * model.increment * rng.normal(size=5)
        z[ZETA + (leaps or 0)] += size if k == BEGIN and leaps is not None else 0.0
        readings(twin["filter"][0], z, y)
        measured = y + WHITE * rng.normal(size=3)
        measured[fails or 0] += size if k >= BEGIN and fails is not None else 0.0
        query, at_once = np.zeros(5, np.float32), np.zeros(3)
        arguments = (query, measured, at_once, WHITE, np.zeros(3), 6.0, said[0], room["filter"][0])
        before = memory["rivals"]["left"][0]
        tick(weights[0], twin["filter"][0], memory[0], *arguments)
        left = memory["rivals"]["left"][0]
        if left > 0:
            weighed.append(k)
        if before == 1 and left == 0:
            found.append(likeliest(memory["rivals"]["score"][0]))
    return memory[0], z, weighed, found


def test_where_nothing_happens_nothing_is_weighed(problem):
    memory, z, weighed, _ = watched(problem)
    assert not weighed
    assert memory["z"][ZETA:NOISE] == pytest.approx(z[ZETA:NOISE], abs=0.1)


def test_a_leap_of_capacity_is_found_and_keeps_every_sensor_in(problem):
    memory, z, weighed, found = watched(problem, leaps=0, size=2.0, ticks=400)
    assert found == [LEAP]
    assert weighed[0] >= BEGIN
    assert len(weighed) == round(WEIGHED_S / SAMPLE_PERIOD_S) - 1  # the last of its ticks ends it
    assert not memory["safety"]["steps"]["out"].any()
    assert memory["z"][ZETA] == pytest.approx(z[ZETA], abs=0.2)


@pytest.mark.parametrize("output", FAILING)
def test_an_output_that_fails_is_found_and_left_out_and_health_stays(problem, output):
    memory, z, weighed, found = watched(problem, fails=output, size=25.0 * WHITE[output], ticks=320)
    assert weighed[0] - BEGIN < 5
    assert found == [CAUSES.fails + FAILING.index(output)]
    out = memory["safety"]["steps"]["out"]
    assert out[output] > 0
    assert out.sum() == out[output]
    assert memory["z"][ZETA:NOISE] == pytest.approx(z[ZETA:NOISE], abs=0.2)


def test_while_causes_are_weighed_their_mixture_is_told(problem):
    memory, *_ = watched(problem, leaps=0, size=2.0, ticks=190)
    rivals = memory["rivals"]
    assert rivals["left"] > 0
    weight = np.exp(rivals["score"] - rivals["score"].max())
    weight /= weight.sum()
    assert memory["z"] == pytest.approx(weight @ rivals["z"])
    off = rivals["z"] - memory["z"]
    spread = np.einsum("k,kij->ij", weight, rivals["P"] + off[:, :, None] * off[:, None, :])
    assert memory["P"] == pytest.approx(spread, rel=1e-9, abs=1e-12)


def test_what_is_supposed_under_each_cause():
    rng = np.random.default_rng(5)
    z, P = rng.normal(size=9), np.eye(9)
    for cause in range(CAUSES.count):
        steps = np.zeros(1, STEPS)[0]
        steps["way"] = rng.normal(size=(KEPT_PLACES, 5))
        own_z, own_P = z.copy(), P.copy()
        suppose(CAUSES, WAITS, cause, steps, 1, own_z, own_P, 3, 2.0)
        out = [WAITS.left_out if cause >= CAUSES.fails and FAILING[cause - CAUSES.fails] == c else 0 for c in range(3)]
        assert steps["out"].tolist() == out
        more = own_P - P
        if cause == CAUSES.back:
            assert own_z[3:8] == pytest.approx(steps["way"][1])
            assert np.linalg.matrix_rank(more) == 5
        else:
            assert np.array_equal(own_z, z)
            assert np.diag(more) == pytest.approx(
                [4.0 if LEAP <= cause < CAUSES.back and j == 2 + cause else 0 for j in range(9)]
            )


def test_outputs_that_are_left_out_are_missing_or_come_while_the_query_is_unknown_do_not_step():
    S, far = np.eye(3), np.full(3, 4.0)
    for out, unknown, innovation in (([1, 1, 1], 0, far), ([0, 0, 0], 9, far), ([0, 0, 0], 0, np.full(3, np.nan))):
        steps = np.zeros(1, STEPS)[0]
        steps["out"] = out
        assert {stepped(steps, unknown, innovation, S) for _ in range(20)} == {-1}
        assert not steps["sums"].any()
    steps = np.zeros(1, STEPS)[0]
    steps["out"] = [1, 0, 0]
    assert [stepped(steps, 0, far, S) for _ in range(3)] == [-1, -1, 1]
    assert not steps["sums"].any()


def test_the_ring_holds_the_last_two_minutes_and_tells_whether_health_moved():
    way, at = np.zeros((KEPT_PLACES, 5)), 2
    health = np.array([0.1, -0.2, 0.3, 0.0, 0.5])
    note_way(WAITS, way, 0, health)
    assert (way == health).all()
    z, P = np.zeros(9), 0.01 * np.eye(9)
    z[at : at + 5] = health
    updates = (KEPT_PLACES + 3) * WAITS.apart
    for k in range(1, updates):
        note_way(WAITS, way, k, health + (0.01 * k / WAITS.apart))
    oldest = way[(updates - 1) // WAITS.apart + 1 - KEPT_PLACES]
    assert oldest == pytest.approx(health + 0.01 * 3)
    assert sorted(way[:, 0]) == pytest.approx(health[0] + 0.01 * np.arange(3, KEPT_PLACES + 3))
    z[at : at + 5] = oldest
    for off, far in ((0.19, False), (0.21, True), (-0.21, True)):
        z[at + 4] = oldest[4] + off
        assert moved(WAITS, way, updates, z, P, at) == far


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
    safety = empty_safety(PARTS, 1)
    safety["counts"][0][UPDATES] = updates
    safety["steps"]["way"] = z[ZETA:NOISE] if at is None else at
    return problem[1]._replace(settings=OFF._replace(steps=True)), safety, z, 1e-6 * np.eye(SIZE)


@pytest.mark.parametrize("channel", FAILING)
def test_an_output_that_is_left_out_is_let_in_when_it_fits_again(problem, channel):
    model, safety, z, P = settled(problem)
    safety["steps"]["out"][0, channel] = WAITS.left_out
    step = np.where(np.arange(3) == channel, 20.0, 0.0)
    k, before = SHIFTS[channel], z[SHIFTS[channel]]
    for off, updates in ((step, 3), (0.0, WAITS.fits - 1)):
        for _ in range(updates):
            z, P, _, used, *_ = corrected(problem, safety, z, P, off_by(z, off), WHITE, COLOURED, 6.0, model)
            assert np.isnan(used).tolist() == [c == channel for c in range(3)]
    assert z[k] == pytest.approx(before, abs=0.01)
    z, P, _, used, *_ = corrected(problem, safety, z, P, off_by(z, 0.0), WHITE, COLOURED, 6.0, model)
    assert np.isfinite(used).all()
    assert safety["steps"]["out"][0][channel] == 0
    assert P[k, k] < 1e-5


@pytest.mark.parametrize("channel", FAILING)
def test_a_shift_that_lasts_is_let_in_at_last_and_put_down_to_what_it_may_be(problem, channel):
    model, safety, z, P = settled(problem)
    safety["steps"]["out"][0, channel] = WAITS.left_out
    k, at = SHIFTS[channel], z.copy()
    measured = off_by(at, np.where(np.arange(3) == channel, 8.0, 0.0))
    for _ in range(WAITS.left_out):
        assert safety["steps"]["out"][0][channel] > 0
        assert z[k] == pytest.approx(at[k], abs=0.01)
        z, P, innovation, *_ = corrected(problem, safety, z, P, measured.copy(), WHITE, COLOURED, np.inf, model)
    assert safety["steps"]["out"][0][channel] == 0
    left = measured - off_by(z, 0.0)
    assert abs(left[channel]) < 0.3 * abs(innovation[channel])


def weighed_after_a_step(problem, channel, at):
    """Memory (1,) in the tick in which an output's step is seen, of a machine whose health was ``at`` (5,)."""
    weights, model, *_ = problem
    twin, memory = machine((weights, model._replace(settings=OFF._replace(steps=True)), *problem[2:]))
    memory["P"], memory["safety"]["steps"]["way"], memory["safety"]["counts"][0, UPDATES] = 1e-6 * np.eye(SIZE), at, 1
    said, room = np.zeros(1, said_type(PARTS)), scratch(weights, PARTS)
    while memory["rivals"]["left"][0] == 0:
        measured = off_by(memory["z"][0], np.where(np.arange(3) == channel, 20.0, 0.0))
        arguments = (np.zeros(5, np.float32), measured, np.zeros(3), WHITE, COLOURED, 6.0, said[0], room["filter"][0])
        tick(weights[0], twin["filter"][0], memory[0], *arguments)
    return memory


@pytest.mark.parametrize("channel", range(3))
def test_health_that_moved_may_go_back_when_an_output_steps_and_none_else(problem, channel):
    was = problem[3][ZETA:NOISE] + np.array([0.3, -0.2, 0.1, 0.0, 0.4])
    for at, goes in ((was, True), (problem[3][ZETA:NOISE], False)):
        rivals = weighed_after_a_step(problem, channel, at)["rivals"][0]
        assert np.isfinite(rivals["score"][CAUSES.back]) == goes
        assert np.isfinite(np.delete(rivals["score"], CAUSES.back)).all()
        if goes:
            assert (np.diag(rivals["P"][CAUSES.back])[[ZETA, ZETA + 1, BIAS]] > 0.01).all()
            # What the bias does not explain any more is temperature.
            assert rivals["z"][CAUSES.back][PROBE] != pytest.approx(rivals["z"][NOTHING][PROBE], abs=0.1)


@pytest.mark.parametrize("channel", [0, 2, 4, 5])
def test_health_stays_while_the_query_is_unknown_and_as_long_as_the_window_holds_it(problem, channel):
    weights = problem[0]
    twin, memory = machine(problem)
    said, room = np.zeros(1, said_type(PARTS)), scratch(weights, PARTS)
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
        slow = model.slow
        assert np.array_equal(z[slow], before[slow])
        assert (z[~slow] != before[~slow]).all()
    assert not safety["counts"][0][[FROZEN, INFLATING]].any()
    assert np.linalg.eigvalsh(P)[0] > 0.0


def test_while_the_query_is_unknown_the_states_may_go_anywhere(problem):
    known, unknown = (ticked(problem, NOTHING_READ, unknown=left)[1] for left in (0, 3))
    more = np.diag(unknown - known)
    assert more[:5] == pytest.approx((WANDERING * problem[1].increment) ** 2)
    assert not more[5:].any()


def test_what_is_left_out_is_flagged(problem):
    steps = np.zeros(1, STEPS)
    assert not ticked(problem, NOTHING_READ, steps=steps)[2]["flags"][0] & FLAG_GATED
    steps["out"][0, 2] = 7
    assert ticked(problem, NOTHING_READ, steps=steps)[2]["flags"][0] & FLAG_GATED


def test_after_an_inconsistent_spell_health_is_free_to_return(problem):
    was = problem[3][ZETA:NOISE] + np.array([0.0, 0.7, 0.0, 0.0, 0.0])
    P_health = []
    for inflating in (0, INFLATION_UPDATES):
        _, safety, z, P = settled(problem, at=was)
        safety["counts"][0][INFLATING] = inflating
        P_health.append(corrected(problem, safety, z, P, off_by(z, 0.0), WHITE, COLOURED, 6.0)[1][ZETA + 1, ZETA + 1])
    assert P_health[1] - P_health[0] == pytest.approx(KEPT_PLACES * 0.7**2)
