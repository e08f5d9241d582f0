"""The population of worn machines, on the design alone: what it says of itself, and what filters know of it."""

from __future__ import annotations

from collections import Counter

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from twinbench.data.benchmark import SINGLE, DesignConfig, design
from twinbench.data.fresh import HEALTH, HEALTHY, WORN
from twinbench.data.population import BLOCK, COMMISSIONING_S, SIZE, changing, commissioning_s, courses
from twinbench.data.scenario import health_of, latin_hypercube
from twinbench.machines.compressor import COMPRESSOR

CONFIG = DesignConfig()
WARM_S = 60.0 * CONFIG.warmup_minutes
MACHINES = [s for part in design(CONFIG).values() for s in part if not s.name.startswith(SINGLE)]
SPAN, start_of = COMPRESSOR.span, COMPRESSOR.start_of
each = pytest.mark.parametrize("machine", MACHINES, ids=lambda s: s.name)
BIAS = HEALTH.index("T_bias_K")
LIFE_LOW = np.where(np.arange(5) == BIAS, -6.0, np.minimum(HEALTHY, WORN))
LIFE_HIGH = np.where(np.arange(5) == BIAS, 6.0, np.maximum(HEALTHY, WORN))


@each
def test_health_stays_within_a_machines_life_and_nothing_changes_before_minute_six(machine):
    health = machine.health()
    assert (health >= LIFE_LOW - 1e-9).all()
    assert (health <= LIFE_HIGH + 1e-9).all()
    before = machine.time_s() < WARM_S + 360.0
    assert np.ptp(health[before], axis=0).max() == 0.0


@each
def test_changes_are_large_and_leave_two_minutes_to_see_them(machine):
    health, t = machine.health(), machine.time_s()
    for change in machine.changes:
        i = HEALTH.index(change.parameter)
        path = health[:, i]
        before, after = np.interp([change.begin_s - 0.1, change.finish_s + 0.1], t, path)
        assert SIZE[0] - 1e-6 <= abs(after - before) / SPAN[i] <= SIZE[1] + 1e-6
        assert machine.seconds - change.finish_s >= 120.0


def test_most_machines_change_two_to_four_parameters_and_all_parameters_about_equally_often():
    tests = [s for s in MACHINES if s.name.startswith("test")]
    counts = Counter(len({c.parameter for c in s.changes}) for s in tests)
    assert counts == {k: 6 * n for k, n in Counter(BLOCK).items()}
    moved = Counter(c for s in tests for c in {change.parameter for change in s.changes})
    assert max(moved.values()) - min(moved.values()) <= 6
    assert sum(moved.values()) == 6 * sum(BLOCK)


def test_some_changes_are_sudden_some_slow_some_go_back():
    sudden = sum(c.finish_s - c.begin_s < 0.1 for s in MACHINES for c in s.changes)
    twice = sum(len(s.changes) > len({c.parameter for c in s.changes}) for s in MACHINES)
    recovering = sum(
        abs(c.end - HEALTHY[i]) < abs(s.start[i] - HEALTHY[i])
        for s in MACHINES
        for c in s.changes
        if (i := HEALTH.index(c.parameter)) != BIAS
    )
    total = sum(len(s.changes) for s in MACHINES)
    for share in (sudden, twice, recovering):
        assert 0.1 * total < share < 0.7 * total


def test_the_prior_is_the_mean_and_covariance_of_the_starts():
    mean, cov = COMPRESSOR.prior
    zeta = COMPRESSOR.coordinates.to_zeta(start_of(np.random.default_rng(0).random((200_000, 5))))
    assert zeta.mean(axis=0) == pytest.approx(mean, abs=0.03)
    assert np.cov(zeta.T) == pytest.approx(cov, abs=0.06)


def test_starts_span_a_life():
    starts = start_of(latin_hypercube(40, 40, 5, "a"))
    assert np.allclose(start_of(np.zeros(5))[:4], HEALTHY[:4])
    assert np.allclose(start_of(np.ones(5))[:4], WORN[:4])
    assert np.ptp(starts[:, BIAS]) > 1.8 * COMPRESSOR.health[BIAS].start[1]
    assert (np.ptp(starts, axis=0)[:4] > 0.9 * SPAN[:4]).all()
    assert np.allclose(COMPRESSOR.coordinates.to_theta(COMPRESSOR.coordinates.to_zeta(starts)), starts)


@given(st.integers(0, 1000), st.floats(2.0, 200.0))
def test_courses_fit_recordings_of_any_length(seed, kept_min):
    rng = np.random.default_rng(seed)
    seconds = 60.0 * (kept_min + 1.0)
    start = start_of(rng.random(5))
    changes = courses(COMPRESSOR, start, (0, 1, 2, 3, 4), 60.0, seconds, rng)
    for parameter in HEALTH:
        own = [c for c in changes if c.parameter == parameter]
        ends = [s for c in own for s in (c.begin_s, c.finish_s)]
        assert ends == sorted(ends)
        assert 60.0 + commissioning_s(60.0 * kept_min) < ends[0]
        assert ends[-1] < seconds
    health = health_of(HEALTH, start, changes, np.arange(0.0, seconds, 1.0))
    assert (health >= LIFE_LOW - 1e-9).all()
    assert (health <= LIFE_HIGH + 1e-9).all()


def test_commissioning_is_five_minutes_and_a_fifth_of_a_short_recording():
    assert commissioning_s(1500.0) == COMMISSIONING_S
    assert commissioning_s(10_000.0) == COMMISSIONING_S
    assert commissioning_s(600.0) == 120.0


def test_which_parameters_change_is_drawn_by_block():
    assert changing(5, 0, 1, "test") == changing(5, 0, 1, "test")
    assert changing(5, 0, 1, "test") != changing(5, 1, 1, "test")
    assert sorted(len(c) for c in changing(5, 3, 1, "test")) == sorted(BLOCK)
