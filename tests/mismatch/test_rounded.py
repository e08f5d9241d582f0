"""A sensor that moves in steps is found by itself, with its step; a sound one, or a recorder's resolution, is not."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from motor import MOTOR
from motor_case import record

from twinbench.mismatch import diagnose
from twinbench.mismatch.model import whole_catalogue
from twinbench.mismatch.rounded import find_rounded
from twinbench.mismatch.tracks import Track
from twinbench.physics.simulator import Array

AMPS = 1
STEP_A = 3.0


def swings(n: int = 4000) -> Array:
    t = np.linspace(0.0, 60.0, n)
    return 30.0 + 10.0 * np.sin(0.7 * t) + 6.0 * np.sin(1.9 * t + 1.0)


def track(y: Array) -> Track:
    y = y[:, None]
    return Track("run", np.arange(len(y)) * 0.1, np.zeros((len(y), 0)), y, np.arange(len(y)), y)


@settings(max_examples=20, deadline=None)
@given(step=st.floats(0.5, 6.0), noise=st.floats(0.05, 0.5), seed=st.integers(0, 99))
def test_the_step_is_found_to_within_a_two_hundredth(step: float, noise: float, seed: int) -> None:
    clean = swings()
    y = step * np.round(clean / step) + noise * np.random.default_rng(seed).normal(size=len(clean))
    (found,) = find_rounded([track(y)], [clean[:, None]], [0])
    assert found.step == pytest.approx(step, rel=5e-3)


@settings(max_examples=20, deadline=None)
@given(noise=st.floats(0.05, 1.0), drift=st.floats(0.0, 2.0), lsb=st.floats(0.0, 0.4), seed=st.integers(0, 99))
def test_noise_a_misfit_and_a_recorders_resolution_are_no_steps(
    noise: float, drift: float, lsb: float, seed: int
) -> None:
    clean = swings()
    y = clean + noise * np.random.default_rng(seed).normal(size=len(clean)) + drift * np.sin(0.31 * clean)
    y = lsb * np.round(y / lsb) if lsb > 0.01 else y
    assert find_rounded([track(y)], [clean[:, None]], [0]) == []


def test_a_simulator_that_is_slowly_off_hides_no_step() -> None:
    clean = swings()
    y = 2.0 * np.round(clean / 2.0) + 0.3 * np.random.default_rng(0).normal(size=len(clean))
    off = clean + np.linspace(-3.0, 3.0, len(clean))
    (found,) = find_rounded([track(y)], [off[:, None]], [0])
    assert found.step == pytest.approx(2.0, rel=0.01)


def test_too_few_readings_say_nothing() -> None:
    clean = swings()[:50]
    assert find_rounded([track(2.0 * np.round(clean / 2.0))], [clean[:, None]], [0]) == []


def test_it_is_named_and_the_mended_simulator_has_it() -> None:
    def rounds(time_s: Array, y: Array) -> Array:
        y = y.copy()
        y[:, AMPS] = STEP_A * np.round(y[:, AMPS] / STEP_A)
        return y

    fitted, held = [record(f"run {s}", s, sensor=rounds) for s in (1, 2)], [record("held out", 9, sensor=rounds)]
    only = [m for m in whole_catalogue(MOTOR) if m.name == "sensor_quantisation@amps_A"]
    verdict = diagnose(MOTOR, fitted, held, only)
    assert verdict.verdict == "sensor fault"
    (finding,) = verdict.findings
    assert (finding.mechanism, str(finding.port)) == ("sensor_quantisation@amps_A", "output:amps_A")
    assert "moves in steps of 3" in finding.says
    assert verdict.says.startswith("The sensor of amps_A moves in steps: on held out")
    assert [m.name for m in verdict.mechanisms] == ["sensor_quantisation@amps_A"]
    assert verdict.values["quantisation_amps_A"] == pytest.approx(STEP_A, rel=1e-3)
    assert not diagnose(MOTOR, fitted, held, ()).findings, "what was left out is not blamed"
