"""The augmented filter: its Jacobian, its probe, its open loop, and the textbook around them."""

from __future__ import annotations

import numpy as np
import pytest
from augmented_filter import (
    COLOURED,
    ERROR,
    HEALTH,
    NOISE,
    OFF,
    PARTS,
    PROBE,
    SIZE,
    WHITE,
    ZETA,
    corrected,
    kept,
    machine,
    off_by,
    ticked,
)

from twinbench.machines.compressor import COMPRESSOR
from twinbench.methods.deeponet_kalman.cycle import roll_out, scratch
from twinbench.methods.deeponet_kalman.forecast import predict, predict_mean, spread
from twinbench.methods.deeponet_kalman.model import room_type
from twinbench.methods.deeponet_kalman.safeguards import UPDATES, empty_safety
from twinbench.physics.compressor import M_REF_KG_S


def predicted(problem, z, P, away=0.0, push=(0.0,) * 5, part=1.0, model=None, walk=(0.0,) * 5):
    """z and P a tick ahead, and the Jacobian."""
    weights, _, base, *_ = problem
    z, P, room, own = z.copy(), P.copy(), np.zeros(1, room_type(weights, PARTS)), kept(problem, model)
    predict(weights[0], own, base, z, away, part, room[0])
    spread(own, P, np.array(walk), away, np.array(push), part, room[0])
    return z, P, room["F"][0]


def forecast(problem, z):
    """z a tick ahead by the forecast alone."""
    weights, _, base, *_ = problem
    z = z.copy()
    predict_mean(weights[0], kept(problem), base, z, np.zeros(1, room_type(weights, PARTS))[0])
    return z


def test_prediction_propagates_the_covariance_with_the_true_jacobian(problem):
    """P after equals F P F' + Q with F from central differences of the forecast alone."""
    _, model, _, z, P = problem
    size = np.concatenate([model.state_scale, [32.0], np.ones(8), model.increment]) * 0.02
    F = np.empty((SIZE, SIZE))
    for j in range(SIZE):
        ahead, behind = z.copy(), z.copy()
        ahead[j] += size[j]
        behind[j] -= size[j]
        ends = [forecast(problem, at) for at in (ahead, behind)]
        F[:, j] = (ends[0] - ends[1]) / (2 * size[j])
    after, P_after, slope = predicted(problem, z, P)
    assert after == pytest.approx(forecast(problem, z), abs=1e-6)
    assert slope == pytest.approx(F, abs=1e-2)
    expected = F @ P @ F.T + model.Q
    scale = np.sqrt(np.outer(np.diag(expected), np.diag(expected)))
    assert np.abs((P_after - expected) / scale).max() < 2e-3


def test_the_probe_is_a_first_order_lag_that_quickens_with_flow(problem):
    _, _, _, z, _ = problem
    z = z.copy()
    for flow in (0.5, 1.0, 1.5):
        z[4] = flow
        share = (forecast(problem, z)[PROBE] - z[PROBE]) / (z[2] - z[PROBE])
        assert share == pytest.approx(1 - np.exp(-COMPRESSOR.sample_period_s / (5.0 * flow**-0.5)))


def test_health_stays_and_slow_errors_act(problem):
    _, model, _, z, _ = problem
    after = forecast(problem, z)
    assert np.array_equal(after[ZETA:NOISE], z[ZETA:NOISE])
    assert after[ERROR:] == pytest.approx(model.error_keep * z[ERROR:])
    without = z.copy()
    without[ERROR:] = 0.0
    assert after[:5] - forecast(problem, without)[:5] == pytest.approx(z[ERROR:])


def test_correction_is_the_textbook(problem):
    _, _, _, z, P = problem
    white, coloured = np.array([0.012, 0.6, 1e-3]), np.array([0.008, 0.4, 6e-4])
    measured = np.array([z[1] + 0.01, z[PROBE] + 1.0, M_REF_KG_S * z[4]])
    theta, slopes = HEALTH.theta_and_slope(z[ZETA:NOISE])
    bias, slope = theta[4], slopes[4]
    H = np.zeros((3, SIZE))
    H[0, 1] = H[1, PROBE] = 1.0
    H[1, ZETA + 4] = slope
    H[2, 4] = M_REF_KG_S
    H[range(3), range(NOISE, NOISE + 3)] = coloured
    S = H @ P @ H.T + np.diag(white**2)
    K = P @ H.T @ np.linalg.inv(S)
    r = measured - np.array([z[1], z[PROBE] + bias, M_REF_KG_S * z[4]]) - coloured * z[NOISE : NOISE + 3]
    z1, P1, innovation, used, S1 = corrected(problem, empty_safety(PARTS, 1), z, P, measured, white, coloured, np.inf)
    assert used == pytest.approx(innovation)
    assert innovation == pytest.approx(r)
    assert S1 == pytest.approx(S)
    assert z1 == pytest.approx(z + K @ r)
    assert P1 == pytest.approx((np.eye(SIZE) - K @ H) @ P, abs=1e-12)


