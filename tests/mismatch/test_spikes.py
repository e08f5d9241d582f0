"""Spikes go, and nothing else: single readings that return at once and that the simulator does not follow."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from motor import MOTOR
from motor_case import record

from twinbench.data.recording import Recording
from twinbench.mismatch.checks import audit
from twinbench.mismatch.spikes import find_spikes
from twinbench.mismatch.tracks import prepare

RNG = np.random.default_rng(3)


def test_spikes_go_and_steps_stay():
    clean = np.where(np.arange(400) < 200, 1.0, 5.0) + 0.02 * RNG.normal(size=400)
    spiked = clean.copy()
    spiked[[50, 300]] += 3.0
    assert find_spikes(spiked).tolist() == [50, 300]
    assert find_spikes(np.ones(100)).tolist() == []
    assert find_spikes(clean).tolist() == []


def test_between_two_spikes_the_good_reading_stays():
    clean = 0.02 * RNG.normal(size=200)
    clean[[80, 82]] += 3.0
    assert find_spikes(clean).tolist() == [80, 82]


def test_a_gap_has_no_spike_of_its_own_and_hides_none():
    clean = 0.02 * RNG.normal(size=200)
    clean[79] = np.nan
    clean[80] += 3.0
    assert find_spikes(clean).tolist() == [80]


def transients() -> dict[str, np.ndarray]:
    """Real events of two readings and more, quiet in between."""
    t = np.arange(600.0)
    ring = sum(np.where(t >= s, np.exp(-(t - s) / 6.0) * np.cos((t - s) * 1.3), 0.0) for s in (100, 300, 450))
    peak = sum(np.where(t >= s, np.exp(-(t - s) / 2.0), 0.0) for s in range(50, 600, 50))
    pulse = ((t % 40) < 3).astype(float)
    return {"ringing": ring, "peaks": peak, "pulses": pulse, "ramp": np.minimum(t % 97, 10.0) / 10.0}


@pytest.mark.parametrize("name", list(transients()))
def test_real_transients_stay(name):
    """Of these events Hampel's test (15 samples, six sigmas) takes out every tenth reading or so."""
    y = transients()[name] + 0.002 * np.random.default_rng(4).normal(size=600)
    assert len(find_spikes(y)) <= 1


def test_a_sensor_that_reads_in_steps_may_flicker_between_them():
    y = np.round(0.1 * RNG.normal(size=500) + np.linspace(0.0, 5.0, 500), 1)
    assert find_spikes(y).tolist() == []


@pytest.mark.parametrize("share", [0.001, 0.01])
def test_spikes_in_a_real_signal_are_found_and_nothing_else(share):
    run = record("run", 5)
    values, clean = run.values.copy(), [find_spikes(column) for column in run.values[:, 2:].T]
    assert sum(map(len, clean)) == 0
    at = 5 + 7 * RNG.choice(len(values) // 7 - 2, round(share * len(values)), replace=False)
    spiked = values[:, 3].copy()
    jump = 15.0 * np.nanstd(np.diff(spiked))
    spiked[at] += jump * RNG.choice([-1.0, 1.0], len(at))
    found = set(find_spikes(spiked).tolist())
    assert found <= set(at.tolist())
    assert len(found) >= 0.8 * len(at), "but for those at a step of the current, which does not return"


def test_a_jump_that_the_simulator_makes_too_is_put_back():
    run = record("run", 5)
    values = run.values.copy()
    values[300, 2] += 500.0
    values[700, 2] -= 500.0
    (track,) = prepare([replace(run, values=values)], MOTOR)
    assert [(s.channel, s.sample) for s in track.spikes] == [("speed_rad_s", 300), ("speed_rad_s", 700)]
    assert np.isnan(track.y[[300, 700], 0]).all()
    readings = np.zeros_like(track.y)
    readings[300, 0] = 470.0  # whatever the level around it is
    back = track.followed(readings + 40.0)
    assert [s.sample for s in back.spikes] == [700]
    assert back.y[300, 0] == values[300, 2]
    assert np.isnan(back.y[700, 0])
    assert track.followed(0.0 * readings) is track


def test_empty_cells_are_missing_and_spikes_are_not():
    run = record("run", 5)
    spiky, holey = run.values.copy(), run.values.copy()
    spiky[10:1400:8, 2] += 2000.0
    holey[::8, 2] = np.nan
    told = [audit(prepare([replace(run, values=v)], MOTOR), MOTOR) for v in (spiky, holey)]
    assert not any("missing" in remark for remark in told[0])
    assert any("174 of 1500 readings were taken out as spikes" in remark for remark in told[0])
    assert any("speed_rad_s is missing 13 % of the time" in remark for remark in told[1])
    assert not any("spike" in remark for remark in told[1])


def test_a_spike_tells_what_was_taken_out_where_and_when():
    run = record("run", 5)
    values = run.values.copy()
    values[300, 3] += 400.0
    (track,) = prepare([Recording("monday", run.time_s, run.channels, values)], MOTOR)
    (spike,) = track.spikes
    assert spike[:4] == ("monday", "amps_A", run.time_s[300], values[300, 3])
