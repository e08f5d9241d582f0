"""Interacting multiple models against filterpy's, what modes are for, and what hindsight adds."""

from __future__ import annotations

import numpy as np
import pytest
from filterpy.kalman import IMMEstimator, KalmanFilter

from twinbench.baselines.oracle import Oracle
from twinbench.baselines.oracle_smoother import OracleSmoother
from twinbench.bench.contract.subject import record, small_benchmark
from twinbench.data.corrupt import Corruption, corrupt
from twinbench.machines.compressor import COMPRESSOR
from twinbench.methods.estimator import FLAG_GATED
from twinbench.methods.mixing import linear_modes, merge_into, mix, weigh_afterwards
from twinbench.methods.modes import (
    FAILED_S,
    FAILS_EVERY_S,
    NEXT,
    STAY_S,
    Modes,
    at_first,
    chain,
    in_the_long_run,
    modes_of,
    pools_of,
)
from twinbench.physics.compressor import PLANT
from twinbench.physics.integrate import Varying, simulate

CHANNELS, HEALTH = COMPRESSOR.channels, COMPRESSOR.health_names
LEAPS_AT = 1600
FIRST = slice(0, 1)


def linear_machine(seed):
    rng = np.random.default_rng(seed)
    n, m = 4, 3
    F = 0.95 * np.linalg.qr(rng.normal(size=(n, n)))[0]
    H, q, p = rng.normal(size=(m, n)), rng.normal(size=(n, n)), rng.normal(size=(n, n))
    Q = q @ q.T
    return F, H, np.stack([0.01 * Q, 0.1 * Q, 2.0 * Q]), np.diag([0.5, 0.2, 1.0]), np.zeros(n), p @ p.T


@pytest.mark.parametrize("seed", range(3))
def test_modes_that_differ_give_what_filterpy_gives(seed):
    F, H, Q, R, x0, P0 = linear_machine(seed)
    filters = []
    for each in Q:
        one = KalmanFilter(len(x0), len(R))
        one.x, one.P, one.F, one.H, one.Q, one.R = x0.copy(), P0.copy(), F, H, each, R
        filters.append(one)
    turn = chain(1, 0, 0.05)
    peer = IMMEstimator(filters, np.full(3, 1 / 3), turn)
    measured = 0.3 * np.random.default_rng(seed).normal(size=(150, 3))  # no outliers, since their weight is bounded
    means, covs = linear_modes(F, H, Q, R, x0, P0, turn)(measured)
    for y, mean, cov in zip(measured, means, covs, strict=True):
        peer.predict()
        peer.update(y)
        np.testing.assert_allclose(mean, peer.x, rtol=1e-8, atol=1e-9)
        np.testing.assert_allclose(cov, peer.P, rtol=1e-8, atol=1e-9)


@pytest.mark.parametrize(("parameters", "failing"), [(1, 0), (2, 1), (5, 2)])
def test_the_chain_goes_somewhere_and_stays_as_long_as_it_says(parameters, failing):
    turn = chain(parameters, failing, 0.05)
    np.testing.assert_allclose(turn.sum(axis=1), 1.0)
    assert (turn >= 0.0).all()
    moving, own = slice(1 + 2 * parameters), np.repeat([0.0, NEXT[1, 1] / parameters, 0.0], (1, parameters, parameters))
    # What ends may begin again as it was, and anything ends where an output fails.
    leaves = 0.05 / np.repeat(STAY_S, (1, parameters, parameters)) * (1.0 - own)
    begins = 2 * failing * 0.05 / FAILS_EVERY_S
    np.testing.assert_allclose(1.0 - np.diagonal(turn)[moving], leaves * (1.0 - begins) + begins)
    fails, mended = slice(moving.stop, moving.stop + 2 * failing), slice(moving.stop + 2 * failing, None)
    np.testing.assert_allclose(0.05 / (1.0 - np.diagonal(turn)[fails]), FAILED_S)
    np.testing.assert_allclose(turn[fails, mended], 0.05 / FAILED_S * np.tile(np.eye(failing), (2, 1)))
    np.testing.assert_array_equal(turn[mended], np.eye(len(turn))[[0] * failing])  # an output is mended once
    usual = in_the_long_run(turn)
    np.testing.assert_allclose(usual @ turn, usual, atol=1e-12)


