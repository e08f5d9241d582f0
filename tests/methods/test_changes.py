"""What the filter makes of changes: a parameter that leaps, an output that fails, a query that is not known."""

from __future__ import annotations

import numpy as np
import pytest
from augmented_filter import BIAS, COLOURED, NOISE, OFF, PARTS, WHITE, ZETA, corrected, machine, off_by, ticked

from twinbench.machines.compressor import COMPRESSOR
from twinbench.methods.deeponet_kalman.augmented import readings
from twinbench.methods.deeponet_kalman.cycle import UNKNOWN_S, said_type, scratch, update
from twinbench.methods.deeponet_kalman.forecast import predict_mean
from twinbench.methods.deeponet_kalman.safeguards import empty_safety
from twinbench.methods.deeponet_kalman.tick import WANDERING, tick
from twinbench.methods.estimator import FLAG_GATED
from twinbench.methods.modes import failing_of, modes_of

SAMPLE_PERIOD_S, FAILING = COMPRESSOR.sample_period_s, failing_of(COMPRESSOR).tolist()
PARAMETERS = len(COMPRESSOR.health)
LEAPS, FAILS = 1 + PARAMETERS, 1 + 2 * PARAMETERS  # of the modes that fail, the erratic ones come first
MODES = modes_of(COMPRESSOR, 1.0, 0.01, 2.0)
NOTHING_READ = (np.nan, np.nan, np.nan)
BEGIN = 100


def watched(problem, leaps=None, fails=None, size=0.0, ticks=300):
    """A machine that the filter knows exactly, but for what happens to it in tick BEGIN.

    The operator's sensitivities to health are made five times as large: an untrained one hardly has any.

    Returns:
        Memory of the filter after so many ticks, true z, and the likeliest mode at every tick.
    """
    weights, model, base, z, _ = problem
    weights, z, rng = weights.copy(), z.copy(), np.random.default_rng(0)
    weights["from_condition"][:, 5:9] *= 5.0
    z[NOISE:] = 0.0
    states = (0.02 * model.increment) ** 2
    Q = np.diag(np.r_[states, 1e-6, np.zeros(5), 1.0 - model.noise_keep**2, np.full(5, 1e-14)])
    model = model._replace(settings=OFF, Q=Q, modes=MODES)
    known = np.r_[(0.01 * model.state_scale) ** 2, 0.1, np.full(5, 0.04**2), np.ones(3), np.full(5, 1e-12)]
    twin, memory = machine((weights, model, base, z, np.diag(known)))
    room, said, y = scratch(weights, PARTS), np.zeros(1, said_type(PARTS)), np.empty(3)
    likeliest = []
    for k in range(ticks):
        predict_mean(weights[0], twin["filter"][0], base, z, room[0]["filter"])
        z[:5] += 0.02 * model.increment * rng.normal(size=5)
        z[ZETA + (leaps or 0)] += size if k == BEGIN and leaps is not None else 0.0
        readings(twin["filter"][0], z, y)
        measured = y + WHITE * rng.normal(size=3)
        measured[fails or 0] += size if k >= BEGIN and fails is not None else 0.0
        query, at_once = np.zeros(5, np.float32), np.zeros(3)
        arguments = (query, measured, at_once, WHITE, np.zeros(3), 6.0, said[0], room["filter"][0])
        tick(weights[0], twin["filter"][0], memory[0], *arguments)
        likeliest.append(int(memory["modes"]["mu"][0].argmax()))
    return memory[0], z, likeliest, said


def test_where_nothing_happens_health_stands_still(problem):
    memory, z, likeliest, _ = watched(problem)
    assert np.mean(np.array(likeliest) == 0) > 0.95
    assert memory["z"][ZETA:NOISE] == pytest.approx(z[ZETA:NOISE], abs=0.1)


def test_a_leap_of_the_bias_is_found_and_keeps_every_sensor_in(problem):
    memory, z, likeliest, said = watched(problem, leaps=BIAS - ZETA, size=5.0)
    assert 0 not in likeliest[BEGIN + 10 : BEGIN + 30]
    assert set(likeliest[BEGIN:]) - {0} == {LEAPS + BIAS - ZETA}
    assert said["accepted"].all()
    assert memory["z"][ZETA:NOISE] == pytest.approx(z[ZETA:NOISE], abs=0.2)


@pytest.mark.parametrize("output", FAILING)
def test_an_output_that_fails_is_found_and_left_out_and_health_stays(problem, output):
    memory, z, likeliest, said = watched(problem, fails=output, size=25.0 * WHITE[output], ticks=320)
    assert set(likeliest[BEGIN + 10 : BEGIN + 200]) == {FAILS + len(FAILING) + FAILING.index(output)}
    assert said["accepted"][0].tolist() == [c != output for c in range(3)]
    assert said["flags"][0] & FLAG_GATED
    assert memory["z"][ZETA:NOISE] == pytest.approx(z[ZETA:NOISE], abs=0.2)


def test_what_is_told_is_the_mixture_of_the_modes(problem):
    memory, *_ = watched(problem, leaps=BIAS - ZETA, size=2.0, ticks=110)
    modes = memory["modes"]
    assert modes["mu"].sum() == pytest.approx(1.0)
    assert memory["z"] == pytest.approx(modes["mu"] @ modes["z"])
    off = modes["z"] - memory["z"]
    spread = np.einsum("k,kij->ij", modes["mu"], modes["P"] + off[:, :, None] * off[:, None, :])
    assert memory["P"] == pytest.approx(spread, rel=1e-9, abs=1e-12)


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
        moves.append(np.abs(memory["z"][0, ZETA:NOISE] - before).max() > 1e-12)
    begins, ends = 10 + round(UNKNOWN_S / SAMPLE_PERIOD_S), 10 + lost + held
    if channel == 5:  # none of the query's
        assert all(moves)
    else:
        assert moves[begins - 2]
        assert not any(moves[begins + 1 : ends - 1])
        assert all(moves[ends + 1 :])


def test_while_the_query_is_unknown_nothing_slow_is_corrected(problem):
    _, model, _, z, P = problem
    safety = empty_safety(PARTS, 1)
    safety["unknown"] = 100
    for _ in range(10):
        before = z.copy()
        z, P, *_ = corrected(problem, safety, z, P, off_by(z, 40.0), WHITE, COLOURED, 6.0)
        assert np.array_equal(z[model.slow], before[model.slow])
        assert (z[~model.slow] != before[~model.slow]).all()
    assert np.linalg.eigvalsh(P)[0] > 0.0


def test_while_the_query_is_unknown_the_states_may_go_anywhere(problem):
    known, unknown = (ticked(problem, NOTHING_READ, unknown=left)[1] for left in (0, 3))
    more = np.diag(unknown - known)
    assert more[:5] == pytest.approx((WANDERING * problem[1].increment) ** 2)
    assert np.abs(more[5:]).max() < 1e-15


def test_an_output_that_very_likely_fails_is_flagged(problem):
    for mode, flagged in ((0, False), (FAILS + 1, True)):
        twin_problem = (problem[0], problem[1]._replace(modes=MODES), *problem[2:])
        said = ticked(twin_problem, NOTHING_READ, mode=mode)[2]
        assert bool(said["flags"][0] & FLAG_GATED) == flagged
