"""Each safeguard alone: what it does, and that without it things would go wrong."""

from __future__ import annotations

import numpy as np
import pytest
from augmented_filter import OFF, PARTS
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats

from twinbench.machines.compressor import COMPRESSOR
from twinbench.methods.deeponet_kalman.safeguards import (
    CHANNEL,
    FAR_MOST,
    PUSHED,
    Envelope,
    bound_health,
    carry_sensitivity,
    distance,
    empty_safety,
    gather,
    informed,
    left_out,
    memories_of,
    noise_factor,
    note_mismatch,
    note_push,
    trust,
    walk_factor,
    widest_of,
)
from twinbench.methods.estimator import Z95
from twinbench.methods.kalman import gain, joseph

MEMORIES = memories_of(COMPRESSOR)
BOX = Envelope(np.full(5, -2.0), np.full(5, 2.0))


def covariance(seed: int, n: int = 8) -> np.ndarray:
    A = np.random.default_rng(seed).normal(size=(n, n))
    return A @ A.T


def projector_of(information: np.ndarray, least: float) -> np.ndarray:
    projector = np.empty((5, 5))
    informed(information, least, projector, np.empty((5, 10), np.complex128))
    return projector


def test_sensitivities_are_trusted_inside_the_envelope_and_less_and_less_outside():
    strength = OFF._replace(trust_reach=1.5)
    inside = np.array([1.9, -1.9, 0.0, 2.0, -2.0])
    assert distance(BOX, inside) == 0.0
    assert trust(strength, 0.0) == 1.0
    outside = np.array([2.9, -3.2, 0.0, 0.0, 0.0])
    assert distance(BOX, outside) == pytest.approx(1.5)
    assert trust(strength, 1.5) == pytest.approx(0.5)
    assert trust(strength, 15.0) < 0.01
    assert trust(OFF, 1e3) == 1.0


def test_sensitivity_is_that_of_a_machine_with_other_health():
    """Against the difference of two linear machines that have run for long under two values of health."""
    rng = np.random.default_rng(1)
    F = np.eye(12)
    F[:6, :6] = np.diag(rng.uniform(0.5, 0.9, 6)) + 0.05 * rng.normal(size=(6, 6))
    F[:6, 7:12] = rng.normal(size=(6, 5))
    X = np.zeros((6, 5))
    for _ in range(200):
        carry_sensitivity(X, F, 7, np.empty((6, 5)))
    assert X == pytest.approx(np.linalg.solve(np.eye(6) - F[:6, :6], F[:6, 7:12]), rel=1e-6)


def test_only_what_the_readings_tell_apart_is_corrected():
    """Two parameters that move one reading alike are known by their sum alone until the machine moves on."""
    H = np.zeros((3, 11))
    H[0, 6], H[0, 7], H[1, 8] = 2.0, 2.0, 1.0
    information = np.zeros((5, 5))
    for _ in range(100):
        gather(
            MEMORIES.observed,
            information,
            np.zeros((6, 5)),
            H,
            6,
            np.ones(3),
            np.array([0.0, 0.0, np.nan]),
            np.empty(5),
        )
    projector = projector_of(information, 1.0)
    assert np.trace(projector) == pytest.approx(2.0, abs=1e-3)
    assert projector @ [1.0, -1.0, 0.0, 0.0, 0.0] == pytest.approx(np.zeros(5), abs=1e-12)
    assert projector @ [1.0, 1.0, 3.0, 0.0, 0.0] == pytest.approx([1.0, 1.0, 3.0, 0.0, 0.0], abs=1e-3)
    assert np.trace(projector_of(np.diag([2.0, 0.0, 0.0, 0.0, 0.0]), 2.0)) == pytest.approx(0.5)
    H[0, 7] = -2.0
    for _ in range(100):
        gather(
            MEMORIES.observed,
            information,
            np.zeros((6, 5)),
            H,
            6,
            np.ones(3),
            np.array([0.0, 0.0, np.nan]),
            np.empty(5),
        )
    assert np.trace(projector_of(information, 1.0)) == pytest.approx(3.0, abs=1e-3)


@settings(deadline=None)
@given(st.integers(0, 1000), st.floats(1e-2, 1e2), st.floats(-4.0, 4.0))
def test_the_projector_weighs_each_eigenvector_by_its_eigenvalue(seed, least, decades):
    A = np.random.default_rng(seed).normal(size=(5, 3)) * 10.0 ** np.array([0.0, decades, 1.0])
    values, vectors = np.linalg.eigh(A @ A.T)
    expected = (vectors * (values**2 / (values**2 + least**2))) @ vectors.T
    assert projector_of(A @ A.T, least) == pytest.approx(expected, abs=1e-6)


def test_a_missing_channel_tells_nothing():
    H = np.zeros((3, 11))
    H[:, 6] = 1.0
    information = np.zeros((5, 5))
    gather(MEMORIES.observed, information, np.zeros((6, 5)), H, 6, np.ones(3), np.full(3, np.nan), np.empty(5))
    assert not information.any()


