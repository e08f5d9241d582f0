"""The augmented filter: its Jacobian, its probe, its open loop, and the textbook around them."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from data.batch import SAMPLE_PERIOD_S
from methods.augmented import (
    ERROR,
    NOISE,
    PROBE,
    SIZE,
    ZETA,
    Model,
    correct,
    predict,
    predict_mean,
    roll_out,
    tick,
)
from methods.operator import Operator
from methods.safeguards import (
    FROZEN,
    INFLATION_UPDATES,
    INSIDE_LEAST,
    OUTSIDE_MOST,
    UPDATES,
    Envelope,
    Safety,
    Settings,
    empty_safety,
)
from methods.stream import Stream, empty_stream, pack
from methods.training import weights_of
from physics.compressor import M_REF_KG_S
from physics.health import theta_and_slope

OFF = Settings(
    trust_reach=np.inf, extrapolation=0.0, least_information=0.0, q_gain=0.0, q_most=30.0, r_gain=0.0, r_most=25.0,
    channel_gate=np.inf, rollback=False, inflation=1.0, difference=0.0,
)  # fmt: skip
"""No safeguard at all: the plain augmented filter."""


def one_safety():
    """The memory of one machine."""
    return Safety(*(part[0] for part in empty_safety(1)))


@pytest.fixture(scope="module")
def problem():
    torch.manual_seed(1)
    weights = pack(weights_of(Operator()))
    rng = np.random.default_rng(0)
    A = rng.normal(size=(SIZE, SIZE)) * 1e-3
    model = Model(
        state_mean=np.array([0.92, 3.2, 440.0, 352.0, 0.9]),
        state_scale=np.array([0.07, 0.7, 32.0, 11.0, 0.19]),
        increment=np.array([0.003, 0.0065, 0.53, 0.0023, 0.0083]),
        Q=A @ A.T,
        noise_keep=np.array([0.88, 0.98, 0.92]),
        error_keep=0.999,
        zeta_low=np.full(5, -10.0),
        zeta_high=np.full(5, 10.0),
        settings=OFF,
        envelope=Envelope(np.full(5, -3.0), np.full(5, 3.0)),
    )
    z = np.concatenate([model.state_mean, [435.0], rng.normal(size=SIZE - 6) * 0.1])
    B = rng.normal(size=(SIZE, SIZE))
    base = rng.normal(size=weights.encoder.from_latent_bias.size).astype(np.float32)
    return weights, model, base, z, B @ B.T * 1e-4


def test_prediction_propagates_the_covariance_with_the_true_jacobian(problem):
    """P after equals F P F' + Q with F from central differences of the forecast alone."""
    weights, model, base, z, P = problem
    size = np.concatenate([model.state_scale, [32.0], np.ones(8), model.increment]) * 0.02
    F = np.empty((SIZE, SIZE))
    for j in range(SIZE):
        ahead, behind = z.copy(), z.copy()
        ahead[j] += size[j]
        behind[j] -= size[j]
        ends = [predict_mean(weights.heads, model, base, at) for at in (ahead, behind)]
        F[:, j] = (ends[0] - ends[1]) / (2 * size[j])
    after, P_after, slope = predict(weights.heads, model, base, z, P, 0.0, np.zeros(5), 1.0)
    assert after == pytest.approx(predict_mean(weights.heads, model, base, z), abs=1e-6)
    assert slope == pytest.approx(F, abs=1e-2)
    expected = F @ P @ F.T + model.Q
    scale = np.sqrt(np.outer(np.diag(expected), np.diag(expected)))
    assert np.abs((P_after - expected) / scale).max() < 2e-3


def test_the_probe_is_a_first_order_lag_that_quickens_with_flow(problem):
    weights, model, base, z, _ = problem
    z = z.copy()
    for flow in (0.5, 1.0, 1.5):
        z[4] = flow
        share = (predict_mean(weights.heads, model, base, z)[PROBE] - z[PROBE]) / (z[2] - z[PROBE])
        assert share == pytest.approx(1 - np.exp(-SAMPLE_PERIOD_S / (5.0 * flow**-0.5)))


def test_health_stays_and_slow_errors_act(problem):
    weights, model, base, z, _ = problem
    after = predict_mean(weights.heads, model, base, z)
    assert np.array_equal(after[ZETA:NOISE], z[ZETA:NOISE])
    assert after[ERROR:] == pytest.approx(model.error_keep * z[ERROR:])
    without = z.copy()
    without[ERROR:] = 0.0
    assert after[:5] - predict_mean(weights.heads, model, base, without)[:5] == pytest.approx(z[ERROR:])


