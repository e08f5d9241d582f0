"""Heat that a balance lacks: radiation, and heat from one temperature to another, with and without capacities."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from motor import MOTOR

from twinbench.mismatch.catalogue import generic
from twinbench.physics.check import check_mechanism
from twinbench.physics.compile import compiled
from twinbench.physics.compose import compose, plain_rhs
from twinbench.physics.integrate import simulate
from twinbench.physics.simulator import Mechanism, Simulator, Variable


def apart(x, u, theta):
    return np.array([u[0] / theta[0], (u[0] - 3.0 * (x[1] - 290.0)) / theta[1]])


def coupled(x, u, theta):
    return np.array([(u[0] + x[1] - x[0]) / theta[0], (u[0] - 3.0 * (x[1] - 290.0)) / theta[1]])


def body(rhs=apart, unit: str = "K", capacity: str = "J/K") -> Simulator:
    low, high, nominal = {"K": (250.0, 600.0, 350.0), "degC": (-20.0, 330.0, 77.0)}[unit]
    return Simulator(
        name="body",
        states=tuple(Variable(n, unit, low, high, nominal, 30.0) for n in ("T_core", "T_shell")),
        inputs=(Variable("P_W", "W", 0.0, 500.0, 100.0, 50.0),),
        outputs=(Variable("reading", unit, low, high, nominal, 30.0),),
        parameters=tuple(Variable(n, capacity, 100.0, 9000.0, v) for n, v in (("C1", 2000.0), ("C2", 500.0))),
        rhs=rhs,
        output=lambda x, u, theta: x[:1] + 0.0,
        initial=lambda u0, y0, theta: np.array([y0[0], y0[0]]),
    )


def offered(simulator: Simulator) -> dict[str, Mechanism]:
    return {m.name: m for m in generic(simulator)}


def value(simulator: Simulator, name: str, x, own) -> float:
    m, u = offered(simulator)[name], np.array([v.nominal for v in simulator.inputs])
    check_mechanism(simulator, m)
    return float(m.term(np.asarray(x, dtype=float), u, np.concatenate((simulator.theta(), own))))


def test_radiation_goes_with_the_fourth_power_in_kelvin():
    ambient = MOTOR.theta()[MOTOR.index("T_amb_K")]
    rate = value(MOTOR, "radiation@T_winding_K", [0.0, 0.0, 400.0], [1e-10])
    assert rate == pytest.approx(-1e-10 * (400.0**4 - ambient**4))
    fitted = value(body(), "radiation@T_core", [500.0, 300.0], [1e-10, 280.0])
    assert fitted == pytest.approx(-1e-10 * (500.0**4 - 280.0**4))


def test_radiation_in_degrees_is_that_in_kelvin():
    warm, absolute = body(unit="degC"), body()
    in_degrees = value(warm, "radiation@T_core", [226.85, 20.0], [1e-10, 6.85])
    assert in_degrees == pytest.approx(value(absolute, "radiation@T_core", [500.0, 300.0], [1e-10, 280.0]))
    in_fahrenheit = replace(
        warm, states=tuple(Variable(v.name, "degF", -40.0, 900.0, 170.0, 50.0) for v in warm.states)
    )
    # 440.33 degF are 500 K, 44.33 degF are 280 K.
    assert value(in_fahrenheit, "radiation@T_core", [440.33, 68.0], [1e-10, 44.33]) == pytest.approx(in_degrees)


def test_what_leaves_one_temperature_enters_the_other_where_capacities_are_known():
    simulator = body()
    assert {n for n in offered(simulator) if n.startswith("heat_from")} == {"heat_from_T_shell@T_core"}
    exchange = offered(simulator)["heat_from_T_shell@T_core"]
    check_mechanism(simulator, exchange)
    whole = compose(simulator, (exchange,))
    assert compiled(whole).native
    theta = whole.theta()
    theta[-1] = 0.01
    x, u, (C1, C2) = np.array([400.0, 320.0]), np.array([100.0]), simulator.theta()
    change = compiled(whole).rhs(x, u, theta) - plain_rhs(simulator)(x, u, simulator.theta())
    assert change == pytest.approx([-0.01 * 80.0, 0.01 * 80.0 * C1 / C2])
    assert C1 * change[0] + C2 * change[1] == pytest.approx(0.0, abs=1e-9)


def test_an_exchange_by_itself_keeps_the_energy_and_evens_out_the_temperatures():
    def still(x, u, theta):
        return np.array([(u[0] - 100.0) / theta[0], (u[0] - 100.0) / theta[1]])

    simulator = body(still)
    whole = compose(simulator, (offered(simulator)["heat_from_T_shell@T_core"],))
    theta = whole.theta()
    theta[-1] = 0.05
    x, _ = simulate(whole, np.full((1, 400, 1), 100.0), np.array([400.0, 300.0]), theta, dt_s=1.0)
    energy = x[..., :2] @ simulator.theta()
    assert np.ptp(energy) < 1e-6 * np.abs(energy).max()
    assert np.ptp(x[0, 0, :2]) > 90.0
    assert np.ptp(x[0, -1, :2]) < 1e-3


def test_without_capacities_each_may_follow_the_other():
    simulator = body(capacity="1")
    exchanges = {n: m for n, m in offered(simulator).items() if n.startswith("heat_from")}
    assert set(exchanges) == {"heat_from_T_shell@T_core", "heat_from_T_core@T_shell"}
    assert all(m.into is None for m in exchanges.values())
    assert value(simulator, "heat_from_T_core@T_shell", [400.0, 320.0], [0.01]) == pytest.approx(0.8)


def test_temperatures_that_the_equations_couple_are_not_coupled_again():
    assert not [n for n in offered(body(coupled)) if n.startswith("heat_from")]