def test_mismatch_is_the_noise_that_is_really_there():
    rng = np.random.default_rng(2)
    explained, R = covariance(3, 3) + np.eye(3), np.diag([4.0, 1.0, 0.25])
    C = np.zeros((3, 3))
    root = np.linalg.cholesky(explained + R)
    for _ in range(4000):
        note_mismatch(MEMORIES.mismatch, C, root @ rng.normal(size=3), explained)
    assert np.diag(C) == pytest.approx(np.diag(R), rel=0.5)
    before = C.copy()
    note_mismatch(MEMORIES.mismatch, C, np.array([np.nan, 1.0, 1.0]), explained)
    assert np.array_equal(C[0], before[0])


@pytest.mark.parametrize(("truth", "low", "high"), [(1.0, 1.0, 1.05), (9.0, 5.0, 12.0)])
def test_r_widens_with_the_noise_and_is_left_alone_where_the_data_sheet_holds(truth, low, high):
    rng = np.random.default_rng(4)
    strength = OFF._replace(r_gain=1.0)
    C, factors = np.zeros((3, 3)), []
    for n in range(3000):
        note_mismatch(MEMORIES.mismatch, C, np.sqrt(truth) * rng.normal(size=3), np.zeros((3, 3)))
        factors.append(noise_factor(strength, MEMORIES.mismatch, C, 1.0, n + 1, 0))
    assert low <= np.mean(factors[1000:]) <= high
    assert max(factors) <= strength.r_most
    assert noise_factor(OFF, MEMORIES.mismatch, C, 1.0, 3000, 0) == 1.0


def test_r_is_bounded():
    C = np.eye(3) * 1e6
    assert noise_factor(OFF._replace(r_gain=1.0, r_most=7.0), MEMORIES.mismatch, C, 1.0, 5000, 0) == 7.0


def test_a_parameter_that_is_pushed_one_way_walks_faster_and_the_others_do_not():
    rng = np.random.default_rng(5)
    strength = OFF._replace(q_gain=0.1, q_most=20.0)
    push, quiet = np.zeros(5), []
    for _ in range(5000):
        note_push(MEMORIES.push, push, rng.normal(size=5), np.ones(5))
        quiet.append(walk_factor(strength, MEMORIES.push, push[1]))
    assert np.mean(quiet) < 1.1
    for _ in range(200):
        note_push(MEMORIES.push, push, rng.normal([2.0, 0.0, 0.0, 0.0, 0.0]), np.ones(5))
    assert walk_factor(strength, MEMORIES.push, push[0]) == strength.q_most
    assert walk_factor(strength, MEMORIES.push, push[1]) < 2.0
    assert walk_factor(OFF, MEMORIES.push, push[0]) == 1.0


def test_what_counts_as_chance_is_chi_square():
    assert stats.chi2.sf(PUSHED, 1) == pytest.approx(0.01, rel=0.01)
    assert all(0.0 < keep < 1.0 for keep in MEMORIES)


def test_a_channel_far_off_is_left_out_and_a_lasting_shift_is_let_in():
    strength, counts, S = OFF._replace(channel_gate=5.0), empty_safety(PARTS, 1)["counts"][0], np.eye(3)
    kept = []
    for _ in range(FAR_MOST + 3):
        innovation = np.array([0.5, 40.0, np.nan])
        left_out(strength, counts, innovation, S)
        assert innovation[0] == 0.5
        kept.append(bool(np.isfinite(innovation[1])))
    assert kept == [False] * FAR_MOST + [True] * 3
    left_out(strength, counts, np.array([0.0, 1.0, np.nan]), S)
    assert counts[CHANNEL + 1] == 0


@settings(deadline=None)
@given(st.integers(0, 1000))
def test_a_variance_is_bounded_by_a_reading_without_news(seed):
    P = covariance(seed)
    P /= 2.0 * np.sqrt(np.outer(np.diag(P), np.diag(P)))
    worse = np.where(np.arange(8) == 4, 4.0, 1.0)
    P *= np.outer(worse, worse)  # only the third is known too badly
    variance, H = P[4, 4], np.zeros((1, 8))
    H[0, 4] = 1.0
    R = np.array([[variance / (variance - 1.0)]])
    K, _, _ = gain(P, np.zeros(1), H, R)
    expected = joseph(P, K, H, R)
    bound_health(P, 2, np.ones(PARTS.health), np.empty(8))
    assert P == pytest.approx(expected, abs=1e-9)
    assert P[4, 4] == pytest.approx(1.0)


def test_the_interval_of_what_nothing_is_known_of_spans_a_machines_life():
    half, to_theta = Z95 * np.sqrt(widest_of(COMPRESSOR)), COMPRESSOR.coordinates.to_theta
    ends, healthy = np.sort(np.stack([to_theta(-half), to_theta(half)]), axis=0), COMPRESSOR.coordinates.healthy
    worn = np.array([h.ends[1] for h in COMPRESSOR.health])
    share = (np.clip(worn, *ends) - healthy)[:4] / (worn - healthy)[:4]
    assert (share > 0.95).all()
    assert ends[:, 4] == pytest.approx([-COMPRESSOR.span[4], COMPRESSOR.span[4]], rel=0.05)
