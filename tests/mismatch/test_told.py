"""What a user knows beforehand: checked, read from the command line, and left out at once."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from motor import MOTOR
from motor_case import record
from motor_friction import CATALOGUE, dry_friction
from two_tanks import TANKS

from twinbench.common.errors import BadInput
from twinbench.mismatch import diagnose
from twinbench.mismatch.asked import Asked, silent
from twinbench.mismatch.model import whole_catalogue
from twinbench.mismatch.naming.weighed import weighed
from twinbench.mismatch.stage_audit import audited
from twinbench.mismatch.told import Told, read_told

LISTED = whole_catalogue(MOTOR)
DRY = "coulomb_friction@omega_rad_s"


def test_candidates_are_left_out_by_name_and_by_pattern():
    told = Told(leave_out=("*_friction@omega_rad_s", "offset@current_A"))
    told.check(MOTOR, LISTED)
    out = {m.name for m in LISTED} - {m.name for m in told.left(LISTED)}
    kinds = ("viscous", "quadratic", "cubic", "coulomb", "stribeck")
    assert out == {"offset@current_A", *(f"{kind}_friction@omega_rad_s" for kind in kinds)}
    assert Told().left(LISTED) == tuple(LISTED)


def test_what_is_left_out_is_not_in_the_machine():
    told = Told(leave_out=("sensor_*", "input_*", "*@omega_rad_s"))
    seen = audited(Asked(MOTOR, [record("run 1", 1), record("run 2", 2)], told=told), silent)
    names = {c.name for c in seen.machine.candidates}
    assert "offset@current_A" in names
    assert not [n for n in names if n.startswith(("sensor_", "input_")) or n.endswith("@omega_rad_s")]


BAD = [
    ({"leave_out": ("offset@omega",)}, "leave out 'offset@omega': no candidate has that name; did you mean 'offset@"),
    ({"leave_out": "offset@current_A"}, r"leave out 'offset@current_A': give a list of names, as \['offset@current_A'"),
    ({"prior": {"leak@h": 2.0}}, "prior of 'leak@h': no candidate has that name"),
    ({"prior": {"offset@current_A": -1.0}}, "odds are '-1.0', must be a number above 0"),
    ({"prior": {"offset@current_A": math.inf}}, "odds are 'inf', must be a number above 0"),
    ({"prior": {"offset@current_A": "often"}}, "odds are 'often', must be a number above 0"),
    ({"prior": {"offset@current_A": 2.0}, "leave_out": ("offset@*",)}, "it is left out too; take one of the two back"),
    ({"measured": {"voltage": 1.0}}, "measured 'voltage': the simulator has no such input; did you mean 'voltage_V'"),
    ({"measured": {"voltage_V": 0.0}}, "measured 'voltage_V': its noise is '0.0', must be a number above 0, in V"),
    ({"measured": {"voltage_V": math.nan}}, "its noise is 'nan'"),
]


@pytest.mark.parametrize(("told", "says"), BAD)
def test_what_does_not_fit_is_refused_in_one_line(told, says):
    with pytest.raises(BadInput, match=says) as refused:
        diagnose(MOTOR, [record("run 1", 1), record("run 2", 2)], **told)
    assert "\n" not in str(refused.value)


def test_the_command_line_says_the_same_with_units():
    told = read_told(["offset@*"], ["leak@h1_cm=0.1"], ["pump_V=20 mV"], TANKS)
    assert told.leave_out == ("offset@*",)
    assert told.prior == {"leak@h1_cm": 0.1}
    assert told.measured == pytest.approx({"pump_V": 0.02})


def test_noise_is_a_difference_of_temperatures():
    warm = replace(TANKS, inputs=(replace(TANKS.inputs[0], name="T", unit="degC"),))
    for text in ("T=0.5degC", "T=0.5 K", "T=0.9 degF"):
        assert read_told([], [], [text], warm).measured == pytest.approx({"T": 0.5})


def test_an_input_without_a_unit_needs_none():
    plain = replace(TANKS, inputs=(replace(TANKS.inputs[0], unit="1"),))
    assert read_told([], [], ["pump_V=1e-2"], plain).measured == {"pump_V": 0.01}


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("pump_V", "must read INPUT=SD and a unit"),
        ("pump_V=much", "must read INPUT=SD and a unit"),
        ("pump_V=1.2.3V", "'1.2.3' is no number"),
        ("pump_V=0.1", "has no unit; write pump_V=0.1V if that is what it is"),
        ("pump_V=0.1bar", "unit 'bar' cannot be turned into 'V'"),
        ("pump=0.1V", "no input 'pump'; did you mean 'pump_V'"),
    ],
)
def test_another_form_is_refused(text, says):
    with pytest.raises(BadInput, match=says):
        read_told([], [], [text], TANKS)


def test_told_odds_take_the_place_of_even_ones():
    """Of eight candidates each has odds of one in eight, unless something else is told."""
    drawn = [record(f"run {s}", s, dry_friction, seconds=60.0) for s in (1, 2)]

    def gain(prior: dict[str, float]) -> float:
        naming = weighed(Asked(MOTOR, drawn, (), CATALOGUE, told=Told(prior=prior))).answer.naming
        alone = next(h for h in naming.hypotheses if h.names == (DRY,))
        return alone.log - naming.null.log

    assert gain({DRY: 0.005}) - gain({}) == pytest.approx(np.log(0.005 * len(CATALOGUE)), abs=1e-6)