@pytest.mark.parametrize("tick_s", [1e-3, 60.0, 7200.0])
def test_however_long_a_tick_is_the_chain_has_probabilities(tick_s):
    turn = chain(4, 3, tick_s)
    np.testing.assert_allclose(turn.sum(axis=1), 1.0)
    assert (turn >= 0.0).all()
    assert (turn.sum(axis=0) > 0.0).all()


def test_a_machines_modes_are_one_for_each_way_to_change():
    modes = modes_of(COMPRESSOR, 1.0, 0.1, 2.0)
    walk, out, turn, lasts = modes.walk, modes.out, modes.turn, modes.lasts
    parameters, failing = len(HEALTH), int(out.sum()) // 2
    assert len(walk) == len(out) == len(turn) == len(lasts) == 1 + 2 * parameters + 3 * failing
    faster = walk > 1.5 * walk[0]
    np.testing.assert_array_equal(faster.sum(axis=1), [0] + [1] * (2 * parameters) + [0] * (3 * failing))
    np.testing.assert_array_equal(out.sum(axis=1), [0] * (1 + 2 * parameters) + [1] * (2 * failing) + [0] * failing)
    np.testing.assert_array_equal(np.flatnonzero(lasts), 1 + 2 * parameters + failing + np.arange(failing))
    mu = at_first(modes)
    assert mu.sum() == pytest.approx(1.0)
    assert (mu > 0.0).all()
    assert (mu @ out).max() < 1e-4, "no sensor fails before it has been read"
    assert (faster.sum(axis=0) == 2).all()
    reads = [reading.bias for reading in COMPRESSOR.readings]
    assert [bool(c) for c in out.sum(axis=0)] == [not bias for bias in reads]


def test_a_mixtures_moments_are_those_of_draws_from_it():
    rng = np.random.default_rng(0)
    mu, z, P = np.array([0.2, 0.8]), np.array([[0.0, 1.0], [2.0, -1.0]]), np.stack([np.eye(2), 0.5 * np.eye(2)])
    which = rng.random(200_000) < mu[1]
    draws = np.where(which[:, None], z[1], z[0]) + rng.normal(size=(200_000, 2)) * np.where(which, 0.5**0.5, 1)[:, None]
    mean, cov = np.empty(2), np.empty((2, 2))
    merge_into(mu, z, P, mean, cov)
    np.testing.assert_allclose(mean, draws.mean(axis=0), atol=0.02)
    np.testing.assert_allclose(cov, np.cov(draws.T), atol=0.02)


@pytest.mark.parametrize(
    "turn", [chain(5, 2, 0.05), chain(1, 0, 60.0), np.random.default_rng(0).dirichlet(np.ones(4), 4)]
)
def test_mixing_pool_by_pool_is_mixing_one_by_one(turn):
    rng, count = np.random.default_rng(1), len(turn)
    mu, z, P = rng.dirichlet(np.ones(count)), rng.normal(size=(count, 3)), rng.normal(size=(count, 3, 3))
    P = P @ P.swapaxes(1, 2)
    nothing = np.zeros((count, 1))
    pools, pool = pools_of(turn)
    ahead, _, means, covs = mix(mu, Modes(nothing, nothing, turn, pools, pool, nothing[:, 0], 0.0), z, P)
    joint = mu[:, None] * turn
    np.testing.assert_allclose(ahead, joint.sum(axis=0))
    for weight, mean, cov in zip((joint / ahead).T, means, covs, strict=True):
        off = z - weight @ z
        np.testing.assert_allclose(mean, weight @ z, rtol=1e-9, atol=1e-12)
        expected = np.einsum("k,kij->ij", weight, P + off[:, :, None] * off[:, None, :])
        np.testing.assert_allclose(cov, expected, rtol=1e-9, atol=1e-12)


