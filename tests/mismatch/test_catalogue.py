"""The generic catalogue: what it offers for which machine, and what each effect does."""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from motor import MOTOR
from two_tanks import TANKS

from twinbench.mismatch.catalogue import generic
from twinbench.mismatch.natures import AMBIENT
from twinbench.mismatch.structure import typical_rates
from twinbench.physics.compile import compiled
from twinbench.physics.compose import compose, plain_rhs, with_mechanism
from twinbench.physics.compressor import PLANT
from twinbench.physics.integrate import simulate
from twinbench.physics.simulator import Series, Simulator, Variable


def mass_rhs(x, u, theta):
    return np.array([x[1], (u[0] - theta[0] * x[0]) / theta[1]])


def mass_output(x, u, theta):
    return np.array([x[0]])


MASS = Simulator(
    name="mass",
    states=(Variable("x_m", "m", -2.0, 2.0, 0.0, 0.5), Variable("v_m_s", "m/s", -5.0, 5.0, 0.0, 1.0)),
    inputs=(Variable("F_N", "N", -50.0, 50.0, 0.0, 10.0),),
    outputs=(Variable("pos_m", "m", -2.0, 2.0, 0.0, 0.5),),
    parameters=(Variable("k_N_m", "N/m", 0.0, 100.0, 20.0), Variable("m_kg", "kg", 0.1, 20.0, 2.0)),
    rhs=mass_rhs,
    output=mass_output,
    initial=lambda u0, y0, theta: np.array([y0[0], 0.0]),
)
MACHINES = {s.name: s for s in (MOTOR, TANKS, MASS, PLANT)}
ALL = [pytest.param(s, m, id=f"{s.name}-{m.name}") for s in MACHINES.values() for m in generic(s)]


def find(simulator: Simulator, name: str) -> Any:
    return next(m for m in generic(simulator) if m.name == name)


def around(variables, rng, spread=2.0):
    """A point within two scales of the nominal one, and within bounds."""
    return np.array([np.clip(v.nominal + spread * v.scale * rng.uniform(-1, 1), v.low, v.high) for v in variables])


@pytest.mark.parametrize(("simulator", "mechanism"), ALL)
def test_every_mechanism_is_nothing_when_absent_and_something_finite_when_typical(simulator, mechanism):
    size = mechanism.parameters[0]
    assert size.low <= 0.0 < size.nominal < size.high
    if isinstance(mechanism, Series):
        t = np.arange(200.0)
        steps = around(simulator.inputs, np.random.default_rng(0))[0] + size.nominal * 3 * np.sin(t)
        assert np.array_equal(mechanism.series(t, steps, np.zeros(1)), steps)
        assert not np.array_equal(mechanism.series(t, steps, np.array([size.nominal])), steps)
        return
    changed = with_mechanism(simulator, mechanism)
    absent = changed.with_values(**{changed.parameters[len(simulator.parameters)].name: 0.0})
    rng = np.random.default_rng(1)
    felt = 0.0
    for _ in range(20):
        x, u = around(changed.states, rng), around(simulator.inputs, rng)
        plain = plain_rhs(simulator)(x[: len(simulator.states)], u, simulator.theta())
        off, on = (plain_rhs(s)(x, u, s.theta())[: len(plain)] for s in (absent, changed))
        assert np.array_equal(off, plain)
        assert np.isfinite(on).all()
        felt = max(felt, float(np.max(np.abs(on - plain) / typical_rates(simulator))))
    assert 0.005 < felt < 5.0  # typical is neither nothing nor all there is


@pytest.mark.parametrize("simulator", MACHINES.values(), ids=MACHINES)
def test_names_ports_and_words_fit(simulator):
    mechanisms = generic(simulator)
    assert max(Counter(m.name for m in mechanisms).values()) == 1
    parameters = [v.name for m in mechanisms for v in m.parameters] + [v.name for v in simulator.parameters]
    assert len(set(parameters)) == len(parameters)
    assert len(mechanisms) <= 12 * len(simulator.states)
    for m in mechanisms:
        target = m.port.variable
        assert any(v.name in m.says for v in simulator.states + simulator.inputs + simulator.fluxes)
        assert m.name.endswith(f"@{target}")
        filled = m.formula.format(**{v.name: "7" for v in m.parameters})
        assert filled.count("7") >= len(m.parameters)
        assert "{" not in filled


