"""Page's test against its own definition, and what it takes for a shift."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from twinbench.methods.shifts import LIMIT_SD, MOST_SD, N_SUMS, SLACK_SD, no_shifts, shifted

SD = 0.02


def alarms(innovations: np.ndarray) -> list[int]:
    """When output 1 of three is said to have shifted."""
    sums = no_shifts(3)
    return [k for k, x in enumerate(innovations) if shifted(sums, SD * x, SD, 1)]


@settings(deadline=None)  # the first call compiles
@given(st.lists(st.floats(-8.0, 8.0), max_size=120))
def test_an_alarm_is_where_the_largest_sum_since_any_moment_reaches_its_limit(innovations):
    since, expected = 0, []
    for k in range(len(innovations)):
        beyond = -np.inf
        for slack, limit, most in zip(SLACK_SD, LIMIT_SD, MOST_SD, strict=True):
            capped = np.clip(innovations, -most, most)
            for side in (1, -1):
                own = [side * capped[j : k + 1].sum() - slack * (k + 1 - j) for j in range(since, k + 1)]
                beyond = max(beyond, max(own) - limit)
        if abs(beyond) < 1e-9:
            return  # a tie, which rounding decides
        if beyond > 0:
            expected.append(k)
            since = k + 1
    assert alarms(np.array(innovations)) == expected


def test_chance_and_single_outliers_are_no_shift():
    rng = np.random.default_rng(0)
    assert not alarms(rng.normal(size=100_000))
    lone = rng.normal(size=2000)
    lone[::20] = 1e3
    assert not alarms(lone)


def test_a_large_shift_is_seen_in_half_a_second_and_one_of_one_sd_in_seconds():
    rng = np.random.default_rng(1)
    for size, most in ((3.0, 10), (1.0, 80)):
        for side in (1.0, -1.0):
            noise = rng.normal(size=200)
            noise[50:] += side * size
            assert 50 <= alarms(noise)[0] < 50 + most


def test_outputs_do_not_touch_each_other_and_an_alarm_begins_anew():
    sums = no_shifts(3)
    assert sums.shape == (N_SUMS, 2, 3)
    shifted(sums, 3.0 * SD, SD, 0)
    other = sums[:, :, 0].copy()
    while not shifted(sums, 4.0 * SD, SD, 1):
        assert sums[:, :, 1].any()
    assert not sums[:, :, 1:].any()
    assert np.array_equal(sums[:, :, 0], other)