def test_modes_that_are_come_to_alike_share_a_pool():
    _, pool = pools_of(chain(5, 2, 0.05))
    assert pool.tolist() == [0] + [1] * 5 + [2] * 5 + [3] * 4 + [4, 5]


def test_a_leap_is_followed_sooner_than_by_a_walk_alone():
    """A constant that leaps: with a mode for leaps the estimate is there in a tenth of the time."""
    one, walk = np.eye(1), np.array([1e-6, 1e-4, 0.2])[:, None, None]
    y = np.random.default_rng(1).normal(size=(800, 1))
    y[400:] += 20.0
    modes, alone = (
        linear_modes(one, one, Q, one, np.zeros(1), one, chain(1, 0, 0.05))(y)[0][:, 0]
        for Q in (walk, np.repeat(walk[1:2], 3, axis=0))
    )
    assert abs(modes[430] - 20.0) < 2.0
    assert abs(alone[430] - 20.0) > 10.0


def test_afterwards_the_modes_of_a_chain_are_what_forward_and_backward_sums_say():
    """Of a chain that is seen through independent noise: the textbook's forward-backward algorithm, in plain numpy."""
    rng = np.random.default_rng(4)
    turn = np.array([[0.9, 0.08, 0.02], [0.1, 0.85, 0.05], [0.3, 0.3, 0.4]])
    likelihood = rng.uniform(0.1, 1.0, size=(40, 3))
    forwards, backwards = np.empty((40, 3)), np.ones((40, 3))
    ahead = np.full(3, 1 / 3)
    for k in range(40):
        forwards[k] = ahead * likelihood[k] / (ahead * likelihood[k]).sum()
        ahead = forwards[k] @ turn
    for k in range(38, -1, -1):
        backwards[k] = turn @ (likelihood[k + 1] * backwards[k + 1])
    both = forwards * backwards
    mu = forwards.copy()
    weigh_afterwards(mu, turn)
    np.testing.assert_allclose(mu, both / both.sum(axis=1, keepdims=True), rtol=1e-10)


@pytest.fixture(scope="module")
def oracle():
    estimator = OracleSmoother()
    estimator.fit(small_benchmark().train, small_benchmark().validation, 0)
    return estimator


def machine(parameter="", size=0.0):
    """Readings (1, 2400, 7) and health of the first test machine, one parameter of which leaps by ``size``."""
    truth = small_benchmark().test.truth
    health = np.tile(truth.health[FIRST, :1], (1, 2400, 1))
    if parameter:
        health[:, LEAPS_AT:, HEALTH.index(parameter)] += size
    u = truth.inputs[FIRST]
    u, health = u[:, : health.shape[1]], health[:, : u.shape[1]]
    _, y = simulate(PLANT, u, truth.states[0, 0], varying=Varying(HEALTH, health))
    return corrupt(COMPRESSOR, u[0], y[0], Corruption(), np.random.default_rng(3))[None], health


@pytest.mark.parametrize(("parameter", "size", "off"), [("capacity", -0.06, 0.02), ("T_bias_K", 4.0, 1.5)])
def test_a_leap_is_followed_within_seconds(oracle, parameter, size, off):
    readings, _ = machine(parameter, size)
    said = record(oracle, readings)
    at = 5 + HEALTH.index(parameter)
    before, after = (said.mean[k, 0, at] for k in (LEAPS_AT - 1, LEAPS_AT + 400))
    assert after - before == pytest.approx(size, abs=off)
    settled = slice(100, None)  # before, neither states nor health are known, and a sensor may be doubted for a second
    assert not (said.flags[settled] & FLAG_GATED).any(), "no sensor was to blame"