REPRESENTATIVES = (
    (MOTOR, 0.02, ("offset", "viscous_friction", "quadratic_friction", "cubic_friction", "coulomb_friction",
                   "coulomb_friction_unequal", "hysteresis", "periodic"), "omega_rad_s"),
    (MOTOR, 0.02, ("loss_to_ambient", "second_thermal_mass"), "T_winding_K"),
    (MOTOR, 0.02, ("dead_zone",), "load_Nm"),
    (TANKS, 1.0, ("leak", "overflow", "spill_from_h1_cm"), "h2_cm"),
    (MASS, 0.02, ("hardening_spring", "backlash"), "v_m_s"),
)  # fmt: skip


@pytest.mark.parametrize(("simulator", "period_s", "effects", "target"), REPRESENTATIVES)
def test_each_effect_runs_compiled_and_is_nothing_when_absent(simulator, period_s, effects, target):
    mechanisms = [find(simulator, f"{effect}@{target}") for effect in effects]
    sizes = [m.parameters[0] for m in mechanisms]
    changed = compose(simulator, mechanisms).with_values(**{v.name: 0.0 for v in sizes})
    assert compiled(changed).native
    swing = np.sin(np.arange(400) / 20.0)[:, None]
    u = np.array([v.nominal + v.scale * swing for v in simulator.inputs]).transpose(2, 1, 0)
    start = np.array([v.nominal + 0.6 * v.scale for v in simulator.states])
    own = [v.nominal for m in mechanisms for v in m.states]
    x, y = simulate(simulator, u, start, dt_s=period_s)
    with_own = np.concatenate((start, own))
    off_x, off_y = simulate(changed, u, with_own, dt_s=period_s)
    assert np.array_equal(off_y, y)
    assert np.array_equal(off_x[..., : x.shape[-1]], x)
    for size in sizes:
        theta = changed.theta()
        theta[changed.index(size.name)] = size.nominal
        on = simulate(changed, u, with_own, theta, dt_s=period_s)[1]
        assert np.isfinite(on).all()
        assert not np.allclose(on, y, rtol=1e-6)


def term(simulator: Simulator, name: str, x, own=(), u=None) -> float:
    """What a mechanism adds, at its own parameters ``own``."""
    m = find(simulator, name)
    inputs = np.array([v.nominal for v in simulator.inputs]) if u is None else np.asarray(u)
    return m.term(np.asarray(x, dtype=float), inputs, np.concatenate((simulator.theta(), own)))


def test_frictions_act_against_the_motion():
    for omega, sign in ((150.0, 1.0), (-150.0, -1.0)):
        x = [40.0, omega, 330.0]
        assert term(MOTOR, "viscous_friction@omega_rad_s", x, [0.5]) == -0.5 * omega
        assert term(MOTOR, "quadratic_friction@omega_rad_s", x, [0.5]) == -0.5 * sign * 150.0**2
        assert term(MOTOR, "cubic_friction@omega_rad_s", x, [0.5]) == -0.5 * omega**3
        assert term(MOTOR, "coulomb_friction@omega_rad_s", x, [3.0]) == pytest.approx(-3.0 * sign)
        unequal = term(MOTOR, "coulomb_friction_unequal@omega_rad_s", x, [3.0, 0.4])
        assert unequal == pytest.approx(-3.0 if sign > 0 else 1.2)
    assert term(MOTOR, "coulomb_friction@omega_rad_s", [0.0, 0.0, 300.0], [3.0]) == 0.0


def test_tanks_leak_above_the_hole_and_overflow_above_the_rim():
    assert term(TANKS, "leak@h1_cm", [25.0, 9.0], [0.1, 9.0]) == pytest.approx(-0.4)
    assert term(TANKS, "leak@h1_cm", [5.0, 9.0], [0.1, 9.0]) == 0.0
    assert term(TANKS, "overflow@h2_cm", [25.0, 9.0], [0.1, 7.0]) == pytest.approx(-0.2)
    assert term(TANKS, "overflow@h2_cm", [25.0, 6.0], [0.1, 7.0]) == 0.0
    assert term(TANKS, "spill_from_h1_cm@h2_cm", [25.0, 6.0], [0.1, 20.0]) == pytest.approx(0.5)


