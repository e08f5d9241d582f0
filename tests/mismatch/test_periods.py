"""The period of a force shows in what it leaves, sharply over several recordings of one clock."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from helpers.plain import diagnosed
from motor import MOTOR
from motor_case import record

from twinbench.data.recording import Recording
from twinbench.mismatch.catalogue import generic
from twinbench.mismatch.periods import loudest_periods_s
from twinbench.mismatch.tracks import prepare

PERIOD_S = 7.3


def later(recording, start_s):
    return dataclasses.replace(recording, time_s=recording.time_s + start_s)


@pytest.mark.parametrize("period_s", [2.1, PERIOD_S, 31.0])
def test_a_sine_in_noise_is_found(period_s):
    tracks = prepare([later(record(f"run {s}", s), 400.0 * s) for s in (1, 2)], MOTOR)
    rng = np.random.default_rng(5)
    white = []
    for t in tracks:
        wave = 0.5 * np.sin(2.0 * np.pi * t.coarse.time_s / period_s + 0.4)
        white.append(np.stack([wave, 0.0 * wave, 0.0 * wave], axis=1) + rng.normal(size=t.means.shape))
    least, loudest, greatest = loudest_periods_s(tracks, white, 40.0)
    assert loudest == pytest.approx(period_s, rel=5e-3)
    assert least < period_s < greatest


def test_what_takes_longer_than_is_asked_is_no_period():
    (track,) = prepare([record("run", 1)], MOTOR)
    slow = np.sin(2.0 * np.pi * track.coarse.time_s / 110.0)[:, None]
    assert loudest_periods_s([track], [slow], 40.0)[1] <= 40.0


def shaken_runs(force: float) -> list[Recording]:
    """Three runs of a motor that is shaken with one period all the time; the last is to be held out."""

    def shaken(start_s):
        return lambda t, x, u: np.array([0.0, force * np.sin(2.0 * np.pi * (t + start_s) / PERIOD_S), 0.0])

    starts_s = {"run 1": 0.0, "run 2": 500.0, "held out": 900.0}
    return [
        later(record(name, seed, shaken(start_s)), start_s) for seed, (name, start_s) in enumerate(starts_s.items(), 1)
    ]


LISTED = [m for m in generic(MOTOR) if m.name.partition("@")[0] in ("periodic", "coulomb_friction", "offset")]


def test_a_shaken_machine_is_said_to_be_shaken_with_its_period():
    runs = shaken_runs(2.0)
    (finding,) = diagnosed(MOTOR, runs[:2], runs[2:], LISTED).findings
    assert finding.mechanism == "periodic@omega_rad_s"
    size, period, _ = (v.value for v in finding.parameters)
    assert size == pytest.approx(2.0, rel=0.1)
    assert period == pytest.approx(PERIOD_S, rel=1e-3)


def test_a_force_that_leaves_its_period_in_the_readings_acts_elsewhere():
    runs = shaken_runs(4.0)
    verdict = diagnosed(MOTOR, runs[:2], runs[2:], [m for m in LISTED if m.name != "periodic@omega_rad_s"])
    (finding,) = [f for f in verdict.findings if "periodic@current_A" in f.says]
    assert finding.mechanism is None
    assert "the residual still swings with its period, so it acts elsewhere, or in another way" in finding.says
    assert any("is not noise alone" in point for point in verdict.points)
