"""What turned round, and which laws are offered then."""

from __future__ import annotations

import numpy as np
import pytest
from motor import MOTOR
from two_tanks import TANKS

from twinbench.mismatch.catalogue import generic
from twinbench.mismatch.reversal import Turned, crosses_zero, nears_zero, reverses

T = np.linspace(0.0, 30.0, 3000)
NOISE = 0.01 * np.random.default_rng(4).normal(size=len(T))


@pytest.mark.parametrize(
    ("values", "crosses", "nears", "back"),
    [
        (np.sin(T), True, True, True),
        (5.0 + np.sin(T), False, False, True),
        (1.05 + np.sin(T), False, True, True),
        (T + NOISE, False, True, False),  # rises from zero, and noise is no turning round
        (T - 15.0 + NOISE, True, True, False),
        (3.0 + T + NOISE, False, False, False),
        (np.where(T < 15.0, 2.0, 4.0), False, False, False),
        (np.where((T > 10.0) & (T < 20.0), 4.0, 2.0), False, False, True),
        (np.zeros(100), False, False, False),
        (np.full(100, np.nan), False, False, False),
    ],
)
def test_a_course_crosses_zero_comes_near_it_and_goes_back(values, crosses, nears, back):
    assert (crosses_zero(values), nears_zero(values), reverses(values)) == (crosses, nears, back)
    column = np.stack((values, values), axis=1)[:, 0]
    assert reverses(column) == back
    gaps = np.where(np.arange(len(values)) % 7 == 3, np.nan, values)
    assert (crosses_zero(gaps), nears_zero(gaps), reverses(gaps)) == (crosses, nears, back)


def test_one_recording_that_turned_round_is_enough():
    turned = Turned.seen({"a": [T + 5.0, np.sin(T)], "b": [T + 5.0, 20.0 - T / 3.0]})
    assert turned.crossed == turned.near == turned.reversed == {"a"}


def test_laws_that_need_a_reversal_are_offered_only_where_something_turned_round():
    one_way, both_ways = (
        {m.name for m in generic(MOTOR, None, turned)}
        for turned in (
            Turned(),
            Turned(frozenset({"omega_rad_s", "voltage_V"}), frozenset({"voltage_V"}), frozenset({"voltage_V"})),
        )
    )
    assert both_ways - one_way == {
        "coulomb_friction_unequal@omega_rad_s",
        "hysteresis@omega_rad_s",
        "bouc_wen_hysteresis@omega_rad_s",
        "dead_zone@voltage_V",
        "dead_zone_unequal@voltage_V",
        "backlash@voltage_V",
    }
    known = {m.name for m in generic(MOTOR)}
    assert both_ways < known
    assert known - both_ways == {
        "constant_drop_unequal@current_A",
        "dead_zone@load_Nm",
        "dead_zone_unequal@load_Nm",
        "backlash@load_Nm",
    }


def test_a_dead_zone_of_a_flux_is_offered_where_the_flux_came_near_zero():
    names = [
        {m.name for m in generic(TANKS, None, Turned(near=near))} for near in (frozenset(), frozenset({"out_cm3_s"}))
    ]
    assert "dead_zone@out_cm3_s" in names[1] - names[0]
