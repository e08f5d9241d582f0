"""Calibrated intervals hold what they promise for recordings that nobody has seen, and say so of no single one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from twinbench.bench.estimates import Estimates
from twinbench.bench.statistics.conformal import factors, nonconformity, stretch
from twinbench.data.batch import Batch, Truth
from twinbench.machines.compressor import ESTIMATED

TICKS = 400


def recordings(rng: np.random.Generator, n: int, scale: float = 1.0) -> np.ndarray:
    """(n, TICKS) misses of recordings that differ in how hard they are, with errors that last for twenty ticks."""
    hard = scale * np.exp(0.5 * rng.standard_normal((n, 1)))
    return np.abs(np.repeat(rng.standard_normal((n, TICKS // 20)), 20, axis=1)) * hard


@pytest.mark.parametrize("n", [3, 6, 20])
def test_a_new_recording_is_held_for_95_per_cent_of_its_time(n):
    """Exchangeable recordings: over many draws of n the mean coverage of others is 95 %, within its own error."""
    rng = np.random.default_rng(n)
    covered = [(recordings(rng, 50) <= stretch(recordings(rng, n))).mean() for _ in range(300)]
    error = 3.0 * np.std(covered) / np.sqrt(len(covered))
    assert abs(np.mean(covered) - 0.95) < error + 0.005


def test_without_the_correction_few_recordings_would_be_held_too_seldom():
    rng = np.random.default_rng(0)
    plain = []
    for _ in range(300):
        known = recordings(rng, 3)
        plain.append((recordings(rng, 50) <= np.quantile(known, 0.95)).mean())
    assert np.mean(plain) < 0.94


def test_of_many_recordings_the_factor_is_the_plain_quantile():
    known = recordings(np.random.default_rng(1), 400)
    assert stretch(known) == pytest.approx(np.quantile(known, 0.95), rel=0.02)


@settings(max_examples=20, deadline=None)
@given(st.floats(0.2, 5.0), st.integers(0, 2**32 - 1))
def test_errors_twice_as_large_need_intervals_twice_as_wide(times, seed):
    known = recordings(np.random.default_rng(seed), 8)
    assert stretch(times * known) == pytest.approx(times * stretch(known), rel=0.02)


def test_each_side_of_an_interval_counts_for_itself():
    mean, low, high = np.zeros(4), np.array([-1.0, -1.0, 0.0, np.nan]), np.array([3.0, 3.0, 2.0, 1.0])
    true = np.array([1.5, -0.5, -0.1, -0.1])
    np.testing.assert_array_equal(nonconformity(mean, low, high, true), [0.5, 0.5, np.inf, np.inf])


def test_an_interval_that_is_none_takes_the_widest_factor_there_is():
    assert stretch(np.full((5, TICKS), np.inf)) == pytest.approx(50.0)


def made_up(n: int, seed: int) -> tuple[Batch, Estimates]:
    """Estimates whose intervals are half as wide as they should be, but for the last quantity's, twice as wide."""
    rng = np.random.default_rng(seed)
    shape = (n, TICKS, len(ESTIMATED))
    true = 100.0 + np.zeros(shape)
    sd = np.ones(len(ESTIMATED))
    mean = true + np.repeat(rng.standard_normal((n, TICKS // 20, len(ESTIMATED))), 20, axis=1)
    half = 1.96 * sd * np.where(np.arange(len(ESTIMATED)) == len(ESTIMATED) - 1, 2.0, 0.5)
    names, time_s = tuple(f"validation-{b:02d}" for b in range(n)), np.arange(float(TICKS))
    rest = np.ones((n, TICKS, 3)), np.ones((n, TICKS, 4))
    batch = Batch(names, time_s, np.zeros((n, TICKS, 7)), Truth(true[..., :5], true[..., 5:], *rest))
    ones = np.ones((n, TICKS))
    none = np.empty((n, 0, 1, 3)), np.empty((n, 0, 10)), np.empty((n, 0, 10, 10))
    said = (ones, ones.astype(np.int8), ones.astype(np.int16), np.empty(0), np.ones(1), *none, np.full(10, np.nan))
    return batch, Estimates("sure", 0, names, time_s, mean, mean - half, mean + half, *said)


def test_what_validation_says_puts_other_recordings_right(tmp_path):
    batch, known = made_up(40, 0)
    found = factors(known, batch)
    np.testing.assert_allclose(found[:-1], 2.0, rtol=0.1)
    assert found[-1] == pytest.approx(0.5, rel=0.1)
    other, unseen = made_up(40, 1)
    calibrated = replace(unseen, factors=found).calibrated()
    hit = (calibrated.low <= other.truth.estimated) & (other.truth.estimated <= calibrated.high)
    np.testing.assert_allclose(hit.mean(axis=(0, 1)), 0.95, atol=0.02)
    replace(unseen, factors=found).save(tmp_path / "cell.npz")
    np.testing.assert_array_equal(Estimates.load(tmp_path / "cell.npz").factors, found)