@pytest.mark.parametrize(
    ("name", "is_ambient"),
    [
        ("T_amb_K", True),
        ("Tamb", True),
        ("ambient_K", True),
        ("T_ambient", True),
        ("T_chamber_K", False),
        ("bamboo_K", False),
        ("T_amber_K", False),
    ],
)
def test_an_ambient_is_a_word_of_a_name_and_no_part_of_one(name, is_ambient):
    assert (AMBIENT.search(name.lower()) is not None) == is_ambient


def test_heat_goes_to_the_ambient_that_the_machine_names():
    ambient = MOTOR.theta()[MOTOR.index("T_amb_K")]
    assert term(MOTOR, "loss_to_ambient@T_winding_K", [0, 0, ambient + 10.0], [0.2]) == pytest.approx(-2.0)
    nameless = replace(
        MOTOR,
        parameters=tuple(Variable("T_air", "K", 250, 320, 295) if v.name == "T_amb_K" else v for v in MOTOR.parameters),
    )
    assert term(nameless, "loss_to_ambient@T_winding_K", [0, 0, 300.0], [0.2, 280.0]) == pytest.approx(-4.0)


def test_springs_and_play_push_a_position_back_through_its_velocity():
    assert {str(m.port) for m in generic(MASS)} == {"balance:v_m_s", "input:F_N"}
    assert term(MASS, "hardening_spring@v_m_s", [0.5, 0.0], [8.0]) == -1.0
    for x, force in ((0.1, 0.0), (-0.1, 0.0), (0.5, -3.0), (-0.5, 3.0)):
        assert term(MASS, "backlash@v_m_s", [x, 0.0], [10.0, 0.2]) == pytest.approx(force)


def test_a_dead_zone_takes_its_width_off_either_side():
    for volts, left in ((30.0, 25.0), (-30.0, -25.0), (4.0, 0.0), (-4.0, 0.0)):
        u = [volts, 0.0]
        assert volts + term(MOTOR, "dead_zone@voltage_V", [0, 0, 300], [5.0], u) == left


def test_backlash_of_an_input_loses_the_play_at_each_turn():
    play = find(TANKS, "backlash@pump_V").series
    volts = np.array([5.0, 5.5, 7.0, 6.5, np.nan, 6.0, 4.0])
    assert play(np.arange(7.0), volts, np.array([1.0])) == pytest.approx([5.0, 5.0, 6.5, 6.5, 6.5, 6.5, 4.5])


def own_state(name: str, omega, own, dt_s=0.001):
    """The mechanism's own state while the motor's speed (or temperature) is what we say; explicit Euler."""
    m = find(MOTOR, name)
    z, theta = m.states[0].nominal, np.concatenate((MOTOR.theta(), own))
    trace = []
    for value in omega:
        x = np.array([0.0, value, value, z])
        z += dt_s * m.derivative(x, np.zeros(2), theta)[0]
        trace.append(z)
    return np.array(trace)


def test_hysteresis_stays_when_motion_stops_and_turns_with_it():
    forward, still, back = np.full(20_000, 100.0), np.zeros(5000), np.full(20_000, -100.0)
    force = own_state("hysteresis@omega_rad_s", np.concatenate((forward, still, back)), [1.0, 50.0])
    assert force[19_999] == pytest.approx(1.0, abs=1e-3)
    assert force[24_999] == force[19_999]
    assert force[-1] == pytest.approx(-1.0, abs=1e-3)
    assert np.abs(force).max() <= 1.0


def test_a_second_mass_follows_by_its_time_constant():
    start = find(MOTOR, "second_thermal_mass@T_winding_K").states[0].nominal
    trace = own_state("second_thermal_mass@T_winding_K", np.full(1000, start + 10.0), [0.1, 0.5])
    assert trace[499] - start == pytest.approx(10.0 * (1.0 - math.exp(-1.0)), rel=1e-2)
    m = find(MOTOR, "second_thermal_mass@T_winding_K")
    theta = np.concatenate((MOTOR.theta(), [0.1, 0.5]))
    assert m.term(np.array([0.0, 0.0, 340.0, 330.0]), np.zeros(2), theta) == pytest.approx(-1.0)


