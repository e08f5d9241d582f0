"""A sensor that stands still is found by itself, dated, and set aside."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from motor import MOTOR
from motor_case import record

from twinbench.mismatch import diagnose
from twinbench.mismatch.stuck import find_stuck
from twinbench.mismatch.tracks import prepare

SPEED = 0


def sticks(time_s, y):
    stuck = y.copy()
    first = int(np.argmax(time_s > 70.0))
    stuck[first:, SPEED] = y[first, SPEED]
    return stuck


def test_it_is_named_dated_and_its_readings_bend_nothing_else():
    fitted = [record("run 1", 1), record("run 2", 2, sensor=sticks)]
    verdict = diagnose(MOTOR, fitted, [record("held out", 9, reach=1.3)], ())
    assert verdict.verdict == "sensor fault"
    (finding,) = verdict.findings
    assert finding.mechanism == "sensor_stuck@speed_rad_s"
    assert str(finding.port) == "output:speed_rad_s"
    assert finding.since_s == pytest.approx(70.0, abs=4.0)
    assert verdict.says.startswith("The sensor of speed_rad_s stands still: on held out the RMS error of ")
    assert "s of run 2" in verdict.points[0]
    assert finding.probability is None
    assert verdict.values["R_ohm"] == pytest.approx(0.65, rel=0.01)
    seen = verdict.diagnosis.tracks[1].y[:, SPEED]
    assert np.isnan(seen[verdict.diagnosis.tracks[1].time_s > 75.0]).all()


def test_one_that_sticks_in_the_held_out_recording_only_is_found_too():
    fitted = [record(f"run {s}", s) for s in (1, 2)]
    verdict = diagnose(MOTOR, fitted, [record("held out", 9, sensor=sticks)], ())
    assert [f.mechanism for f in verdict.findings] == ["sensor_stuck@speed_rad_s"]
    assert "held out" in verdict.findings[0].says


@pytest.mark.parametrize("share", [0.0, 0.5])
def test_one_that_follows_or_follows_by_half_is_not_stuck(share):
    track = prepare([record("run", 3)], MOTOR)[0]
    simulated = track.means / (1.0 - share)
    assert find_stuck([track], [track.means - simulated], np.array([0.5, 0.3, 0.3])) == []


def test_one_that_only_goes_no_higher_is_saturated_not_stuck():
    (track,) = prepare([record("run", 3)], MOTOR)
    top = float(np.quantile(track.means[:, SPEED], 0.6))
    long_there = np.concatenate((track.means[:, SPEED], np.linspace(top, top + 3.0 * track.means[:, SPEED].std(), 200)))
    simulated = np.stack([long_there] * 3, axis=1)

    def found(readings, simulated=simulated):
        both = np.stack([readings] * 3, axis=1)
        times = np.arange(len(readings)) * float(np.median(np.diff(track.block_time_s)))
        longer = replace(track, time_s=times, starts=np.arange(len(times)), means=both, u=both, y=both)
        return find_stuck([longer], [both - simulated], np.full(3, 0.5))

    assert found(np.minimum(long_there, top)) == []
    # A simulator that was fitted to such readings is itself too low now and then.
    poor = np.where(np.arange(len(long_there)) % 5, long_there, 0.5 * top)
    assert found(np.minimum(long_there, top), np.stack([poor] * 3, axis=1)) == []
    stays = long_there.copy()
    stays[-200:] = top
    assert [s.channel for s in found(stays)] == [0, 1, 2]


def test_one_that_stands_still_while_the_machine_moves_little_is_stuck_too():
    (track,) = prepare([record("run", 3)], MOTOR)
    reads, last = track.means.copy(), len(track.means) - 200
    reads[last:] = reads.mean(axis=0)
    simulated = reads.copy()
    # A fifth of what the channels commonly do, and far more than their noise.
    simulated[last:] += 0.2 * reads.std(axis=0) * np.sin(np.arange(200) / 20.0)[:, None]
    found = find_stuck([replace(track, means=reads)], [reads - simulated], np.full(3, 0.02))
    assert SPEED in [s.channel for s in found]


def test_a_machine_that_rests_is_no_stuck_sensor():
    track = prepare([record("run", 3, sensor=lambda t, y: 0.0 * y)], MOTOR)[0]
    assert find_stuck([track], [track.means - 0.0], np.array([0.5, 0.3, 0.3])) == []