def test_correction_is_the_textbook(problem):
    _, model, _, z, P = problem
    white, coloured = np.array([0.012, 0.6, 1e-3]), np.array([0.008, 0.4, 6e-4])
    measured = np.array([z[1] + 0.01, z[PROBE] + 1.0, M_REF_KG_S * z[4]])
    theta, slopes = theta_and_slope(z[ZETA:NOISE])
    bias, slope = theta[4], slopes[4]
    H = np.zeros((3, SIZE))
    H[0, 1] = H[1, PROBE] = 1.0
    H[1, ZETA + 4] = slope
    H[2, 4] = M_REF_KG_S
    H[range(3), range(NOISE, NOISE + 3)] = coloured
    S = H @ P @ H.T + np.diag(white**2)
    K = P @ H.T @ np.linalg.inv(S)
    r = measured - np.array([z[1], z[PROBE] + bias, M_REF_KG_S * z[4]]) - coloured * z[NOISE : NOISE + 3]
    z1, P1, innovation, used, S1, nis = correct(model, one_safety(), z, P, measured, white, coloured, np.inf)
    assert used == pytest.approx(innovation)
    assert innovation == pytest.approx(r)
    assert S1 == pytest.approx(S)
    assert z1 == pytest.approx(z + K @ r)
    assert P1 == pytest.approx((np.eye(SIZE) - K @ H) @ P, abs=1e-12)
    assert nis == pytest.approx(r @ np.linalg.inv(S) @ r)


WHITE, COLOURED = np.array([0.012, 0.6, 1e-3]), np.array([0.008, 0.4, 6e-4])


def off_by(z: np.ndarray, sd: float) -> np.ndarray:
    """Readings that lie so many standard deviations of the sensors above what is expected."""
    bias = theta_and_slope(z[ZETA:NOISE])[0][4]
    return np.array([z[1], z[PROBE] + bias, M_REF_KG_S * z[4]]) + COLOURED * z[NOISE:ERROR] + sd * WHITE


def test_an_inconsistent_spell_leaves_health_where_it_was_and_lets_it_move_faster_afterwards(problem):
    _, model, _, z, P = problem
    guarded = model._replace(settings=OFF._replace(rollback=True, inflation=4.0))
    safety = one_safety()
    z, P = z.copy(), 1e-4 * np.eye(SIZE)
    for _ in range(3):
        z, P, *_ = correct(guarded, safety, z, P, off_by(z, 0.3), WHITE, COLOURED, np.inf)
    valid, sd = z[ZETA:NOISE].copy(), np.sqrt(np.diag(P)[ZETA:NOISE])
    for k in range(OUTSIDE_MOST + 3):
        moved, P, *_ = correct(guarded, safety, z, P, off_by(z, 40.0), WHITE, COLOURED, np.inf)
        assert (moved[:5] != z[:5]).any()
        z = moved
        if k >= OUTSIDE_MOST - 1:
            assert safety.counts[FROZEN] > 0
            assert z[ZETA:NOISE] == pytest.approx(valid, abs=1e-12)
    for _ in range(INSIDE_LEAST):
        z, P, *_ = correct(guarded, safety, z, P, off_by(z, 0.0), WHITE, COLOURED, np.inf)
    assert safety.counts[FROZEN] == 0
    z, P, *_ = correct(guarded, safety, z, P, off_by(z, 0.0), WHITE, COLOURED, np.inf)
    assert np.sqrt(P[ZETA, ZETA]) > 1.1 * sd[0]
    for _ in range(INFLATION_UPDATES):
        z, P, *_ = correct(guarded, safety, z, P, off_by(z, 0.0), WHITE, COLOURED, np.inf)
    assert np.sqrt(P[ZETA, ZETA]) == pytest.approx(4.0 * sd[0], rel=0.1)


def test_directions_of_which_nothing_is_known_are_not_corrected(problem):
    _, model, _, z, P = problem
    guarded = model._replace(settings=OFF._replace(least_information=1e12))
    safety = one_safety()
    safety.observable[:] = 0.0
    corrected, after, *_ = correct(guarded, safety, z, P, off_by(z, 3.0), WHITE, COLOURED, np.inf)
    assert np.array_equal(corrected[ZETA:NOISE], z[ZETA:NOISE])
    assert (corrected[:5] != z[:5]).any()
    assert np.diag(after)[ZETA:NOISE] == pytest.approx(np.minimum(np.diag(P)[ZETA:NOISE], 1.0))


