"""Figures that words are made of: probabilities over everything fitted, errors with intervals, ports, onsets."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from motor import MOTOR
from motor_case import record
from motor_friction import CATALOGUE, dry_friction, friction_found

from twinbench.mismatch import Verdict, diagnose
from twinbench.mismatch.evidence import (
    best_fault_alone,
    candidates_for,
    onsets,
    output_errors,
    port_weights,
    probabilities,
    weights,
)
from twinbench.mismatch.proof import Held, Worse, worse_outputs
from twinbench.mismatch.rivals import NEAR_UNITS
from twinbench.mismatch.weigh import refusal
from twinbench.physics.simulator import Port

DRY = "coulomb_friction@omega_rad_s"


@pytest.fixture(scope="module")
def friction() -> Verdict:
    return friction_found()


def weighed(losses: dict[frozenset[str], float], chosen: tuple[str, ...] = ("a",)):
    ports = {"a": "balance:x", "b": "output:y", "c": "balance:x", "a, unequal": "balance:x"}
    candidates = [
        SimpleNamespace(name=n, family=n.partition(",")[0], mechanism=SimpleNamespace(port=port))
        for n, port in ports.items()
    ]
    machine = SimpleNamespace(candidates=candidates)
    return SimpleNamespace(losses=losses, chosen=SimpleNamespace(names=chosen), machine=machine)


def test_a_probability_is_weighed_against_everything_fitted_no_effect_at_all_too():
    a, b, none = frozenset("a"), frozenset("b"), frozenset()
    d = weighed({a: 0.0, b: 0.0, none: 0.0})
    assert probabilities(d)["a"] == pytest.approx(1.0 / 3.0)
    assert sum(weights(d).values()) == pytest.approx(1.0)
    far = weighed({a: 0.0, b: 10.0 * NEAR_UNITS, none: 20.0 * NEAR_UNITS})
    assert 0.9999 < probabilities(far)["a"] < 1.0


def test_what_was_never_weighed_against_another_has_no_probability():
    a, none = frozenset("a"), frozenset()
    assert probabilities(weighed({a: 0.0, none: 500.0})) == {"a": None}
    assert probabilities(weighed({frozenset("ab"): 0.0, a: 300.0, frozenset("b"): 300.0}, ("a", "b"))) == {
        "a": None,
        "b": None,
    }


def test_what_contains_an_effect_is_no_rival_of_it():
    a, general, b = frozenset(["a"]), frozenset(["a, unequal"]), frozenset(["b"])
    assert probabilities(weighed({a: 0.0, general: 0.0})) == {"a": None}
    assert probabilities(weighed({a: 0.0, general: 0.0, b: 0.0}))["a"] == pytest.approx(2.0 / 3.0)


def test_ports_go_with_the_names():
    d = weighed({frozenset("a"): 0.0, frozenset("c"): 0.0, frozenset("b"): 30.0, frozenset(): 900.0})
    ports = dict(port_weights(d))
    assert list(ports) == ["balance:x", "output:y"]
    assert ports["balance:x"] == pytest.approx(1.0 - ports["output:y"])


def test_the_accepted_effect_was_weighed_against_the_nearest_other(friction):
    d = friction.diagnosis
    (p,) = probabilities(d).values()
    assert 0.9 < p <= 1.0
    assert any(names and DRY not in names for names in d.losses)
    assert frozenset() in d.losses
    assert friction.findings[0].probability == p
    assert friction.findings[0].port == friction.located.ports[0][0]


def test_the_first_port_is_never_against_the_verdict(friction):
    assert friction.located.ports[0][0] == Port("balance", "omega_rad_s")
    assert dict(friction.located.ports).get(Port("output", "speed_rad_s"), 0.0) < 0.1


def test_errors_are_told_output_by_output_with_their_noise(friction):
    told = {(e.channel, e.held_out): e for e in output_errors(friction.diagnosis)}
    amps, probe = told["amps_A", True], told["T_probe_K", True]
    assert amps.rmse_after < 0.8 * amps.rmse_before
    assert amps.change_low < amps.rmse_after - amps.rmse_before < amps.change_high < 0.0
    assert probe.change_low < 0.1
    for e in told.values():
        assert 0.3 * e.rmse_after < e.noise_sd < 1.2 * e.rmse_after, "coloured noise is underrated, never overrated"


def test_the_best_fault_alone_is_told_as_errors_not_as_a_share(friction):
    alone = best_fault_alone(friction.diagnosis)
    assert set(alone.names) <= {m.name for m in CATALOGUE if "@" in m.name and m.kind != "physics"}
    for _, _, before, fault, named in alone.errors:
        assert named <= 1.01 * fault <= 1.03 * before


def test_all_names_of_an_effect_are_listed_its_own_first(friction):
    groups = candidates_for(friction.diagnosis, DRY)
    assert groups[0][0] == DRY
    assert {n for group in groups for n in group} == {DRY, *friction.diagnosis.rivals[0].names}
    assert onsets(friction.diagnosis) == ()


def test_it_is_told_that_the_held_out_recordings_chose(friction):
    assert friction.diagnosis.weighed_on_held_out > 1
    calm = diagnose(MOTOR, [record("run", s) for s in (1,)], [record("held out", 9)], ())
    assert calm.diagnosis.weighed_on_held_out == 0


def held(*columns: np.ndarray) -> Held:
    residual = np.stack(columns, axis=1)
    return Held([residual], np.sqrt(np.mean(residual**2, axis=0)), [], [], [1.0])


def test_an_effect_that_spoils_one_output_is_refused_however_much_it_helps_another():
    rng = np.random.default_rng(5)
    n = 800
    noise = rng.normal(size=(4, n))
    before = held(6.0 * np.sin(np.arange(n) / 9.0) + noise[0], noise[1], noise[2])
    spoilt = held(noise[0], noise[1] + 0.6 * np.sin(np.arange(n) / 11.0), noise[2])
    (worse,) = worse_outputs(before, spoilt, MOTOR.outputs)
    assert worse.channel == MOTOR.outputs[1].name
    assert worse.p < 0.05
    assert worse.before < worse.after
    assert MOTOR.outputs[1].name in refusal(None, None, [worse])


def test_what_differs_by_chance_alone_spoils_nothing():
    rng = np.random.default_rng(6)
    refused = 0
    for _ in range(200):
        before = rng.normal(size=(3, 400))
        change = 0.05 * rng.normal(size=(3, 400))
        refused += bool(worse_outputs(held(*before), held(*(before + change)), MOTOR.outputs))
    assert refused <= 12


def test_a_spoilt_output_makes_the_verdict_refuse(friction, monkeypatch):
    assert friction.diagnosis.worse == ()
    monkeypatch.setattr("twinbench.mismatch.stage_prove.worse_outputs", lambda *a: (Worse("amps_A", 1.0, 1.5, 0.001),))
    fitted = [record(f"run {s}", s, dry_friction) for s in (1, 2)]
    verdict = diagnose(MOTOR, fitted, [record("held out", 9, dry_friction, reach=1.3)], CATALOGUE)
    assert verdict.verdict == "unexplained"
    assert verdict.mechanisms == ()
    assert "amps_A from 1 to 1.5" in verdict.findings[0].says