def test_directions_of_which_nothing_is_known_are_not_corrected(problem):
    _, model, _, z, P = problem
    guarded = model._replace(settings=OFF._replace(least_information=1e12))
    safety = empty_safety(PARTS, 1)
    safety["observable"] = 0.0
    moved, after, *_ = corrected(problem, safety, z, P, off_by(z, 3.0), WHITE, COLOURED, np.inf, guarded)
    assert np.array_equal(moved[ZETA:NOISE], z[ZETA:NOISE])
    assert (moved[:5] != z[:5]).any()
    assert np.diag(after)[ZETA:NOISE] == pytest.approx(np.minimum(np.diag(P)[ZETA:NOISE], 1.0))


def test_noise_beyond_the_data_sheet_widens_r(problem):
    _, model, _, z, P = problem
    guarded = model._replace(settings=OFF._replace(r_gain=1.0))
    safety = empty_safety(PARTS, 1)
    safety["counts"][0][UPDATES] = 5000
    safety["mismatch"] = 9.0 * np.diag(WHITE**2)
    *_, S = corrected(problem, empty_safety(PARTS, 1), z, P, off_by(z, 0.0), WHITE, COLOURED, np.inf)
    *_, wide = corrected(problem, safety, z, P, off_by(z, 0.0), WHITE, COLOURED, np.inf, guarded)
    assert np.diag(wide - S) / WHITE**2 == pytest.approx(np.full(3, 8.0), rel=0.05)


def test_a_channel_far_off_is_left_out_of_the_correction(problem):
    _, model, _, z, P = problem
    guarded = model._replace(settings=OFF._replace(channel_gate=5.0))
    measured = off_by(z, 0.5)
    broken = measured.copy()
    broken[2] += 1.0
    missing = np.where(np.arange(3) == 2, np.nan, measured)
    got = corrected(problem, empty_safety(PARTS, 1), z, P, broken, WHITE, COLOURED, np.inf, guarded)
    expected = corrected(problem, empty_safety(PARTS, 1), z, P, missing, WHITE, COLOURED, np.inf, guarded)
    assert np.isnan(got[3][2])
    assert np.isfinite(got[2][2])
    for ours, theirs in zip((*got[:2], *got[4:]), (*expected[:2], *expected[4:]), strict=True):
        assert np.array_equal(ours, theirs)


def test_untrusted_sensitivities_carry_no_news_to_health_and_the_forecast_is_less_sure(problem):
    _, model, _, z, P = problem
    cautious = model._replace(settings=OFF._replace(trust_reach=1.0, extrapolation=1.0))
    _, near, F_near = predicted(problem, z, P, model=cautious)
    _, far, F_far = predicted(problem, z, P, 3.0, model=cautious)
    assert F_far[:5, ZETA : ZETA + 4] == pytest.approx(0.1 * F_near[:5, ZETA : ZETA + 4])
    assert (np.diag(far)[ERROR:] > np.diag(near)[ERROR:]).all()


def test_what_is_pushed_one_way_walks_faster(problem):
    _, model, _, z, P = problem
    quick = model._replace(settings=OFF._replace(q_gain=1.0))
    push = np.array([1.0, 0.0, 0.0, 0.0, 0.0])
    walk = np.full(5, 1e-6)
    calm = predicted(problem, z, P, model=quick, walk=walk)[1]
    pushed = predicted(problem, z, P, 0.0, push, model=quick, walk=walk)[1]
    more = np.diag(pushed - calm)
    assert more[ZETA] == pytest.approx((OFF.q_most - 1.0) * walk[0], rel=1e-6)
    assert np.abs(np.delete(more, ZETA)).max() < 1e-12