def test_noise_beyond_the_data_sheet_widens_r(problem):
    _, model, _, z, P = problem
    guarded = model._replace(settings=OFF._replace(r_gain=1.0))
    safety = one_safety()
    safety.counts[UPDATES] = 5000
    safety.mismatch[:] = 9.0 * np.diag(WHITE**2)
    *_, S, _ = correct(model, one_safety(), z, P, off_by(z, 0.0), WHITE, COLOURED, np.inf)
    *_, wide, _ = correct(guarded, safety, z, P, off_by(z, 0.0), WHITE, COLOURED, np.inf)
    assert np.diag(wide - S) / WHITE**2 == pytest.approx(np.full(3, 8.0), rel=0.05)


def test_a_channel_far_off_is_left_out_of_the_correction_and_of_the_nis(problem):
    _, model, _, z, P = problem
    guarded = model._replace(settings=OFF._replace(channel_gate=5.0))
    measured = off_by(z, 0.5)
    broken = measured.copy()
    broken[2] += 1.0
    missing = np.where(np.arange(3) == 2, np.nan, measured)
    got = correct(guarded, one_safety(), z, P, broken, WHITE, COLOURED, np.inf)
    expected = correct(guarded, one_safety(), z, P, missing, WHITE, COLOURED, np.inf)
    assert np.isnan(got[3][2])
    assert np.isfinite(got[2][2])
    for ours, theirs in zip((*got[:2], *got[4:]), (*expected[:2], *expected[4:]), strict=True):
        assert np.array_equal(ours, theirs)


def test_untrusted_sensitivities_carry_no_news_to_health_and_the_forecast_is_less_sure(problem):
    weights, model, base, z, P = problem
    cautious = model._replace(settings=OFF._replace(trust_reach=1.0, extrapolation=1.0))
    _, near, F_near = predict(weights.heads, cautious, base, z, P, 0.0, np.zeros(5), 1.0)
    _, far, F_far = predict(weights.heads, cautious, base, z, P, 3.0, np.zeros(5), 1.0)
    assert F_far[:5, ZETA : ZETA + 4] == pytest.approx(0.1 * F_near[:5, ZETA : ZETA + 4])
    assert (np.diag(far)[ERROR:] > np.diag(near)[ERROR:]).all()


def test_what_is_pushed_one_way_walks_faster(problem):
    weights, model, base, z, P = problem
    quick = model._replace(settings=OFF._replace(q_gain=1.0))
    push = np.array([1.0, 0.0, 0.0, 0.0, 0.0])
    calm = predict(weights.heads, quick, base, z, P, 0.0, np.zeros(5), 1.0)[1]
    pushed = predict(weights.heads, quick, base, z, P, 0.0, push, 1.0)[1]
    more = np.diag(pushed - calm)
    assert more[ZETA] == pytest.approx((OFF.q_most - 1.0) * model.Q[ZETA, ZETA], rel=1e-6)
    assert np.abs(np.delete(more, ZETA)).max() < 1e-12


def test_sensitivities_by_differences_are_nearly_the_derivatives(problem):
    weights, model, base, z, P = problem
    by_differences = model._replace(settings=OFF._replace(difference=0.01))
    F, G = (predict(weights.heads, m, base, z, P, 0.0, np.zeros(5), 1.0)[2] for m in (model, by_differences))
    assert G != pytest.approx(F, abs=1e-7)
    assert pytest.approx(F, abs=0.02) == G


def test_health_is_held_within_its_coordinates(problem):
    _, model, _, z, P = problem
    z = z.copy()
    z[ZETA] = 50.0
    measured = np.array([z[1], z[PROBE], M_REF_KG_S * z[4]])
    corrected, *_ = correct(model, one_safety(), z, P, measured, np.ones(3), np.ones(3), 6.0)
    assert corrected[ZETA] <= 10.0