def test_a_periodic_force_keeps_time_by_its_own_clock():
    m = find(MOTOR, "periodic@omega_rad_s")
    assert own_state("periodic@omega_rad_s", np.zeros(2000), [1.0, 2.0, 0.0])[-1] == pytest.approx(2.0)
    theta = np.concatenate((MOTOR.theta(), [3.0, 8.0, 0.0]))
    assert m.term(np.array([0.0, 0.0, 300.0, 2.0]), np.zeros(2), theta) == pytest.approx(3.0)


def test_typical_rates_follow_the_equations():
    # h' = (20 u - 0.5 sqrt(2 g h)) / 154 at h = 20 cm, one scale each: 1.5 V, 8 cm.
    root = math.sqrt(2 * 981.0)
    by_level = 0.5 * root * (math.sqrt(28.0) - math.sqrt(20.0)) / 154.0
    expected = [math.hypot(20 * 1.5 / 154.0, by_level), math.hypot(by_level, by_level)]
    assert typical_rates(TANKS) == pytest.approx(expected)


def constant_leak(x, u, theta):
    return np.array([-theta[0]])


def test_a_machine_whose_state_moves_by_itself_still_gets_typical_sizes():
    chamber = Simulator(
        name="chamber",
        states=(Variable("p_bar", "bar", 0.0, 10.0, 5.0, 2.0),),
        inputs=(),
        outputs=(Variable("p_gauge_bar", "bar", 0.0, 10.0, 5.0),),
        parameters=(Variable("k_bar_s", "bar/s", 0.0, 1.0, 0.05),),
        rhs=constant_leak,
        output=mass_output,
        initial=lambda u0, y0, theta: y0,
    )
    assert typical_rates(chamber) == pytest.approx([0.05])
    assert {"leak@p_bar", "linear_leak@p_bar", "overflow@p_bar"} <= {m.name for m in generic(chamber)}
    assert typical_rates(chamber.with_values(k_bar_s=0.0)) == pytest.approx([0.2])


def test_what_is_offered_follows_from_the_variables():
    def effects(simulator, target):
        return {m.name.partition("@")[0] for m in generic(simulator) if m.name.endswith(f"@{target}")}

    common = {"offset", "periodic", "time_constant"}
    losses = {"linear_loss", "quadratic_loss", "cubic_loss", "constant_drop", "constant_drop_unequal"}
    frictions = {f"{kind}_friction" for kind in ("viscous", "quadratic", "cubic", "coulomb")}
    moving = {"coulomb_friction_unequal", "stribeck_friction", "hysteresis", "bouc_wen_hysteresis"}
    leaks = {"leak", "linear_leak", "quadratic_leak", "overflow"}
    assert effects(MOTOR, "current_A") == common | losses
    assert effects(MOTOR, "omega_rad_s") == common | frictions | moving
    assert effects(MOTOR, "T_winding_K") == common | {"loss_to_ambient", "radiation", "second_thermal_mass"}
    assert effects(TANKS, "h1_cm") == common | leaks
    assert effects(TANKS, "h2_cm") == common | leaks | {"spill_from_h1_cm"}
    assert effects(MASS, "x_m") == set()
    assert effects(MASS, "v_m_s") == common | frictions | moving | {"hardening_spring", "backlash"}
    one_way = tuple(
        Variable("omega_rad_s", "rad/s", 0.0, 300.0, 120.0) if v.name == "omega_rad_s" else v for v in MOTOR.states
    )
    moving.remove("coulomb_friction_unequal")
    assert effects(replace(MOTOR, states=one_way), "omega_rad_s") == common | frictions | moving
    assert effects(PLANT, "N_rpm") == {"backlash"}  # never zero: no dead zone
    assert effects(PLANT, "valve") == {"backlash", "dead_zone"}
    assert effects(MOTOR, "voltage_V") == {"backlash", "dead_zone", "dead_zone_unequal"}
    assert effects(TANKS, "out_cm3_s") == {"saturation", "dead_zone"}
    assert effects(PLANT, "m_rec_kg_s") == set()  # no flow while its amplitude is zero


def test_sizes_on_a_machine_without_units_are_by_the_second():
    bare = replace(MASS, states=tuple(replace(s, unit="") for s in MASS.states))
    units = {v.name: v.unit for m in generic(bare) if not isinstance(m, Series) for v in m.parameters}
    assert units["hardening_spring_v_m_s"] == "1/s"
    assert units["quadratic_friction_v_m_s"] == "1/s"
    assert not [unit for unit in units.values() if unit.startswith("/") or "//" in unit or "1^" in unit]