def test_sensitivities_by_differences_are_nearly_the_derivatives(problem):
    _, model, _, z, P = problem
    by_differences = model._replace(settings=OFF._replace(difference=0.01))
    F, G = (predicted(problem, z, P, model=m)[2] for m in (model, by_differences))
    assert G != pytest.approx(F, abs=1e-7)
    assert pytest.approx(F, abs=0.02) == G


def test_health_is_held_within_its_coordinates(problem):
    _, _, _, z, P = problem
    z = z.copy()
    z[ZETA] = 50.0
    measured = np.array([z[1], z[PROBE], M_REF_KG_S * z[4]])
    moved, *_ = corrected(problem, empty_safety(PARTS, 1), z, P, measured, np.ones(3), np.ones(3), 6.0)
    assert moved[ZETA] <= 10.0


def test_open_loop_reads_inputs_only_and_is_batch_equal(problem):
    weights = problem[0]
    rng = np.random.default_rng(3)
    twin, memory = machine(problem, 2)
    for name in ("values", "columns", "first", "tokens", "scores"):
        memory["stream"][name] = rng.normal(size=memory["stream"][name].shape)
    memory["z"][1] *= 1.001
    inputs = np.array([0.95, 298.0, 1350.0, 0.64]) * (1 + 0.01 * rng.normal(size=(2, 40, 4)))
    out, single = np.empty((2, 40, 3)), np.empty((1, 40, 3))
    one = memory[1:].copy()
    roll_out(weights, twin, memory, inputs, out, scratch(weights, PARTS))
    roll_out(weights, twin, one, inputs[1:], single, scratch(weights, PARTS))
    assert np.array_equal(out[1], single[0])
    assert np.isfinite(out).all()


def same_covariance(P, expected):
    """Equal to 1e-6 of the products of standard deviations: the operator computes in single precision."""
    sd = np.sqrt(np.diag(expected))
    assert P / np.outer(sd, sd) == pytest.approx(expected / np.outer(sd, sd), rel=1e-6, abs=1e-6)


def read(problem):
    """Readings near the machine of ``problem``."""
    z = problem[3]
    return np.array([z[1] + 0.01, z[PROBE] + 0.5, M_REF_KG_S * z[4] + 5e-4])


def by_hand(problem, *steps):
    """z and P after predictions over parts of a tick and corrections with some channels, in that order."""
    _, _, _, z, P = problem
    safety = empty_safety(PARTS, 1)
    for step in steps:
        if isinstance(step, float):
            z, P, _ = predicted(problem, z, P, part=step)
        else:
            z, P, *_ = corrected(problem, safety, z, P, np.array(step), WHITE, COLOURED, 6.0)
    return z, P


def test_what_was_read_within_half_a_tick_counts_as_read_at_it(problem):
    y = read(problem)
    at_once, a_little_late = (ticked(problem, y, lag) for lag in ((0.0, 0.0, 0.0), (0.5, 0.2, 0.4)))
    assert np.array_equal(at_once[0], a_little_late[0])
    assert at_once[0] == pytest.approx(by_hand(problem, 1.0, y)[0])


def test_what_was_read_late_corrects_at_its_own_time(problem):
    p, T, m = read(problem)
    z, P, said = ticked(problem, (p, T, m), (0.0, 0.75, 0.9))
    nan = np.nan
    expected = by_hand(problem, 1.0 - 0.9, [nan, nan, m], 0.9 - 0.75, [nan, T, nan], 0.75, [p, nan, nan])
    assert z == pytest.approx(expected[0])
    same_covariance(P, expected[1])
    innovation, S = said["innovation"][0], said["S"][0]
    assert said["accepted"].all()
    assert np.isfinite(innovation).all()
    assert not (S - np.diag(np.diag(S))).any()
    assert said["nis"][0] == pytest.approx(np.sum(innovation**2 / np.diag(S)))


def test_a_reading_as_old_as_the_last_tick_corrects_before_the_forecast(problem):
    y = read(problem)
    nothing = [np.nan] * 3
    z, P, _ = ticked(problem, y, (1.0, 1.0, 1.0))
    expected = by_hand(problem, y, 1.0, nothing)
    assert z == pytest.approx(expected[0])
    same_covariance(P, expected[1])


def test_a_reading_older_than_the_last_tick_is_left_out(problem):
    p, T, m = read(problem)
    z, _, said = ticked(problem, (p, T, m), (0.0, 1.2, 0.0))
    assert z == pytest.approx(by_hand(problem, 1.0, [p, np.nan, m])[0])
    assert said["accepted"].tolist() == [[1, 0, 1]]
