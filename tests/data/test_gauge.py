"""Gauge pressures are pressures, and a median in the wrong place asks about its unit."""

from __future__ import annotations

import numpy as np
import pytest
from recording_files import table, write

from twinbench.common.errors import BadInput
from twinbench.data.recording import read_recording
from twinbench.data.units import ATMOSPHERE_BAR, convert, likely_units


@pytest.mark.parametrize(
    ("unit", "bars"),
    [
        ("barg", 1.0),
        ("bar(g)", 1.0),
        ("bar g", 1.0),
        ("mbarg", 1e-3),
        ("kPag", 1e-2),
        ("kPa(g)", 1e-2),
        ("MPag", 10.0),
        ("Pag", 1e-5),
        ("psig", 0.0689475729),
    ],
)
def test_gauge_adds_the_standard_atmosphere(unit, bars):
    given = np.array([-0.5, 0.0, 2.0])
    assert np.allclose(convert(given, unit, "bar", ""), ATMOSPHERE_BAR + bars * given, rtol=1e-9)
    absolute = unit.replace("(g)", "(a)").replace("g", "a")
    assert np.allclose(convert(given, absolute, "bar", ""), bars * given, rtol=1e-9)


def test_gauge_works_on_the_command_line_and_in_the_sidecar(tmp_path):
    frame = table()
    raw = frame.assign(PT101=frame["p_dis_bar"] - ATMOSPHERE_BAR, PT1=(frame["p_suc_bar"] - ATMOSPHERE_BAR) * 100.0)
    (tmp_path / "run.toml").write_text('[channels]\np_suc_bar = { column = "PT1", unit = "kPag" }\n')
    values = read_recording(write(raw, tmp_path), ["PT101[barg]=p_dis_bar"]).values
    assert np.allclose(values[:, [0, 4]], frame[["p_suc_bar", "p_dis_bar"]])


def test_a_gauge_is_no_temperature():
    with pytest.raises(BadInput, match="cannot be turned into"):
        convert(np.ones(2), "barg", "K", "x.csv")


@pytest.mark.parametrize(
    ("median", "unit", "low", "high", "first"),
    [
        (-0.06, "bar", 0.82, 1.08, "barg"),
        (95.0, "bar", 0.82, 1.08, "kPa"),
        (45.0, "bar", 1.9, 4.8, "psi"),
        (175.0, "K", 390.0, 505.0, "degC"),
        (25.0, "rpm", 900.0, 1800.0, "Hz"),
        (60.0, "1", 0.27, 0.91, "percent"),
        (430.0, "kg/s", 0.05, 0.17, "kg/h"),
        (120.0, "kg/s", 0.05, 0.17, "g/s"),
    ],
)
def test_the_unit_that_is_asked_about_brings_the_median_inside(median, unit, low, high, first):
    asked = likely_units(median, unit, low, high)
    assert asked[0] == first
    for other in asked:
        assert low <= convert(np.array(median), other, unit, "") <= high


def test_no_unit_is_asked_about_where_none_helps():
    assert likely_units(12_000.0, "rpm", 900.0, 1800.0) == []
