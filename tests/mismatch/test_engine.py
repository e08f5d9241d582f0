"""The whole walk on a motor: what is missing is named, and nothing is named where nothing is missing."""

from __future__ import annotations

import json

import numpy as np
import pytest
from helpers.plain import diagnosed
from motor import MOTOR
from motor_case import record
from motor_friction import CATALOGUE, LISTED, dry_friction, examined, friction_found

from twinbench.common.errors import BadInput
from twinbench.mismatch import Verdict, diagnose


@pytest.fixture(scope="module")
def friction() -> Verdict:
    return friction_found()


def test_every_listed_mechanism_exists():
    assert {m.name for m in CATALOGUE} == set(LISTED)


def test_a_clean_machine_with_other_parameters_is_only_that():
    verdict = examined()
    assert verdict.verdict == "parameter change"
    assert verdict.findings == ()
    assert verdict.says.startswith("The simulator agrees with the recordings once its parameters are right: on ")
    assert any(p.startswith("Parameters moved, with 90 % intervals: R_ohm from") for p in verdict.points)
    after = {v.name: v for v in verdict.parameters}
    assert after["R_ohm"].low < 0.65 < after["R_ohm"].high
    assert after["J_kg_m2"].value == pytest.approx(1.35, rel=0.02)
    assert verdict.to_dict()["inexact"] == []


def test_friction_of_another_form_is_named_sized_and_proved(friction):
    assert friction.verdict == "missing physics"
    (finding,) = friction.findings
    assert finding.mechanism == "coulomb_friction@omega_rad_s"
    assert str(finding.port) == "balance:omega_rad_s"
    assert finding.parameters[0].value == pytest.approx(1.2, rel=0.08)
    assert finding.indistinguishable_from == ()
    assert finding.since_s is None
    held = {f.channel: f for f in friction.fit if f.held_out}
    assert held["amps_A"].rmse_after < 0.8 * held["amps_A"].rmse_before
    learnt = {f.channel: f for f in friction.fit if not f.held_out}
    assert held["speed_rad_s"].rmse_after == pytest.approx(learnt["speed_rad_s"].rmse_after, rel=0.15)


def test_the_force_in_its_place_goes_against_the_motion(friction):
    assert str(friction.located.port) == "balance:omega_rad_s"
    d = friction.diagnosis
    for (time_s, force), track in zip(friction.located.force, d.tracks, strict=True):
        speed = np.interp(time_s, track.block_time_s, track.means[:, 0])
        assert np.corrcoef(force, -np.sign(speed))[0, 1] > 0.7


def test_the_mended_values_are_those_of_the_machine(friction):
    assert friction.values["b_Nms"] == pytest.approx(0.06, abs=0.006)
    assert friction.values["R_ohm"] == pytest.approx(0.65, rel=0.01)


def test_a_false_sensor_is_no_physics():
    verdict = examined(sensor=lambda t, y: y + np.array([0.0, 3.0, 0.0]))
    assert verdict.verdict == "sensor fault"
    assert [f.mechanism for f in verdict.findings] == ["sensor_bias@amps_A"]
    assert verdict.findings[0].parameters[0].value == pytest.approx(3.0, abs=0.2)


def test_what_no_candidate_can_be_is_not_named():
    cogging = examined(lambda t, x, u: np.array([0.0, 2.0 * np.sin(0.05 * x[1] ** 2), 0.0]))
    assert cogging.mechanisms == () or "and that is not all" in cogging.says


def test_what_is_too_small_to_be_missing_is_told_where_it_is():
    wavy = examined(lambda t, x, u: np.array([0.0, 0.3 * np.sin(0.05 * x[1]), 0.0]))
    assert (wavy.verdict, wavy.findings) == ("parameter change", ())
    assert wavy.to_dict()["inexact"][0]["port"] == "balance:omega_rad_s"
    assert any(p.startswith("The equations are inexact at balance:omega_rad_s, by about ") for p in wavy.points)


def test_two_effects_are_both_named():
    verdict = examined(dry_friction, lambda t, y: y + np.array([0.0, 3.0, 0.0]))
    assert {f.mechanism for f in verdict.findings} == {"coulomb_friction@omega_rad_s", "sensor_bias@amps_A"}


def test_an_effect_that_begins_late_is_dated():
    fitted = [record(f"run {s}", s, lambda t, x, u: dry_friction(t, x, u) * (t > 70.0)) for s in (1, 2)]
    verdict = diagnosed(MOTOR, fitted, [record("held out", 9, dry_friction, reach=1.3)], CATALOGUE)
    (finding,) = verdict.findings
    assert finding.mechanism == "coulomb_friction@omega_rad_s"
    assert finding.since_s == pytest.approx(70.0, abs=5.0)
    assert finding.parameters[0].value == pytest.approx(1.2, rel=0.15)


def test_what_only_a_few_seconds_lack_is_dated_too():
    """Dry friction that is absent for the first twelfth of the time only."""
    fitted = [record(f"run {s}", s, lambda t, x, u: 6.0 * dry_friction(t, x, u) * (t > 10.0)) for s in (1, 2)]
    verdict = diagnosed(MOTOR, fitted, [record("held out", 9, lambda t, x, u: 6.0 * dry_friction(t, x, u))], CATALOGUE)
    assert verdict.findings[0].mechanism == "coulomb_friction@omega_rad_s"
    assert verdict.findings[0].since_s == pytest.approx(10.0, abs=1.0)


def test_the_verdict_is_json_and_the_same_twice(friction):
    again = examined(dry_friction)
    assert json.dumps(again.to_dict()) == json.dumps(friction.to_dict())
    assert {"verdict", "says", "points", "findings", "parameters", "fit", "more_data"} <= set(friction.to_dict())


def test_a_recording_too_short_is_refused():
    with pytest.raises(BadInput, match="too few to learn from"):
        diagnose(MOTOR, [record("short", 1, seconds=1.5)], [record("held out", 2)], CATALOGUE)


def test_progress_goes_through_the_stages_to_their_ends_and_never_back():
    seen: list[tuple[str, float]] = []
    fitted = [record(f"run {s}", s, dry_friction, seconds=60.0) for s in (1, 2)]
    diagnose(MOTOR, fitted, (), CATALOGUE, lambda stage, share: seen.append((stage, share)))
    stages = list(dict.fromkeys(stage for stage, _ in seen))
    assert stages == ["audit", "calibrate", "screen", "prove"]
    for stage in stages:
        shares = [share for s, share in seen if s == stage]
        assert shares == sorted(set(shares))
        assert shares[0] == 0.0 or stage == "screen"
        assert shares[-1] == 1.0
        assert len(shares) >= 4 or stage == "prove", "not from nothing to all at once"
