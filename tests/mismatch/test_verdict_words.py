"""What a verdict says: one sentence with errors and noise, then points, and nothing that is not so."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
from motor import MOTOR
from motor_case import record

from twinbench.mismatch import Verdict, diagnose
from twinbench.mismatch.catalogue import generic
from twinbench.mismatch.evidence import FaultAlone
from twinbench.mismatch.faults import faults
from twinbench.mismatch.rivals import Rivals
from twinbench.mismatch.telling import headline
from twinbench.mismatch.verdict import conclude
from twinbench.mismatch.words import number

LISTED = (
    "coulomb_friction@omega_rad_s",
    "sensor_bias@amps_A",
    "sensor_saturation@speed_rad_s",
    "sensor_gain@T_probe_K",
)
CATALOGUE = tuple(m for m in (*generic(MOTOR), *faults(MOTOR, 0.08)) if m.name in LISTED)


def dry_friction(t, x, u):
    return np.array([0.0, -4.0 / 1.35 * np.tanh(x[1] / 1.5), 0.0])


def examined(extra=lambda t, x, u: np.zeros(3), sensor=lambda t, y: y) -> Verdict:
    fitted = [record(f"run {s}", s, extra, sensor) for s in (1, 2)]
    return diagnose(MOTOR, fitted, [record("day 3", 9, extra, sensor, reach=1.3)], CATALOGUE)


@pytest.fixture(scope="module")
def friction() -> Verdict:
    return examined(dry_friction)


def test_the_sentence_has_error_before_and_after_its_interval_and_the_noise(friction):
    held = {e.channel: e for e in friction.fit if e.held_out}
    worst = max(held.values(), key=lambda e: e.rmse_before / e.noise_sd)
    unit = re.escape(worst.unit)
    assert re.fullmatch(
        r"Dry \(Coulomb\) friction of constant size acts against omega_rad_s, whichever way it goes: on day 3 the RMS "
        rf"error of {worst.channel}, the furthest off of 3 outputs, falls from \S+ to \S+ {unit} "
        rf"\(90 % interval of the fall \S+ to \S+\); its sensor scatters by \S+ {unit} from reading to reading\.",
        friction.says,
    )
    for value in (worst.rmse_before, worst.rmse_after, -worst.change_high, -worst.change_low, worst.noise_sd):
        assert number(value) in friction.says
    assert -worst.change_high < worst.rmse_before - worst.rmse_after < -worst.change_low
    # Of noise that remembers 0.6 of itself neighbours show (6 - 8 * 0.6 + 2 * 0.36) / 6 of the variance.
    assert held["speed_rad_s"].noise_sd == pytest.approx(np.sqrt(0.32), rel=0.1)
    others = [p for p in friction.points if p.startswith("On day 3 the RMS error of ")]
    assert len(others) == 2
    assert not any(worst.channel in p for p in others)


def test_nothing_is_said_in_shares_that_mislead(friction):
    said = " ".join((friction.says, *friction.points))
    assert re.findall(r"\d+ %", said.replace("90 % interval", "")) == []
    assert "excess" not in said


def test_a_force_is_said_in_newton_metres_with_its_interval(friction):
    (finding,) = friction.findings
    assert finding.force.unit == "N m"
    assert finding.force.low < 4.0 < finding.force.high or finding.force.value == pytest.approx(4.0, rel=0.02)
    inertia = friction.values["J_kg_m2"]
    assert finding.force.value == pytest.approx(inertia * finding.parameters[0].value)
    assert f"{number(finding.parameters[0].value)} rad/s² (90 % interval " in finding.says
    assert f"{number(finding.force.value)} N m (" in finding.says


def test_an_error_that_need_not_have_changed_is_not_said_to_fall(friction):
    (amps,) = (p for p in friction.points if p.startswith("On day 3 the RMS error of T_probe_K"))
    held = next(e for e in friction.fit if e.held_out and e.channel == "T_probe_K")
    if held.change_low <= 0.0 <= held.change_high:
        assert "which may be chance" in amps
        assert "falls" not in amps


def test_of_many_candidates_all_are_listed_and_none_is_named(friction):
    names = [f"other_{i}@omega_rad_s" for i in range(4)]
    groups = (("coulomb_friction@omega_rad_s",), *((name,) for name in names))
    d = replace(friction.diagnosis, rivals=[Rivals(names, 5, groups)])
    machine = d.machine
    kinds = [
        replace(c, mechanism=replace(c.mechanism, name=n))
        for c, n in zip([machine.candidates[0]] * 4, names, strict=True)
    ]
    machine.candidates = [*machine.candidates, *kinds]
    try:
        verdict = conclude(d)
    finally:
        machine.candidates = machine.candidates[:-4]
    (finding,) = verdict.findings
    assert finding.mechanism is None
    assert finding.candidates == ("coulomb_friction@omega_rad_s", *names)
    assert all(name in verdict.points[0] for name in finding.candidates)
    assert "something is missing at balance:omega_rad_s that these recordings cannot name" in verdict.says.lower()


def test_an_onset_is_told_by_recording(friction):
    chosen = friction.diagnosis.chosen
    late = replace(chosen, problem=replace(chosen.problem, since=(62.0, np.inf)))
    (finding,) = conclude(replace(friction.diagnosis, chosen=late)).findings
    assert "It is there in run 1 from 62 s on and not in run 2." in finding.says
    since_then = replace(chosen, problem=replace(chosen.problem, since=(np.inf, -np.inf)))
    (finding,) = conclude(replace(friction.diagnosis, chosen=since_then)).findings
    assert "It is there all through run 2 and not in run 1." in finding.says
    assert "0 s" not in finding.says
    assert finding.since_s is None


def test_what_was_refused_is_not_said_to_be_in_no_catalogue(friction):
    d = replace(friction.diagnosis, chosen=None, refused="it makes T_probe_K worse")
    verdict = conclude(d)
    assert verdict.verdict == "unexplained"
    assert verdict.findings[0].probability is None
    said = " ".join((verdict.says, *verdict.points))
    assert "does not hold" not in said
    assert (
        "coulomb_friction@omega_rad_s explains what was learnt from best, but is refused: it makes T_probe_K worse"
        in said
    )


def test_faults_alone_are_told_by_the_error_that_they_leave(friction, monkeypatch):
    alone = FaultAlone(
        ("sensor_bias@amps_A",), (("speed_rad_s", "rad/s", 9.0, 31.8, 1.2), ("amps_A", "A", np.nan, 1, 1))
    )
    monkeypatch.setattr("twinbench.mismatch.evidence.best_fault_alone", lambda d: alone)
    verdict = conclude(friction.diagnosis)
    assert (
        "A fault of sensors or inputs alone, at best sensor_bias@amps_A, leaves an error of speed_rad_s of 31.8 rad/s "
        "where it learnt; what is named leaves 1.2, and the simulator with its own parameters fitted 9."
    ) in verdict.points


@pytest.mark.parametrize("compared", [0, 4])
def test_what_was_held_back_is_not_called_unused_when_it_chose(friction, compared):
    verdict = conclude(replace(friction.diagnosis, weighed_on_held_out=compared))
    (use,) = (p for p in verdict.points if p.startswith("Nothing but where it starts was learnt from day 3"))
    assert ("four explanations were compared on it" in use) == (compared == 4)
    assert verdict.to_dict()["held_out"] == {"recordings": ["day 3"], "explanations_compared": compared}


def test_several_findings_are_a_count_and_a_list(friction):
    (one,) = friction.findings
    fault = replace(one, kind="sensor fault", mechanism="sensor_bias@amps_A")
    says = headline(friction.diagnosis, "missing physics", (one, one, fault), friction.fit, True)
    lead = "The simulator lacks two effects and one sensor or input is at fault, and that is not all: on day 3 the RMS"
    assert says.startswith(lead)
    unsure = replace(one, probability=0.39)
    says = headline(friction.diagnosis, "missing physics", (one, unsure, unsure), friction.fit, False)
    assert says.startswith("The simulator lacks three effects (one of them sure by name): on day 3 the RMS")


@pytest.mark.parametrize(
    ("probability", "said"),
    [
        (0.39, "0.39"),
        (0.9999, "above 0.99"),
        (None, "not known, for nothing else was fitted in its place"),
    ],
)
def test_a_name_has_its_probability_over_all_that_was_fitted(friction, monkeypatch, probability, said):
    told = {"coulomb_friction@omega_rad_s": probability}
    monkeypatch.setattr("twinbench.mismatch.evidence.probabilities", lambda d: told)
    (finding,) = conclude(friction.diagnosis).findings
    assert finding.says.endswith(f"Its probability among all that was fitted is {said}.")
    assert finding.is_sure == (said == "above 0.99")
