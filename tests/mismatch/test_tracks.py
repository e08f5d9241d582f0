"""Blocks of recordings: equally long in all of them, whatever their lengths and clocks."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from motor import MOTOR
from motor_case import record

from twinbench.mismatch.tracks import FEWEST_SAMPLES, block_seconds, prepare


def slow(n: int, period_s: float) -> np.ndarray:
    """Readings (n, 1) that move slowly, with noise."""
    rng = np.random.default_rng(n)
    return (np.sin(np.arange(n) * period_s / 100.0) + 0.01 * rng.normal(size=n))[:, None]


@given(n=st.integers(40, 40_000), many=st.integers(1, 4), period_s=st.sampled_from([0.02, 0.1, 1.0, 5.0]))
def test_recordings_of_one_length_have_as_many_blocks_as_asked(n, many, period_s):
    # What is slow is seen in any block that is much shorter than it.
    fast_enough = [slow(n, min(period_s, 100.0 / n))] * many
    assert block_seconds(fast_enough, [period_s] * many) == pytest.approx(max(1, n // 1000) * period_s)


def test_blocks_last_equally_long_in_recordings_of_any_length():
    long, short = record("long", 1, seconds=400.0), record("short", 2, seconds=20.0)
    tracks = prepare([long, short], MOTOR)
    assert tracks[0].block_s == pytest.approx(tracks[1].block_s)
    assert all(len(t.starts) >= FEWEST_SAMPLES for t in tracks)
    assert len(tracks[0].starts) == pytest.approx(20 * len(tracks[1].starts), abs=20)


def test_a_clock_of_another_rate_makes_no_other_blocks():
    tracks = prepare([record("quick", 1, seconds=60.0, dt_s=0.02), record("slow", 2, seconds=60.0, dt_s=0.04)], MOTOR)
    assert tracks[0].block_s == pytest.approx(tracks[1].block_s)
    assert int(tracks[0].starts[1]) == 2 * int(tracks[1].starts[1])


def test_what_is_held_back_has_the_blocks_of_what_is_learnt_from_and_enough_of_them():
    learnt = prepare([record("learnt", 1, seconds=400.0)], MOTOR, shortest_s=6.0)
    (held,) = prepare([record("held", 2, seconds=6.0)], MOTOR, like=learnt)
    assert held.block_s == pytest.approx(learnt[0].block_s)
    assert len(held.starts) >= FEWEST_SAMPLES


def test_noise_of_block_means_is_the_same_in_all_recordings():
    rng = np.random.default_rng(0)

    def still(t, y):
        return 0.0 * y + 0.1 * rng.normal(size=y.shape)

    long, short = (record(f"{s} s", s, sensor=still, seconds=float(s)) for s in (600, 60))
    tracks = prepare([long, short], MOTOR, blocks=100)
    sds = [np.nanstd(t.means[:, 0]) for t in tracks]
    assert sds[0] == pytest.approx(sds[1], rel=0.3)
