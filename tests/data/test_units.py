"""Units are names with small powers: nothing else reaches pint, which works out whatever it is given."""

from __future__ import annotations

import time

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from twinbench.common.errors import BadInput
from twinbench.data.units import LONGEST_UNIT, convert

AT_MOST_S = 1.0
NAMES = st.sampled_from("m kg Ym bar degC s rpm N 1 % 10 9 99 x inf e °".split())
SIGNS = st.sampled_from([" ", *"** ^ * / . · ( ) - 2 ³ ⁻ 10 e ,".split()])
LIKE_A_UNIT = st.lists(st.one_of(NAMES, SIGNS), max_size=12).map("".join)


@pytest.fixture(scope="module", autouse=True)
def _pint_is_there() -> None:
    convert(np.ones(1), "psi", "bar", "here")  # reading pint's definitions takes a second, once


@given(st.one_of(st.text(max_size=2 * LONGEST_UNIT), LIKE_A_UNIT), st.sampled_from(["bar", "1", "m/s**2", "K"]))
@settings(max_examples=300, deadline=1e3 * AT_MOST_S)
@example("10**10**10", "bar")
@example("(m**99)**99", "bar")
@example("Ym**99*Ym**99*Ym**99", "1")
@example("9" * 5000, "bar")
@example("(" * 50, "bar")
@example("m" + "\u00b2" * 50, "bar")
@example("\ufdfa" * LONGEST_UNIT, "bar")
def test_any_text_is_converted_or_refused_at_once(text: str, wanted: str) -> None:
    began = time.perf_counter()
    try:
        said = f"a unit: {convert(np.array([1.0, np.nan]), text, wanted, 'here').shape}"
    except BadInput as error:
        said = str(error)
    assert "unit" in said
    assert len(said) < 400
    assert time.perf_counter() - began < AT_MOST_S


@pytest.mark.parametrize(
    ("given", "wanted", "factor"),
    [
        ("kg m-2 s-1", "kg/(m**2*s)", 1.0),
        ("m³/h", "m^3/s", 1 / 3600),
        ("m⁻²", "cm**-2", 1e-4),
        ("N·m", "N*m", 1.0),
        ("W/(m2 K)", "W/m2/K", 1.0),
        (" k Pa ".replace(" P", "P"), "Pa", 1e3),
        ("m ** 2", "cm^2", 1e4),
        ("µm", "m", 1e-6),
    ],
)
def test_powers_products_and_brackets_as_people_write_them(given: str, wanted: str, factor: float) -> None:
    assert convert(np.array([2.0]), given, wanted, "here") == pytest.approx([2.0 * factor], rel=1e-12)


def test_degrees_with_their_sign() -> None:
    for celsius in ("°C", "℃", "degC"):
        assert convert(np.array([20.0]), celsius, "K", "here") == pytest.approx([293.15])


@pytest.mark.parametrize("power", ["m**100", "m^999", "m1000", "m**1e5", "m**m", "2**3", "m**2**2", "(m**2)**2"])
def test_a_power_has_two_figures_and_stands_at_a_name(power: str) -> None:
    with pytest.raises(BadInput, match="unknown unit"):
        convert(np.ones(1), power, "m", "here")
