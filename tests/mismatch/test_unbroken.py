"""Recordings in which an input is missing for a while: cut where it moved on, else held over."""

from __future__ import annotations

import functools
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from motor import MOTOR
from motor_case import record

from twinbench.data.recording import Recording
from twinbench.mismatch import diagnose
from twinbench.mismatch.unbroken import FEWEST_IN_PART, unbroken


def lost(recording: Recording, begin: int, count: int) -> Recording:
    """Without the first input's values in some samples."""
    values = recording.values.copy()
    values[begin : begin + count, 0] = np.nan
    return replace(recording, values=values)


@functools.cache
def run() -> Recording:
    return record("run", 3, seconds=80.0)


def jump(recording: Recording) -> int:
    """A sample at which the first input jumps, well within the record."""
    moved = np.abs(np.diff(recording.values[:, 0]))
    inner = slice(2 * FEWEST_IN_PART, len(moved) - 2 * FEWEST_IN_PART)
    return inner.start + int(np.argmax(moved[inner])) + 1


def test_a_whole_recording_is_left_as_it_is():
    whole = run()
    assert unbroken(whole, MOTOR) == ([whole], "")


def test_it_is_cut_where_an_input_moved_on_unseen():
    whole = run()
    at = jump(whole) - 10
    parts, remark = unbroken(lost(whole, at, 20), MOTOR)
    assert [p.name for p in parts] == ["run (part 1)", "run (part 2)"]
    assert parts[0].time_s[-1] == whole.time_s[at - 1]
    assert parts[1].time_s[0] == whole.time_s[at + 20]
    assert remark.startswith("run: voltage_V moved on while not recorded")


def test_an_input_that_is_the_same_after_a_gap_is_held_over():
    whole = run()
    still = next(k for k in range(100, 900) if np.ptp(whole.values[k - 2 : k + 24, 0]) == 0.0)
    broken = lost(whole, still, 20)
    assert unbroken(broken, MOTOR) == ([broken], "")


def test_rows_that_are_missing_are_a_gap_too():
    whole = run()
    at = jump(whole)
    rows = np.r_[0 : at - 10, at + 10 : len(whole.time_s)]
    parts, _ = unbroken(replace(whole, time_s=whole.time_s[rows], values=whole.values[rows]), MOTOR)
    assert len(parts) == 2


def test_an_input_that_is_seldom_recorded_has_no_gaps():
    whole = run()
    values = whole.values.copy()
    values[np.arange(len(values)) % 15 != 0, 0] = np.nan
    seldom = replace(whole, values=values)
    assert unbroken(seldom, MOTOR) == ([seldom], "")


def test_a_part_knows_what_was_last_recorded_of_the_other_inputs():
    whole = run()
    values, at = whole.values.copy(), jump(whole) - 10
    values[1:, 1] = np.nan  # a set point, recorded when it was set
    parts, _ = unbroken(lost(replace(whole, values=values), at, 20), MOTOR)
    assert [set(p.values[:, 1]) for p in parts] == 2 * [{values[0, 1]}]


def test_a_part_that_is_too_short_is_left_out():
    whole = run()
    values = whole.values.copy()
    values[FEWEST_IN_PART:, 0] += 150.0  # so it has moved on for certain
    parts, remark = unbroken(lost(replace(whole, values=values), FEWEST_IN_PART - 15, 20), MOTOR)
    assert [p.name for p in parts] == ["run"]
    assert len(parts[0].time_s) == len(whole.time_s) - FEWEST_IN_PART - 5
    assert "% of its samples" in remark


@given(st.integers(0, 900), st.integers(1, 60))
def test_no_sample_is_told_twice_and_order_stays(begin, count):
    whole = run()
    parts, _ = unbroken(lost(whole, begin, count), MOTOR)
    times = np.concatenate([p.time_s for p in parts])
    assert np.all(np.diff(times) > 0.0)
    assert set(times) <= set(whole.time_s)


@pytest.mark.slow
def test_a_healthy_machine_is_not_blamed_for_gaps_in_an_inputs_record():
    """Held over, six gaps of two seconds made eight effects likelier than none."""
    rng, many = np.random.default_rng(1), []
    for k in range(3):
        recording = record(f"run_{k}", k)
        for begin in rng.integers(0, len(recording.time_s) - 40, 6):
            recording = lost(recording, int(begin), 25)
        many.append(recording)
    verdict = diagnose(MOTOR, many[:2], many[2:])
    assert verdict.verdict in ("consistent", "parameter change")


def test_an_input_that_moved_by_its_noise_alone_is_held_over():
    """Its noise is half of what it does, so one value and the next differ by more than a tenth of that."""
    whole = run()
    values = whole.values.copy()
    values[:, 0] = 5.0 + np.random.default_rng(0).normal(size=len(values))
    broken = lost(replace(whole, values=values), 400, 20)
    assert unbroken(broken, MOTOR) == ([broken], "")


def test_an_input_that_jumps_from_sample_to_sample_by_itself_has_no_noise():
    whole = run()
    values = whole.values.copy()
    values[:, 0] = 100.0 * np.random.default_rng(0).choice([-1.0, 1.0], size=len(values))
    values[399, 0], values[420, 0] = -100.0, 100.0
    assert len(unbroken(lost(replace(whole, values=values), 400, 20), MOTOR)[0]) == 2
