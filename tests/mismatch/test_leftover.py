"""What no model leaves: oscillations in a mean, errors that are no noise, a rate by another name."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from motor import MOTOR
from motor_case import record

from twinbench.mismatch import diagnose
from twinbench.mismatch.catalogue import generic
from twinbench.mismatch.checks import audit
from twinbench.mismatch.tracks import prepare, samples_per_block
from twinbench.physics.simulator import Simulator, Variable

N = 8000


@pytest.mark.parametrize(("period", "most"), [(9.0, 1), (30.0, 4), (2000.0, 8)])
def test_blocks_are_shorter_than_what_the_machine_does(period, most):
    rng = np.random.default_rng(0)
    wave = np.sin(2.0 * np.pi * np.arange(N) / period) + 0.1 * rng.normal(size=N)
    steady = rng.normal(size=N)
    chosen = samples_per_block(np.stack([wave, steady], axis=-1))
    assert chosen <= most
    assert chosen > most / 2


def test_there_is_an_end_to_short_blocks_and_it_is_said():
    wave = np.sin(np.arange(100_000.0))
    assert samples_per_block(wave[:, None]) == 5
    (track,) = prepare([record("run 1", 1)], MOTOR)
    assert not any("faster" in remark for remark in audit([track], MOTOR))
    fast = track.y.copy()
    fast[:, 0] = np.sin(np.arange(len(fast)))
    blocks = replace(track, y=fast, starts=track.starts[::5])
    assert any("speed_rad_s changes faster than" in remark for remark in audit([blocks], MOTOR))


def test_a_channel_that_was_not_recorded_asks_for_nothing():
    assert samples_per_block(np.full((N, 1), np.nan)) == 8


def mass(unit: str) -> Simulator:
    def rhs(x, u, theta):
        return np.array([x[1], (u[0] - theta[0] * x[0]) / theta[1]])

    return Simulator(
        name="mass",
        states=(Variable("x", unit, -2.0, 2.0, 0.0, 0.5), Variable("v", f"{unit}/s", -5.0, 5.0, 0.0, 1.0)),
        inputs=(Variable("F", "N", -50.0, 50.0, 0.0, 10.0),),
        outputs=(Variable("pos", unit, -2.0, 2.0, 0.0, 0.5),),
        parameters=(Variable("k", "N/m", 0.0, 100.0, 20.0), Variable("m", "kg", 0.1, 20.0, 2.0)),
        rhs=rhs,
        output=lambda x, u, theta: np.array([x[0]]),
        initial=lambda u0, y0, theta: np.array([y0[0], 0.0]),
    )


def test_the_rate_of_a_state_is_a_speed_in_any_unit():
    """The same equations in volts, as of a circuit that stands for a spring, lack the same things."""
    names = [[m.name for m in generic(mass(unit))] for unit in ("m", "V")]
    assert names[0] == names[1]
    assert {"hardening_spring@v", "coulomb_friction@v", "hysteresis@v"} <= set(names[0])


def rippled(time_s, y):
    """A ripple of 3 s, ten noises high, that no candidate of these tests explains."""
    y = y.copy()
    y[:, 0] += 10.0 * np.sin(2.0 * np.pi * time_s / 3.0) ** 3
    return y


def test_errors_far_above_the_sensors_scatter_are_unexplained():
    fitted = [record(f"run {s}", s, sensor=rippled) for s in (1, 2)]
    verdict = diagnose(MOTOR, fitted, [record("held out", 9, sensor=rippled)], ())
    assert verdict.verdict == "unexplained"
    assert "speed_rad_s" in verdict.says
    assert "agrees" not in verdict.says


def test_a_regime_that_the_model_does_not_predict_is_unexplained():
    """Right where it was fitted, wrong where it was not: no claim that nothing is missing."""
    fitted = [record(f"run {s}", s) for s in (1, 2)]
    other = record("held out", 9, reach=1.3)
    bent = replace(other, values=other.values.copy())
    speed = len(MOTOR.inputs)
    bent.values[:, speed] *= 1.0 + 0.2 * np.sin(bent.time_s / 9.0)
    verdict = diagnose(MOTOR, fitted, [bent], ())
    assert verdict.verdict == "unexplained"
    assert "times as large on recordings held back" in verdict.points[0]


@pytest.mark.parametrize("seed", [0, 1])
def test_a_model_learnt_from_readings_in_disorder_agrees_with_nothing(seed):
    """They scatter as much as they err; what was held back tells what the sensor scatters."""
    fitted = record("run 1", 1)
    rng = np.random.default_rng(seed)
    shuffled = replace(fitted, values=np.stack([rng.permutation(column) for column in fitted.values.T], axis=-1))
    verdict = diagnose(MOTOR, [shuffled], [record("held out", 9)], ())
    assert verdict.verdict == "unexplained"