def test_open_loop_reads_inputs_only_and_is_batch_equal(problem):
    weights, model, _, z, _ = problem
    rng = np.random.default_rng(3)
    stream = empty_stream(weights, 2)
    for part in stream[1:]:
        part[:] = rng.normal(size=part.shape)
    inputs = np.array([0.95, 298.0, 1350.0, 0.64]) * (1 + 0.01 * rng.normal(size=(2, 40, 4)))
    mean = np.array([0.95, 298.0, 1350.0, 0.64, 3.1, 430.0, 0.12])
    query = np.array([1350.0, 3.3, 298.0, 0.95, 0.64])
    scaling = (mean, 0.1 * mean, query, 0.1 * query)
    states = np.stack([z, z * 1.001])
    out = np.empty((2, 40, 3))
    copy = Stream(*(part.copy() for part in stream))
    roll_out(weights, model, scaling, copy, states, inputs, np.array([0.0, 2.0]), out)
    single = np.empty((1, 40, 3))
    one = Stream(*(part[1:].copy() for part in stream))
    roll_out(weights, model, scaling, one, states[1:], inputs[1:], np.array([2.0]), single)
    assert np.array_equal(out[1], single[0])
    assert np.isfinite(out).all()


WHITE, COLOURED = np.array([0.012, 0.6, 1e-3]), np.array([0.008, 0.4, 6e-4])


def ticked(problem, measured, lag):
    """z, P and diagnostics after a tick of one machine whose outputs (3,) were read ``lag`` (3,) ticks ago."""
    weights, model, base, z, P = problem
    stream = empty_stream(weights, 1)
    stream.ticks[:], stream.base[0] = 1, base
    z, P, one = z[None].copy(), P[None].copy(), (lambda *values: np.array([values]))
    info = (np.empty((1, 3)), np.empty((1, 3, 3)), np.empty(1), np.empty((1, 3), bool), np.empty(1, np.int64))
    still = (np.zeros((1, 7), np.float32), np.ones((1, 7), np.float32), np.zeros((1, 5), np.float32))
    tick(weights, model, stream, empty_safety(1), z, P, *still, one(*measured), one(*lag), WHITE[None], COLOURED[None],
         6.0, info)  # fmt: skip
    return z[0], P[0], info


def read(problem):
    """Readings near the machine of ``problem``."""
    z = problem[3]
    return np.array([z[1] + 0.01, z[PROBE] + 0.5, M_REF_KG_S * z[4] + 5e-4])


def by_hand(problem, *steps):
    """z and P after predictions over parts of a tick and corrections with some channels, in that order."""
    weights, model, base, z, P = problem
    safety = one_safety()
    for step in steps:
        if isinstance(step, float):
            z, P, _ = predict(weights.heads, model, base, z, P, 0.0, np.zeros(5), step)
        else:
            z, P, *_ = correct(model, safety, z, P, np.array(step), WHITE, COLOURED, 6.0)
    return z, P


def test_what_was_read_within_half_a_tick_counts_as_read_at_it(problem):
    y = read(problem)
    at_once, a_little_late = (ticked(problem, y, lag) for lag in ((0.0, 0.0, 0.0), (0.5, 0.2, 0.4)))
    assert np.array_equal(at_once[0], a_little_late[0])
    assert at_once[0] == pytest.approx(by_hand(problem, 1.0, y)[0])


def test_what_was_read_late_corrects_at_its_own_time(problem):
    p, T, m = read(problem)
    z, P, (innovation, S, nis, accepted, _) = ticked(problem, (p, T, m), (0.0, 0.75, 0.9))
    nan = np.nan
    expected = by_hand(problem, 1.0 - 0.9, [nan, nan, m], 0.9 - 0.75, [nan, T, nan], 0.75, [p, nan, nan])
    assert z == pytest.approx(expected[0])
    assert P == pytest.approx(expected[1])
    assert accepted.all()
    assert np.isfinite(innovation).all()
    off = S[0] - np.diag(np.diag(S[0]))
    assert not off.any()
    assert nis[0] == pytest.approx(np.sum(innovation[0] ** 2 / np.diag(S[0])))


def test_a_reading_as_old_as_the_last_tick_corrects_before_the_forecast(problem):
    y = read(problem)
    nothing = [np.nan] * 3
    z, P, _ = ticked(problem, y, (1.0, 1.0, 1.0))
    expected = by_hand(problem, y, 1.0, nothing)
    assert z == pytest.approx(expected[0])
    assert P == pytest.approx(expected[1])


def test_a_reading_older_than_the_last_tick_is_left_out(problem):
    p, T, m = read(problem)
    z, _, info = ticked(problem, (p, T, m), (0.0, 1.2, 0.0))
    assert z == pytest.approx(by_hand(problem, 1.0, [p, np.nan, m])[0])
    assert info[3].tolist() == [[True, False, True]]
