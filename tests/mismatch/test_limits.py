"""Limits, dead zones and the end of choking, at inputs and at fluxes; a rate that is wrong as a whole."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from motor import MOTOR
from two_tanks import TANKS

from twinbench.mismatch.catalogue import generic
from twinbench.physics.check import check_mechanism
from twinbench.physics.compile import compiled
from twinbench.physics.compose import compose, plain_rhs
from twinbench.physics.simulator import Mechanism, Simulator, Variable

RATIO = 0.528


def flux(x, u, theta):
    return np.array([theta[0] * x[0], theta[1] * (u[1] - x[0])])


def balance(x, u, theta, f):
    return np.array([u[0] + f[1] - f[0]])


def vessel(law=flux, downstream_unit: str = "bar") -> Simulator:
    """A vessel that blows off through an opening which is taken as choked, and is filled from a line."""
    return Simulator(
        name="vessel",
        states=(Variable("p_bar", "bar", 0.1, 20.0, 3.0, 1.0),),
        inputs=(
            Variable("gain_bar_s", "bar/s", 0.0, 1.0, 0.1, 0.05),
            Variable("line_bar", "bar", 0.1, 20.0, 3.5, 1.0),
            Variable("sink_bar", downstream_unit, 0.1, 20.0, 1.0, 0.5),
        ),
        outputs=(Variable("gauge", "bar", 0.1, 20.0, 3.0, 1.0),),
        parameters=(Variable("k", "kg/s/bar", 0.0, 1.0, 0.1), Variable("c", "kg/s/bar", 0.0, 1.0, 0.2)),
        fluxes=(Variable("out_kg_s", "kg/s", 0.0, 5.0, 0.3, 0.1), Variable("in_kg_s", "kg/s", -1.0, 1.0, 0.1, 0.1)),
        flux=law,
        balance=balance,
        output=lambda x, u, theta: x + 0.0,
        initial=lambda u0, y0, theta: y0 + 0.0,
    )


def find(simulator: Simulator, name: str) -> Mechanism:
    return next(m for m in generic(simulator) if m.name == name)


def acted(simulator: Simulator, name: str, x, u, own):
    """What a mechanism of these parameters adds to the rates."""
    m = find(simulator, name)
    check_mechanism(simulator, m)
    whole = compose(simulator, (m,))
    assert compiled(whole).native
    theta = np.concatenate((simulator.theta(), own))
    x, u = np.asarray(x, dtype=float), np.asarray(u, dtype=float)
    return compiled(whole).rhs(x, u, theta) - plain_rhs(simulator)(x, u, simulator.theta())


def test_a_flux_that_is_never_negative_saturates_above():
    # 20 cm^3/s/V at 8 V are 160 cm^3/s, of which a tank of 154 cm^2 gets those up to 120.
    full, most = (acted(TANKS, "saturation@pumped_cm3_s", [20.0, 20.0], [8.0], [s, 120.0]) for s in (1.0, 0.8))
    assert full == pytest.approx([-40.0 / 154.0, 0.0])
    assert most == pytest.approx([-32.0 / 154.0, 0.0])
    below = acted(TANKS, "saturation@pumped_cm3_s", [20.0, 20.0], [5.0], [1.0, 120.0])
    assert below == pytest.approx([0.0, 0.0])


def test_a_symmetrical_flux_saturates_on_both_sides_at_one_limit():
    for line_bar, change in ((5.0, -0.1), (3.5, 0.0), (1.0, 0.1)):  # 0.4, 0.1 and -0.4 kg/s
        given = acted(vessel(), "saturation@in_kg_s", [3.0], [0.1, line_bar, 1.0], [1.0, 0.3])
        assert given == pytest.approx([change])


def test_another_flux_saturates_at_a_lower_and_an_upper_limit():
    lopsided = replace(vessel(), fluxes=(vessel().fluxes[0], Variable("in_kg_s", "kg/s", -0.5, 1.0, 0.1, 0.1)))
    names = [v.name for v in find(lopsided, "saturation@in_kg_s").parameters]
    assert names == ["saturation_in_kg_s", "saturation_lower_limit_in_kg_s", "saturation_limit_in_kg_s"]
    for line_bar, change in ((5.0, -0.1), (3.5, 0.0), (1.0, 0.2)):
        given = acted(lopsided, "saturation@in_kg_s", [3.0], [0.1, line_bar, 1.0], [1.0, -0.2, 0.3])
        assert given == pytest.approx([change])


def test_a_flux_with_a_dead_zone_is_less_by_its_width():
    for line_bar, change in ((4.0, -0.05), (3.1, -0.02), (2.5, 0.05)):  # 0.2, 0.02 and -0.1 kg/s
        given = acted(vessel(), "dead_zone@in_kg_s", [3.0], [0.1, line_bar, 1.0], [0.05])
        assert given == pytest.approx([change])


def test_a_dead_zone_may_differ_by_side():
    m = find(MOTOR, "dead_zone_unequal@voltage_V")
    check_mechanism(MOTOR, m)
    theta = np.concatenate((MOTOR.theta(), [5.0, 0.4]))
    for volts, left in ((30.0, 25.0), (4.0, 0.0), (-1.0, 0.0), (-30.0, -28.0)):
        assert volts + m.term(np.zeros(3), np.array([volts, 0.0]), theta) == left


def test_a_flow_that_stops_being_choked_falls_by_iso_6358_and_ceases_at_equal_pressures():
    name = "unchoked_by_sink_bar@out_kg_s"
    for sink, left in ((1.0, 1.0), (RATIO * 3.0, 1.0), (3.0, 0.0), (3.5, 0.0)):
        given = acted(vessel(), name, [3.0], [0.1, 3.5, sink], [1.0, RATIO])
        assert given == pytest.approx([0.3 * (1.0 - left)], abs=1e-9)
    share = (2.4 / 3.0 - RATIO) / (1.0 - RATIO)
    given = acted(vessel(), name, [3.0], [0.1, 3.5, 2.4], [1.0, RATIO])
    assert given == pytest.approx([0.3 * (1.0 - math.sqrt(1.0 - share**2))])


def test_the_end_of_choking_is_offered_only_for_a_flow_that_the_equations_choke():
    def unchokes(simulator):
        return {m.name for m in generic(simulator) if m.name.startswith("unchoked")}

    def driven(x, u, theta):
        return np.array([theta[0] * (x[0] - u[2]), theta[1] * (u[1] - x[0])])

    assert unchokes(vessel()) == {"unchoked_by_sink_bar@out_kg_s"}  # the line is nominally the higher pressure
    assert unchokes(vessel(driven)) == set()
    assert unchokes(vessel(downstream_unit="barg")) == set()
    in_litres = tuple(replace(v, unit="l/s") for v in vessel().fluxes)
    assert unchokes(replace(vessel(), fluxes=in_litres)) == set()
    assert unchokes(TANKS) == set()


@pytest.mark.parametrize("size", [-0.5, 0.3])
def test_a_wrong_time_constant_multiplies_a_whole_rate(size):
    x, u = [15.0, 20.0], [6.0]
    plain = plain_rhs(TANKS)(np.array(x), np.array(u), TANKS.theta())
    assert acted(TANKS, "time_constant@h2_cm", x, u, [size]) == pytest.approx([0.0, size * plain[1]])
