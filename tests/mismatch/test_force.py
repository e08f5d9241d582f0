"""Which parameter is an inertia is read off the equations; sizes at such a balance are told as forces."""

from __future__ import annotations

import numpy as np
import pytest
from motor import MOTOR
from two_tanks import TANKS

from twinbench.mismatch.catalogue import generic
from twinbench.mismatch.force import as_force, inertia
from twinbench.physics.simulator import Simulator, Variable

GRAVITY_M_S2 = 9.81


def drone(rate, unit: str = "m/s", mass_unit: str = "kg") -> Simulator:
    def rhs(x, u, theta):
        return np.array([rate(x[0], u[0], theta)])

    return Simulator(
        name="drone",
        states=(Variable("climb", unit, -20.0, 20.0, 1.0, 2.0),),
        inputs=(Variable("thrust_N", "N", 0.0, 50.0, 20.0, 5.0),),
        outputs=(Variable("v", unit, -20.0, 20.0, 1.0, 2.0),),
        parameters=(Variable("m", mass_unit, 0.5, 5.0, 2.0), Variable("c", "N s/m", 0.0, 5.0, 0.5)),
        rhs=rhs,
        output=lambda x, u, theta: x[:1],
        initial=lambda u0, y0, theta: y0[:1],
    )


def weighs(v, thrust, theta):
    return (thrust - theta[1] * v) / theta[0] - GRAVITY_M_S2


def test_the_inertia_is_what_the_rate_is_a_constant_and_a_force_over():
    found = inertia(drone(weighs), 0)
    assert (found.parameter.name, found.at, found.force) == ("m", 0, "N")
    motor = inertia(MOTOR, 1)
    assert (motor.parameter.name, motor.force) == ("J_kg_m2", "N m")


@pytest.mark.parametrize(
    "rate",
    [
        lambda v, thrust, theta: (thrust - theta[1] * v) / (theta[0] + 1.0),
        lambda v, thrust, theta: (thrust - theta[1] * v) / theta[0] + theta[0],
        lambda v, thrust, theta: thrust - theta[1] * v,
    ],
)
def test_a_mass_among_others_or_beside_the_point_is_no_inertia(rate):
    assert inertia(drone(rate), 0) is None


def test_what_is_no_mass_or_no_speed_has_no_force():
    assert inertia(drone(weighs, mass_unit="1"), 0) is None
    assert inertia(drone(weighs, mass_unit="furlongs per"), 0) is None
    assert inertia(MOTOR, 0) is None
    assert all(inertia(TANKS, i) is None for i in range(len(TANKS.states)))


@pytest.mark.parametrize(
    ("name", "unit"),
    [
        ("coulomb_friction@omega_rad_s", "N m"),
        ("viscous_friction@omega_rad_s", "N m/(rad/s)"),
        ("quadratic_friction@omega_rad_s", "N m/(rad/s)^2"),
        ("cubic_friction@omega_rad_s", "N m/(rad/s)^3"),
    ],
)
def test_sizes_become_forces_per_what_they_multiply(name, unit):
    (size,) = (m.parameters[0] for m in generic(MOTOR) if m.name == name)
    assert as_force(size.unit, MOTOR, 1, inertia(MOTOR, 1)) == (pytest.approx(1.0), unit)


@pytest.mark.parametrize(
    ("name", "unit"), [("loss_to_ambient@T_winding_K", "W/(K)"), ("radiation@T_winding_K", "W/(K)^4")]
)
def test_heat_is_told_in_watts_where_a_heat_capacity_is_known(name, unit):
    found = inertia(MOTOR, 2)
    assert (found.parameter.name, found.force, found.word) == ("C_J_K", "W", "heat flow")
    (size,) = (m.parameters[0] for m in generic(MOTOR) if m.name == name)
    assert as_force(size.unit, MOTOR, 2, found) == (pytest.approx(1.0), unit)
    assert inertia(MOTOR, 1).word == "force"


@pytest.mark.parametrize(
    ("temperature", "capacity", "times"),
    [("degC", "kJ/K", 1e3), ("degC", "J/degC", 1.0), ("degF", "J/K", 5.0 / 9.0)],
)
def test_degrees_of_a_heat_capacity_are_differences(temperature, capacity, times):
    """The offset is in degrees a second: times the capacity in watts."""
    kiln = Simulator(
        name="kiln",
        states=(Variable("T", temperature, 0.0, 900.0, 300.0, 50.0),),
        inputs=(Variable("P_W", "W", 0.0, 5000.0, 1000.0, 500.0),),
        outputs=(Variable("probe", temperature, 0.0, 900.0, 300.0, 50.0),),
        parameters=(Variable("C", capacity, 0.5, 5000.0, 2.0),),
        rhs=lambda x, u, theta: np.array([(u[0] - 0.2 * x[0]) / theta[0]]),
        output=lambda x, u, theta: x[:1],
        initial=lambda u0, y0, theta: y0[:1],
    )
    sizes = {m.name: m.parameters[0] for m in generic(kiln)}
    assert as_force(sizes["offset@T"].unit, kiln, 0, inertia(kiln, 0)) == (pytest.approx(times), "W")
    loss = as_force(sizes["loss_to_ambient@T"].unit, kiln, 0, inertia(kiln, 0))
    assert loss == (pytest.approx(1e3 if capacity == "kJ/K" else 1.0), "W/(K)")


def test_units_of_another_size_are_converted():
    in_cm = drone(weighs, "cm/s", "g")
    times, unit = as_force("(cm/s)/s", in_cm, 0, inertia(in_cm, 0))
    assert (times, unit) == (pytest.approx(1e-5), "N")
