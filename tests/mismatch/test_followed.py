"""An output of which the simulator explains nothing: no agreement."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from motor import MOTOR
from motor_case import record

from twinbench.data.recording import Recording
from twinbench.mismatch import Verdict, diagnose
from twinbench.mismatch.followed import strangers, told_followed
from twinbench.mismatch.tracks import prepare
from twinbench.physics.simulator import Simulator, Variable

RNG = np.random.default_rng(11)
SPEED, TEMPERATURE = 2, 4


def with_column(run: Recording, column: int, values: np.ndarray) -> Recording:
    changed = run.values.copy()
    changed[:, column] = values
    return replace(run, values=changed)


def told(column: np.ndarray, simulated: np.ndarray):
    """Of one output, when the other two are followed."""
    run = record("run", 3)
    (track,) = prepare([with_column(run, SPEED, column)], MOTOR)
    residual = np.zeros_like(track.means)
    residual[:, 0] = track.means[:, 0] - track.block_means(np.tile(simulated[:, None], 3))[:, 0]
    return told_followed([track], [residual], MOTOR.outputs, False)[0]


def test_what_is_followed_is_and_by_how_much():
    t = np.arange(1500) * 0.08
    wave, noise = 50.0 * np.sin(t / 3.0), 1.0 * RNG.normal(size=1500)
    half = told(wave + noise, 0.5 * wave)
    assert half.explained == pytest.approx(0.75, abs=0.01)
    assert half.low < half.explained < half.high
    assert half.follows
    assert half.noise_sd == pytest.approx(1.0, rel=0.3)
    assert not told(wave + noise, np.full(1500, 3.0)).follows, "a constant explains nothing"
    assert not told(wave + noise, -wave).follows


def test_a_steady_output_asks_for_nothing():
    steady = told(30.0 + 1.0 * RNG.normal(size=1500), np.full(1500, 30.0))
    assert steady.explained < 0.01
    assert steady.follows


def mass_and_other() -> Simulator:
    """A lag with two outputs that have nothing to do with each other but their input."""

    def rhs(x, u, theta):
        return np.array([(theta[0] * u[0] - x[0]) / theta[1], (theta[2] * u[0] - x[1]) / theta[3]])

    return Simulator(
        name="two lags",
        states=tuple(Variable(n, "V", -50.0, 50.0, 0.0, 2.0) for n in ("a_V", "b_V")),
        inputs=(Variable("drive_V", "V", -20.0, 20.0, 0.0, 2.0),),
        outputs=tuple(Variable(f"{n}_V", "V", -50.0, 50.0, 0.0, 2.0) for n in ("one", "two")),
        parameters=tuple(
            Variable(n, unit, low, high, 1.0, 0.5)
            for n, unit, low, high in (
                ("k1", "1", 0.0, 5.0),
                ("tau1_s", "s", 0.2, 9.0),
                ("k2", "1", 0.0, 5.0),
                ("tau2_s", "s", 0.2, 9.0),
            )
        ),
        rhs=rhs,
        output=lambda x, u, theta: x.copy(),
        initial=lambda u0, y0, theta: y0.copy(),
    )


def lags(name: str, seed: int, shuffled: bool) -> Recording:
    rng = np.random.default_rng(seed)
    n, dt_s = 900, 0.3
    drive_V = np.repeat(rng.normal(size=n // 10), 10) * 2.0
    x = np.zeros((n, 2))
    keep = np.exp(-dt_s / np.array([1.3, 2.2]))
    for k in range(n - 1):
        x[k + 1] = np.array([1.2, 0.8]) * drive_V[k] * (1.0 - keep) + keep * x[k]
    y = x + 0.02 * rng.normal(size=x.shape)
    if shuffled:
        y[:, 1] = rng.permutation(y[:, 1])
    return Recording(name, dt_s * np.arange(n), ("drive_V", "one_V", "two_V"), np.column_stack((drive_V, y)))


def verdict(shuffled: bool) -> Verdict:
    runs = [lags(f"run {k}", k, shuffled) for k in (1, 2)]
    return diagnose(mass_and_other(), runs, [lags("held out", 3, shuffled)], ())


def test_a_shuffled_column_is_no_agreement():
    """Its residual is white noise, so that every test of the residual passes."""
    wrong, right = verdict(True), verdict(False)
    assert right.verdict in ("consistent", "parameter change")
    assert right.diagnosis.unfollowed == ()
    assert wrong.verdict == "unexplained"
    (lost,) = wrong.diagnosis.unfollowed
    assert lost.channel == "two_V"
    assert lost.held_out
    assert lost.low <= 0.0
    assert "two_V" in wrong.says


def test_a_column_that_is_shuffled_only_where_it_learns_is_no_agreement():
    """So much noise is learnt that the held-out recording is within it, but it is not within its own scatter."""
    runs = [lags(f"run {k}", k, shuffled=True) for k in (1, 2)]
    wrong = diagnose(mass_and_other(), runs, [lags("held out", 3, shuffled=False)], ())
    assert wrong.verdict == "unexplained"
    assert any(p.startswith("The readings of two_V scatter") for p in wrong.points)


def test_the_same_noise_here_and_there_is_not_loud_where_it_learnt():
    """Nor does noise that is no scatter at all divide anything."""
    rng, output = np.random.default_rng(5), mass_and_other().outputs[:1]
    slow = np.sin(np.arange(600) / 40.0)[:, None]
    here, there = (a * slow + rng.normal(size=slow.shape) for a in (5.0, 7.0))
    assert strangers([here], [there], output, np.ones(1)) == ()
    assert strangers([here], [7.0 + 0.0 * slow], output, np.ones(1)) == ()
