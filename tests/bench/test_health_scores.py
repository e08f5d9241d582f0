"""Errors of health by hand on a few ticks: in per cent of a life, moving and still, sudden, and the true start held."""

from __future__ import annotations

import numpy as np
import pytest

from twinbench.bench.statistics.health import health_definitions, health_scores, true_start_held
from twinbench.bench.statistics.subject import PAPERS
from twinbench.bench.statistics.tracking import change_scores, health_changes
from twinbench.data.batch import Batch, Truth
from twinbench.data.population import COMMISSIONING_S
from twinbench.machines.compressor import COMPRESSOR, HEALTH

TIME_S = np.arange(0.0, 1500.0, 100.0)  # 15 ticks, 3 of them commissioning
RANKED = TIME_S >= COMMISSIONING_S


def truth() -> np.ndarray:
    """(3, 15, 5): capacity steps by half its life at 700 s; leakage ramps over 600 s; nothing moves."""
    health = np.tile(COMPRESSOR.coordinates.healthy, (3, len(TIME_S), 1))
    health[0, TIME_S >= 700.0, 0] -= 0.5 * COMPRESSOR.span[0]
    # At most 4 % of the life in a tick: no step.
    health[1, :, 2] += 0.24 * COMPRESSOR.span[2] * np.clip((TIME_S - 600.0) / 600.0, 0.0, 1.0)
    return health


def test_errors_count_in_shares_of_a_life_from_minute_five_on():
    true = truth()
    estimated = true.copy()
    estimated[..., 0] += 0.1 * COMPRESSOR.span[0]
    estimated[..., 4] -= np.where(RANKED, 0.2, 0.5) * COMPRESSOR.span[4]
    found = health_scores(COMPRESSOR, TIME_S, estimated, true)
    assert set(found) == set(health_definitions(PAPERS))
    np.testing.assert_allclose(found["capacity_life_pct"], 10.0)
    np.testing.assert_allclose(found["T_bias_K_life_pct"], 20.0)
    np.testing.assert_allclose(found["efficiency_life_pct"], 0.0)
    np.testing.assert_allclose(found["health_life_pct"], (10.0 + 20.0) / 5)
    np.testing.assert_allclose(found["health_commissioning_pct"], (10.0 + 50.0) / 5)
    # Capacity moves in the first, leakage in the second.
    np.testing.assert_allclose(found["health_moving_pct"], [10.0, 0.0, np.nan])
    np.testing.assert_allclose(found["health_still_pct"], [20.0 / 4, 30.0 / 4, 30.0 / 5])
    np.testing.assert_allclose(found["health_after_sudden_pct"], [6.0, np.nan, np.nan])
    np.testing.assert_allclose(found["health_without_sudden_pct"], [np.nan, 6.0, 6.0])


def test_a_step_of_the_sensors_bias_is_no_step_of_the_machine():
    true = truth()[2:]
    true[:, TIME_S >= 700.0, HEALTH.index("T_bias_K")] = 4.0
    found = health_scores(COMPRESSOR, TIME_S, true, true)
    assert np.isnan(found["health_after_sudden_pct"]).all()
    assert found["health_moving_pct"] == 0.0


def test_where_everything_moves_nothing_is_still_and_no_commissioning_is_no_score():
    true = np.tile(COMPRESSOR.coordinates.healthy, (1, len(TIME_S), 1))
    true[:, TIME_S >= 700.0] += 0.5 * COMPRESSOR.span
    found = health_scores(COMPRESSOR, TIME_S, true, true, since_s=0.0)
    assert np.isnan(found["health_still_pct"]).all()
    assert np.isnan(found["health_commissioning_pct"]).all()


def test_the_true_start_errs_by_what_has_changed_since():
    health = truth()
    rest = np.zeros((3, len(TIME_S), 5)), health, np.zeros((3, len(TIME_S), 3)), np.zeros((3, len(TIME_S), 4))
    names = ("step", "ramp", "calm")
    batch = Batch(names, TIME_S, np.zeros((3, len(TIME_S), 7)), Truth(*rest))
    table = true_start_held(batch, TIME_S).pivot(index="sequence", columns="metric", values="value")
    after = (TIME_S[RANKED] >= 700.0).mean()
    assert table.loc["step", "health_life_pct"] == pytest.approx(50.0 * after / 5)
    assert table.loc["step", "health_moving_pct"] == pytest.approx(50.0 * after)
    assert table.loc["calm", "health_life_pct"] == 0.0
    assert (table["health_commissioning_pct"] == 0.0).all()


def worn_and_back() -> tuple[np.ndarray, np.ndarray]:
    """Capacity wears from 400 to 700 s with a pause, and is as before at 900 s; the bias steps at 500 s."""
    time_s = np.arange(0.0, 1500.0)
    health = np.tile(COMPRESSOR.coordinates.healthy, (len(time_s), 1))
    health[:, 0] -= 0.06 * np.interp(time_s, [400.0, 500.0, 600.0, 700.0], [0.0, 0.5, 0.5, 1.0]) * (time_s < 900.0)
    health[time_s >= 500.0, 4] = 3.0
    return time_s, health


def test_every_change_is_found_and_a_pause_is_none():
    time_s, health = worn_and_back()
    worn, back, step = health_changes(COMPRESSOR, time_s, health)
    assert (worn.parameter, worn.start_s, worn.end_s, worn.until_s) == (0, 401.0, 700.0, 900.0)
    assert worn.size == pytest.approx(0.06)
    assert (back.start_s, back.end_s, back.until_s) == (900.0, 900.0, np.inf)
    assert (HEALTH[step.parameter], step.start_s, step.end_s, step.size) == ("T_bias_K", 500.0, 500.0, 3.0)
    assert health_changes(COMPRESSOR, time_s, np.tile(COMPRESSOR.coordinates.healthy, (len(time_s), 1))) == []


def test_each_change_has_its_own_delay_and_recovery():
    time_s, health = worn_and_back()
    estimated = health.copy()
    # Twenty seconds late when it wears; when it comes back the estimate goes on as worn.
    estimated[:, 0] = np.where(time_s < 900.0, health[(time_s - 20.0).clip(0.0).astype(int), 0], health[899, 0])
    rest = np.zeros((1, len(time_s), 5)), health[None], np.zeros((1, len(time_s), 3)), np.zeros((1, len(time_s), 4))
    batch = Batch(("one",), time_s, np.zeros((1, len(time_s), 7)), Truth(*rest))
    table = change_scores(("one",), time_s, estimated[None], batch).set_index("metric")["value"]
    assert table["delay_capacity_1_s"] == 20.0
    # Twenty seconds of this ramp are a tenth of the change: what is left of it then counts as recovered.
    assert table["recovery_capacity_1_s"] == 0.0
    assert table["watched_capacity_1_s"] == 200.0
    assert np.isnan(table["delay_capacity_2_s"])
    assert np.isnan(table["recovery_capacity_2_s"])
    assert table["watched_capacity_2_s"] == time_s[-1] - 900.0
    assert table["delay_T_bias_K_1_s"] == table["recovery_T_bias_K_1_s"] == 0.0