def test_without_leaps_it_lags(oracle):
    readings, health = machine("capacity", -0.06)
    still = Oracle(leap=1e-6)
    still.arrays = oracle.arrays
    still.restore()
    late = slice(LEAPS_AT + 200, None)
    wrong = [np.abs(record(e, readings).mean[late, 0, 5] - health[0, late, 0]).mean() for e in (oracle, still)]
    assert wrong[0] < 0.7 * wrong[1]


@pytest.mark.parametrize("channel", ["p_dis_bar", "m_flow_kg_s"])
def test_a_sensor_that_fails_is_left_out_until_it_fits_again(oracle, channel):
    readings, health = machine()
    c = CHANNELS.index(channel)
    faulty = readings.copy()
    rng = np.random.default_rng(5)
    fault = slice(LEAPS_AT - 600, LEAPS_AT - 100)
    faulty[:, fault, c] *= 1.0 + 0.2 * rng.normal(size=500)  # noise that no data sheet has
    said, sane = record(oracle, faulty), record(oracle, readings)
    out = ~said.accepted[:, 0, c - 4]
    assert out[LEAPS_AT - 350 : LEAPS_AT - 120].mean() > 0.95
    assert (said.flags[LEAPS_AT - 350 : LEAPS_AT - 120] & FLAG_GATED).any()
    assert out[LEAPS_AT + 100 :].mean() < 0.1
    typical = np.array([v.scale for v in PLANT.parameters[:5]])
    off, usual = (np.abs(each.mean[-200:, 0, 5:] - health[:, -1]) / typical for each in (said, sane))
    assert off.mean() < usual.mean() + 1.0


@pytest.mark.parametrize("channel", ["p_dis_bar", "m_flow_kg_s"])
@pytest.mark.parametrize("creeps", [False, True])
def test_a_sensor_that_is_off_by_six_sd_is_left_out_even_where_that_crept_in(oracle, channel, creeps):
    readings, health = machine()
    c, off_by = CHANNELS.index(channel), 0.03 * np.linspace(0.0, 1.0, 800) ** creeps  # of the reading: six sd of noise
    faulty = readings.copy()
    faulty[:, 1000:1800, c] *= 1.0 + off_by
    said, sane = record(oracle, faulty), record(oracle, readings)
    out = ~said.accepted[:, 0, c - 4]
    assert out[1600:1790].mean() > 0.95
    assert out[1900:].mean() < 0.1
    typical = np.array([v.scale for v in PLANT.parameters[:5]])
    wrong, usual = (np.abs(each.mean[-200:, 0, 5:] - health[:, -1]) / typical for each in (said, sane))
    assert wrong.mean() < usual.mean() + 0.5


def test_hindsight_knows_when_health_leapt(oracle):
    readings, health = machine("capacity", -0.06)
    ticks = np.arange(readings.shape[1])
    known = oracle.smooth(readings, ticks)
    said = record(oracle, readings)
    near = slice(LEAPS_AT - 400, LEAPS_AT + 400)
    # The course of capacity; its level takes longer than two minutes to tell from leakage, either way.
    wrong = [(mean[near] - health[0, near, 0]).std() for mean in (known.mean[:, 5], said.mean[:, 0, 5])]
    assert wrong[0] < 0.7 * wrong[1]
    course = known.mean[near, 5]
    half = np.argmax(course < 0.5 * (course[0] + course[-1]))
    assert abs(half - 400) * COMPRESSOR.sample_period_s < 3.0
    variance = np.diagonal(known.cov, axis1=1, axis2=2)
    assert (variance > 0.0).all()
    assert np.median(variance[:, 5:] / np.diagonal(said.cov[:, 0], axis1=1, axis2=2)[:, 5:]) < 1.0


def test_the_oracle_has_no_delay(oracle):
    with pytest.raises(ValueError, match="looks at the whole recording, not 60 s ahead"):
        oracle.smooth(machine()[0], np.array([0]), 60.0)
