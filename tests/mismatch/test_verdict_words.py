"""What a verdict says: one sentence with errors and noise, then points, and nothing that is not so."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
from helpers.plain import diagnosed
from motor import MOTOR
from motor_case import record

from twinbench.mismatch import Verdict
from twinbench.mismatch.catalogue import generic
from twinbench.mismatch.design.suggested import suggested
from twinbench.mismatch.faults import faults
from twinbench.mismatch.naming.answer import Unnamed
from twinbench.mismatch.naming.decision import Claim, decided, probability
from twinbench.mismatch.naming.whiteness import Coloured
from twinbench.mismatch.telling import at_one_port, headline, points
from twinbench.mismatch.verdict import conclude
from twinbench.mismatch.words import number
from twinbench.physics.simulator import Port

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
    return diagnosed(MOTOR, fitted, [record("day 3", 9, extra, sensor, reach=1.3)], CATALOGUE)


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
        rf"\(90 % interval of the fall \S+ to \S+\); the noise of its sensor from reading to reading is \S+ {unit}\.",
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
    assert finding.force.value == pytest.approx(inertia * finding.parameters[0].value, rel=1e-3)
    assert f"{number(finding.parameters[0].value)} rad/s² (90 % interval " in finding.says
    assert f"{number(finding.force.value)} N m (" in finding.says


def test_an_error_that_need_not_have_changed_is_not_said_to_fall(friction):
    (amps,) = (p for p in friction.points if p.startswith("On day 3 the RMS error of T_probe_K"))
    held = next(e for e in friction.fit if e.held_out and e.channel == "T_probe_K")
    if held.change_low <= 0.0 <= held.change_high:
        assert "which may be chance" in amps
        assert "falls" not in amps


def claiming(
    verdict: Verdict, *names: str, alike: bool = False, probability: float = 0.97, stands: bool = False
) -> Verdict:
    """The verdict, had the rule said other names; ``stands`` if what has none mends the model all the same."""
    d = verdict.diagnosis
    (claim,) = d.claims
    weights = {name: 1.0 / max(len(names), 1) for name in names or claim.found.weights}
    found = replace(claim.found, weights=weights)
    port_of = {c.name: c.mechanism.port for c in d.machine.candidates}
    ports = tuple((port_of[name], p) for name, p in weights.items()) if names else claim.ports
    said = replace(claim, names=names, alike=alike, probability=probability, ports=ports, found=found)
    mended, held_after = (d.mended, d.held_after) if names or stands else (None, None)
    return conclude(replace(d, claims=(said,), mended=mended, held_after=held_after))


DRY, BIAS, GAIN = "coulomb_friction@omega_rad_s", "sensor_bias@amps_A", "sensor_gain@T_probe_K"


def test_what_is_missing_by_thousands_of_nats_is_certain_and_stops_nothing(friction):
    answer = friction.diagnosis.answer
    left = (replace(answer.left[0], log=5000.0), *answer.left[1:])
    assert decided(replace(answer, left=left), [1.0])[-1].probability == 1.0
    assert probability({"constant": -5000.0}, {}) == 0.0


def test_a_set_lists_its_names_with_probabilities_and_what_to_record(friction):
    verdict = claiming(friction, DRY, BIAS)
    (finding,) = verdict.findings
    assert (finding.mechanism, finding.indistinguishable_from) == (DRY, (BIAS,))
    assert finding.kind == "unexplained", "one is physics, the other a sensor"
    assert f"One of {DRY} (probability 0.5) and {BIAS} (probability 0.5)." in finding.says
    assert verdict.more_data.startswith(f"To tell {DRY} from {BIAS}, record where their effects differ")
    assert verdict.says.startswith(f"One of {DRY} and {BIAS} is missing or at fault: on day 3")
    assert dict(finding.ports) == {Port("balance", "omega_rad_s"): 0.5, Port("output", "amps_A"): 0.5}


def test_a_set_carries_the_best_experiment_of_a_few(friction):
    d = claiming(friction, DRY, BIAS).diagnosis
    found = suggested(d.answer, d.claims)
    assert found is not None
    assert set(found.rivals) == {DRY, BIAS}
    told = conclude(replace(d, experiment=found._replace(probability=0.8))).more_data
    assert f"apart is {found.says}: it leaves the right name alone with probability 0.8." in told
    silent = conclude(replace(d, experiment=found._replace(probability=0.0))).more_data
    assert "experiment" not in silent


def test_names_that_are_one_thing_are_said_in_one_sentence(friction):
    verdict = claiming(friction, DRY, BIAS, alike=True)
    (finding,) = verdict.findings
    assert f"({DRY}, at balance:omega_rad_s) or " in finding.says
    assert f"({BIAS}, at output:amps_A), which do the same in these recordings." in finding.says
    assert finding.kind == verdict.verdict == "missing physics", "of the likelier one's kind"
    assert verdict.more_data == "", "no recording helps"


def test_what_has_too_many_names_is_a_place(friction):
    verdict = claiming(friction, probability=0.7)
    (finding,) = verdict.findings
    assert (verdict.verdict, finding.mechanism, finding.parameters) == ("unexplained", None, ())
    assert finding.says == (
        f"Something that these recordings cannot name acts at balance:omega_rad_s: {DRY} explains it best, and is "
        "right with probability 0.3."
    )
    assert verdict.says.startswith("Something that these recordings cannot name acts at balance:omega_rad_s: on day 3")
    assert verdict.mechanisms == ()


def test_what_has_no_name_may_mend_the_model_all_the_same(friction):
    verdict = claiming(friction, probability=0.7, stands=True)
    (finding,) = verdict.findings
    assert (verdict.verdict, finding.mechanism, finding.stand_in) == ("unexplained", None, DRY)
    assert finding.says.endswith(
        f"{DRY} explains it best, and is right with probability 0.3. Until more is known {DRY} stands in for it in the "
        "mended model."
    )
    assert verdict.says.startswith(
        "Something that these recordings cannot name acts at balance:omega_rad_s, and "
        f"{DRY} stands in for it: on day 3 the RMS error of "
    )
    assert [m.name for m in verdict.mechanisms] == [DRY]
    assert verdict.values == friction.values
    assert finding.parameters == friction.findings[0].parameters


def test_several_that_stand_in_at_one_port_are_told_together(friction):
    d = claiming(friction, probability=0.7, stands=True).diagnosis
    (one,) = d.claims
    other = replace(one, probability=0.8, found=replace(one.found, name=BIAS))
    verdict = conclude(replace(d, claims=(one, other)))
    assert len(verdict.findings) == 2
    assert verdict.points[0] == (
        f"Something that these recordings cannot name acts at balance:omega_rad_s: {DRY} and {BIAS} explain it best, "
        "none of them with a probability above 0.3. Until more is known they stand in for it in the mended model."
    )
    assert "cannot name" not in verdict.points[1]


def test_several_that_explain_one_port_are_told_together_where_nothing_is_mended_too(friction):
    d = claiming(friction, probability=0.7).diagnosis
    (one,) = d.claims
    other = replace(one, probability=0.8, found=replace(one.found, name=BIAS))
    points = conclude(replace(d, claims=(one, other))).points
    assert points[0] == (
        f"Something that these recordings cannot name acts at balance:omega_rad_s: {DRY} and {BIAS} explain it best, "
        "none of them with a probability above 0.3."
    )
    assert "cannot name" not in points[1]


def test_what_draws_one_thing_is_told_apart_from_the_other_stand_ins(friction):
    d = claiming(friction, probability=0.7, stands=True).diagnosis
    (one,) = d.claims
    echo = replace(one, found=replace(one.found, name=BIAS, evidence={**one.found.evidence, "echo": 1.0}))
    apart = conclude(replace(d, claims=(one, echo))).points[:2]
    assert f"{DRY} explains it best, and is right with probability 0.3." in apart[0]
    assert f"{BIAS} explains it best, but several effects" in apart[1]


def test_of_what_draws_one_thing_with_others_no_probability_is_told(friction):
    d = claiming(friction, probability=0.7).diagnosis
    (claim,) = d.claims
    echo = replace(claim, found=replace(claim.found, evidence={**claim.found.evidence, "echo": 1.0}))
    (finding,) = conclude(replace(d, claims=(echo,))).findings
    assert finding.says.endswith(
        f"{DRY} explains it best, but several effects of one channel or period stand in for one cause, which is none "
        "of them."
    )


@pytest.mark.parametrize(("longest_s", "how"), [(8.2, "a period of about 8.1 s"), (16.0, "periods of 8 to 16 s")])
def test_what_swings_in_what_is_left_is_told_where_it_is_sure(friction, longest_s, how):
    d = friction.diagnosis
    assert not any("noise alone" in point for point in friction.points)

    def said(**differs: float) -> list[str]:
        colour = Coloured(11.0, 1, 3.4, 8.0, longest_s)._replace(**differs)
        verdict = conclude(replace(d, answer=replace(d.answer, coloured=colour)))
        assert verdict.to_dict()["coloured"]["channel"] == "amps_A"
        return [point for point in verdict.points if "noise alone" in point]

    (point,) = said()
    assert point.startswith(
        f"The residual of amps_A is not noise alone: at {how} its power is 3.4 times that of the noise"
    )
    assert said(nats=9.0) == said(power=0.5) == []


def test_from_far_off_no_probability_is_told(friction):
    d = friction.diagnosis
    left = (replace(d.answer.left[0], log=5.0), *d.answer.left[1:])
    answer = replace(d.answer, left=left, naming=replace(d.answer.naming, far=True))
    verdict = conclude(replace(d, answer=answer, claims=decided(answer, [1.0]), mended=None, held_after=None))
    assert (
        "but the simulator is so far off, and so much is left, that other sets may explain as much" in verdict.points[0]
    )
    assert verdict.findings[0].mechanism is None


@pytest.mark.parametrize(("again", "named"), [(5, True), (4, False)])
def test_from_far_off_a_name_must_be_in_the_likeliest_set_of_most_halves(friction, again, named):
    d = friction.diagnosis
    answer = replace(d.answer, naming=replace(d.answer.naming, far=True))
    check = replace(d.self_check, named_again=0, each_again=(again,), halves=10)
    claims = decided(answer, check.again)
    assert bool(claims[0].names) == named
    verdict = conclude(replace(d, answer=answer, claims=claims, self_check=check))
    assert ("sets without it are likelier in most halves" in verdict.points[0]) != named


def test_from_far_off_each_effect_is_judged_by_the_halves_that_hold_it(friction):
    answer = friction.diagnosis.answer
    two = replace(answer, found=answer.found * 2, naming=replace(answer.naming, far=True))
    assert [bool(c.names) for c in decided(two, (0.9, 0.4))] == [True, False]


def test_something_unnamed_beside_a_name_is_incomplete(friction):
    d, port = friction.diagnosis, Port("balance", "T_winding_K")
    left = (Unnamed(port, 1.5, 2.3), Unnamed(Port("balance", "current_A"), -9.0, 0.1))
    also = Claim((), False, 0.8, ((port, 1.0),), None)
    verdict = conclude(replace(d, claims=(*d.claims, also), answer=replace(d.answer, left=left)))
    assert verdict.verdict == "incomplete"
    named, beside = verdict.findings
    assert named.mechanism == DRY
    assert beside.names == ()
    assert [port for port, _ in beside.ports] == [port]
    assert "Something else that these recordings cannot name acts at balance:T_winding_K: about 2.3 %" in beside.says
    assert verdict.says.startswith("The simulator lacks one effect, and something else that these recordings")


@pytest.mark.parametrize(
    ("none", "lingers", "word"),
    [(0.3, False, "missing physics"), (0.7, False, "incomplete"), (0.3, True, "incomplete")],
)
def test_a_verdict_is_incomplete_if_likelier_than_not_no_candidate_explains_the_rest(friction, none, lingers, word):
    d = friction.diagnosis
    (dry,) = d.answer.found
    also = replace(dry, evidence={**dry.evidence, "lingers": float(lingers)})
    claim = replace(d.claims[0], names=(), probability=none, found=also)
    d = replace(d, claims=(*d.claims, claim), answer=replace(d.answer, found=(dry, also)))
    verdict = conclude(replace(d, self_check=replace(d.self_check, each_again=(10, 10))))
    assert [bool(f.names) for f in verdict.findings] == [True, False]
    assert verdict.verdict == word


def test_something_unnamed_where_a_name_was_unsure_is_one_thing(friction):
    d, port = friction.diagnosis, Port("balance", "omega_rad_s")
    unsure = replace(d.claims[0], names=(), probability=0.7)
    left = (Unnamed(port, 1.5, 2.3),)
    claims = (unsure, Claim((), False, 0.8, ((port, 1.0),), None))
    answer = replace(d.answer, left=left)
    verdict = conclude(replace(d, claims=claims, answer=answer, mended=None, held_after=None))
    assert len(verdict.findings) == 1
    elsewhere = Port("balance", "T_winding_K")
    claims = (unsure, unsure, Claim((), False, 0.8, ((elsewhere, 1.0),), None))
    answer = replace(d.answer, left=(Unnamed(elsewhere, 1.5, 2.3),))
    verdict = conclude(replace(d, claims=claims, answer=answer, mended=None, held_after=None))
    assert verdict.says.startswith(
        "Something that these recordings cannot name acts at balance:omega_rad_s and balance:T_winding_K: on day 3"
    )


def test_two_laws_at_one_port_may_be_one(friction):
    (dry,) = friction.findings
    other = replace(dry, mechanism="quadratic_friction@omega_rad_s")
    assert list(at_one_port([dry, other])) == [
        "coulomb_friction@omega_rad_s and quadratic_friction@omega_rad_s act at one port: a single law that the "
        "catalogue does not hold may do what they do together."
    ]
    elsewhere = replace(other, port=Port("balance", "current_A"))
    nameless = replace(other, mechanism=None)
    unsure = replace(other, indistinguishable_from=("cubic_friction@omega_rad_s",))
    for two in ([dry], [dry, elsewhere], [dry, nameless], [dry, unsure]):
        assert not list(at_one_port(two))


def test_an_onset_is_told_by_recording(friction):
    d = friction.diagnosis
    tracks = [d.tracks[0], replace(d.tracks[1], time_s=d.tracks[1].time_s + 500.0)]

    def since(since_s: float) -> Verdict:
        chosen = d.answer.chosen
        late = replace(chosen, problem=replace(chosen.problem, since=(since_s,) * 2))
        return conclude(replace(d, tracks=tracks, answer=replace(d.answer, chosen=late)))

    (finding,) = since(62.0).findings
    assert "It is there in run 1 from 62 s on and all through run 2." in finding.says
    assert [o.into_s for o in finding.onsets] == [pytest.approx(62.0), None]
    (finding,) = since(520.0).findings
    assert "It is there in run 2 from 520 s on and not in run 1." in finding.says
    assert finding.since_s == 520.0
    (finding,) = since(-np.inf).findings
    assert finding.since_s is None
    assert finding.onsets == ()


def test_what_was_refused_is_not_said_to_be_in_no_catalogue(friction):
    d = friction.diagnosis
    unsaid = tuple(replace(c, names=()) for c in d.claims)
    refused = replace(d, claims=unsaid, mended=None, held_after=None, refused="it makes T_probe_K worse")
    verdict = conclude(refused)
    assert verdict.verdict == "unexplained"
    said = " ".join((verdict.says, *verdict.points))
    assert f"{DRY} explains what was learnt from best, but is refused: it makes T_probe_K worse" in said


def test_from_one_recording_it_is_told_what_could_not_be_checked(friction):
    d = friction.diagnosis
    alone = list(points(replace(d, tracks=d.tracks[:1]), (), (), friction.fit, ()))
    says = "Only run 1 was learnt from, so whether sizes and parameters are the same in other recordings could not "
    assert says + "be checked." in alone
    assert not any(says in p for p in friction.points)


def test_what_was_held_back_may_only_refuse(friction):
    (use,) = (p for p in friction.points if p.startswith("Only the start state was learnt from day 3"))
    assert use.endswith("chose nothing, and counts only in whether a name is given and the model mended.")
    assert friction.to_dict()["held_out"] == {"recordings": ["day 3"], "worse": []}


def test_several_findings_are_a_count_and_a_list(friction):
    (one,) = friction.findings
    fault = replace(one, kind="sensor fault", mechanism=BIAS)
    says = headline(friction.diagnosis, "incomplete", (one, one, fault), friction.fit, ["more"])
    lead = "The simulator lacks two effects, and one sensor or input is at fault, and that is not all: on day 3 the RMS"
    assert says.startswith(lead)
    says = headline(friction.diagnosis, "missing physics", (one, one, one), friction.fit, [])
    assert says.startswith("The simulator lacks three effects: on day 3 the RMS")


@pytest.mark.parametrize(("probability", "said"), [(0.39, "0.39"), (0.9999, "above 0.99")])
def test_a_finding_says_how_likely_it_is_right(friction, probability, said):
    (finding,) = claiming(friction, DRY, probability=probability).findings
    assert finding.says.endswith(f"The probability that this is right is {said}.")
    assert finding.to_dict()["probability"] == probability
