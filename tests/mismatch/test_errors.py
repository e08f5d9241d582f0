"""Errors with intervals, and held-out recordings that refuse what spoils an output."""

from __future__ import annotations

import numpy as np
import pytest
from helpers.plain import diagnosed
from motor import MOTOR
from motor_case import record
from motor_friction import CATALOGUE, dry_friction, friction_found

from twinbench.mismatch import Verdict, diagnose
from twinbench.mismatch.errors import output_errors
from twinbench.mismatch.followed import strangers
from twinbench.mismatch.proof import Held, Worse, worse_outputs


@pytest.fixture(scope="module")
def friction() -> Verdict:
    return friction_found()


def test_errors_are_told_output_by_output_with_their_noise(friction):
    told = {(e.channel, e.held_out): e for e in output_errors(friction.diagnosis)}
    amps, probe = told["amps_A", True], told["T_probe_K", True]
    assert amps.rmse_after < 0.8 * amps.rmse_before
    assert amps.change_low < amps.rmse_after - amps.rmse_before < amps.change_high < 0.0
    assert probe.change_low < 0.1
    for e in told.values():
        assert 0.3 * e.rmse_after < e.noise_sd < 1.2 * e.rmse_after, "coloured noise is underrated, never overrated"


def held(*columns: np.ndarray) -> Held:
    residual = np.stack(columns, axis=1)
    return Held([residual], np.sqrt(np.mean(residual**2, axis=0)), [], [])


def test_an_effect_that_spoils_one_output_is_worse_there_however_much_it_helps_another():
    rng = np.random.default_rng(5)
    n = 800
    noise = rng.normal(size=(4, n))
    before = held(6.0 * np.sin(np.arange(n) / 9.0) + noise[0], noise[1], noise[2])
    spoilt = held(noise[0], noise[1] + 0.6 * np.sin(np.arange(n) / 11.0), noise[2])
    (worse,) = worse_outputs(before, spoilt, MOTOR.outputs)
    assert worse.channel == MOTOR.outputs[1].name
    assert worse.p < 0.05
    assert worse.before < worse.after


def test_what_differs_by_chance_alone_spoils_nothing():
    rng = np.random.default_rng(6)
    refused = 0
    for _ in range(200):
        before = rng.normal(size=(3, 400))
        change = 0.05 * rng.normal(size=(3, 400))
        refused += bool(worse_outputs(held(*before), held(*(before + change)), MOTOR.outputs))
    assert refused <= 12


def with_spoilt_output(monkeypatch, gain: float):
    """The verdict on the motor with dry friction, one output spoilt, and held-out readings foretold so much better."""
    monkeypatch.setattr("twinbench.mismatch.stage_prove.worse_outputs", lambda *a: (Worse("amps_A", 1.0, 1.5, 0.001),))
    logs = iter((gain, 0.0))
    monkeypatch.setattr("twinbench.mismatch.stage_prove.foretold", lambda *a: next(logs))
    fitted = [record(f"run {s}", s, dry_friction) for s in (1, 2)]
    return diagnosed(MOTOR, fitted, [record("held out", 9, dry_friction, reach=1.3)], CATALOGUE)


def test_a_run_that_errs_by_what_its_parameters_leave_uncertain_refuses_nothing(monkeypatch):
    verdict = with_spoilt_output(monkeypatch, 50.0)
    assert [f.names for f in verdict.findings] == [("coulomb_friction@omega_rad_s",)]
    assert verdict.diagnosis.worse == ()


def test_a_spoilt_output_makes_the_verdict_refuse(friction, monkeypatch):
    assert friction.diagnosis.worse == ()
    verdict = with_spoilt_output(monkeypatch, -1.0)
    assert verdict.verdict == "unexplained"
    assert verdict.mechanisms == ()
    (finding,) = verdict.findings
    assert finding.names == ()
    assert str(finding.port) == "balance:omega_rad_s"
    assert "amps_A grow from 1 to 1.5" in finding.says
    assert all(e.rmse_before == e.rmse_after for e in verdict.fit)


def test_errors_that_are_larger_where_nothing_was_learnt_are_strange():
    rng = np.random.default_rng(3)
    learnt, floor = [rng.normal(size=(600, 3))], np.ones(3)
    louder = [rng.normal(size=(600, 3)) * [1.0, 5.0, 1.5]]
    (said,) = strangers(learnt, louder, MOTOR.outputs, floor)
    assert said.startswith(f"the errors of {MOTOR.outputs[1].name} are ")
    assert float(said.split(" are ")[1].split()[0]) == pytest.approx(5.0, rel=0.15)


def test_a_simulator_that_fails_in_another_regime_is_not_called_right():
    """The friction is not there where it learns, and large where nothing was learnt."""
    strong = record("held out", 9, lambda t, x, u: 10.0 * dry_friction(t, x, u))
    verdict = diagnose(MOTOR, [record("run 1", 1), record("run 2", 2)], [strong], CATALOGUE)
    assert verdict.verdict == "unexplained"
    assert any("as large on recordings held back" in p for p in verdict.points)
