"""Numbers, units and sentences as people read them."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from twinbench.mismatch.words import (
    counted,
    digits_worth,
    interval,
    listed,
    number,
    sentence,
    spoken,
    typeset,
    with_unit,
)


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (4.189, "4.19"),
        (-0.02211, "−0.0221"),
        (0.0, "0"),
        (1.03e-5, "1.03 × 10⁻⁵"),
        (-2e-7, "−2 × 10⁻⁷"),
        (4190.4, "4,190"),
        (12345.0, "12,300"),
        (999.6, "1,000"),
        (99999.0, "1 × 10⁵"),
        (1.2e9, "1.2 × 10⁹"),
        (100.0, "100"),
        (float("nan"), "–"),
        (float("inf"), "–"),
    ],
)
def test_a_number_has_three_digits_and_a_true_minus(value, text):
    assert number(value) == text


@given(st.floats(-1e12, 1e12), st.integers(3, 6))
def test_a_number_reads_back_as_itself(value, digits):
    text = number(value, digits).replace("−", "-").replace(",", "")
    mantissa, _, power = text.partition(" × 10")
    read = float(mantissa) * 10.0 ** int(power.translate(str.maketrans("⁻⁰¹²³⁴⁵⁶⁷⁸⁹", "-0123456789")) or 0)
    assert read == pytest.approx(value, rel=0.6 * 10.0 ** (1 - digits), abs=1e-300)
    assert "-" not in number(value, digits)


@pytest.mark.parametrize(
    ("unit", "text"),
    [
        ("(rad/s)/s", "rad/s²"),
        ("(m/s)/s", "m/s²"),
        ("kg m^2", "kg m²"),
        ("m**0.5/s", "m^0.5/s"),
        ("V^0.5/s", "V^0.5/s"),
        ("N m/(rad/s)^2", "N m/(rad/s)²"),
        ("1", ""),
        ("", ""),
        ("1/bar/s", "1/bar/s"),
    ],
)
def test_a_unit_is_written_as_by_hand(unit, text):
    assert spoken(unit) == text


def test_an_interval_has_as_many_digits_as_it_is_worth():
    assert digits_worth(4.19, 4.16, 4.22) == 3
    assert interval(4.16, 4.22, digits_worth(4.19, 4.16, 4.22)) == "4.16 to 4.22"
    assert digits_worth(0.010011553, 0.00999994, 0.01002317) == 4
    assert digits_worth(1.0, 1.0 - 1e-12, 1.0 + 1e-12) == 6
    assert digits_worth(1.0, -5.0, 7.0) == 3


def test_lists_and_counts():
    assert listed([]) == ""
    assert listed(["a"]) == "a"
    assert listed(["a", "b", "c"]) == "a, b and c"
    assert listed(["a", "b", "c", "d"], most=2) == "a, b and 2 more"
    assert counted(1, "effect") == "one effect"
    assert counted(12, "effect") == "12 effects"
    assert counted(2, "was", "were") == "two were"
    assert with_unit(0.5, "1") == "0.5"


def test_signs_are_set_and_hyphens_stay():
    assert typeset("speed-1 > -40.01 and p <= 3 - 0.5 e-3") == "speed-1 > −40.01 and p ≤ 3 − 0.5 e-3"


def test_a_sentence_has_a_capital_but_a_name_keeps_its_own():
    assert sentence("dry friction acts") == "Dry friction acts."
    assert sentence("level overflows", {"level"}) == "level overflows."
    assert sentence("h1_V overflows.") == "h1_V overflows."
