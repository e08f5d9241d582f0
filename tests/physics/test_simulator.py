"""Simulator, Mechanism and the integrator on machines small enough to know the answer."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from twinbench.physics.compile import compiled
from twinbench.physics.compose import with_mechanism
from twinbench.physics.compressor import PLANT
from twinbench.physics.integrate import Varying, advance, simulate
from twinbench.physics.mechanisms import CATALOGUE
from twinbench.physics.simulator import Amplitude, Mechanism, Port, Series, Simulator, Term, Variable


def variable(name: str, nominal: float = 0.0) -> Variable:
    return Variable(name, "1", -1e6, 1e6, nominal)


def spring_rhs(x, u, theta):
    return np.array([x[1], -theta[0] * x[0] - theta[1] * x[1] + u[0]])


def position(x, u, theta):
    return np.array([x[0]])


def at_rest(u0, y0, theta):
    return np.array([y0[0], 0.0])


SPRING = Simulator(
    name="spring",
    states=(variable("x_m"), variable("v_m_s")),
    inputs=(variable("F_N"),),
    outputs=(variable("pos_m"),),
    parameters=(variable("k", 4.0), variable("d", 0.3)),
    rhs=spring_rhs,
    output=position,
    initial=at_rest,
)
LATE = Series("late", "", "output:pos_m", (variable("delay", 0.1),), series=lambda t, y, p: y)


def tank_flux(x, u, theta):
    return np.array([u[0], theta[0] * np.sqrt(max(x[0], 0.0))])


def tank_balance(x, u, theta, f):
    return np.array([f[0] - f[1], f[1] - theta[1] * np.sqrt(max(x[1], 0.0))])


def second_level(x, u, theta):
    return np.array([x[1]])


TANKS = Simulator(
    name="tanks",
    states=(variable("h1_m"), variable("h2_m")),
    inputs=(variable("q_m3_s"),),
    outputs=(variable("level2_m"),),
    parameters=(variable("k1", 0.5), variable("k2", 0.4)),
    flux=tank_flux,
    balance=tank_balance,
    fluxes=(variable("inflow"), variable("between")),
    output=second_level,
    initial=lambda u0, y0, theta: np.array([y0[0], y0[0]]),
)


def test_rk4_agrees_with_a_tight_solver():
    rng = np.random.default_rng(0)
    u = rng.normal(size=(1, 200, 1))
    x, y = simulate(SPRING, u, np.array([1.0, 0.0]))
    state = np.array([1.0, 0.0])
    for k in range(199):
        held = u[0, k]
        state = solve_ivp(
            lambda t, s, held=held: spring_rhs(s, held, SPRING.theta()), (0, 0.05), state, rtol=1e-11, atol=1e-12
        ).y[:, -1]
        assert x[0, k + 1] == pytest.approx(state, abs=1e-6)
    assert np.array_equal(y[..., 0], x[..., 0])


def test_batch_equals_single_runs_and_advance_equals_one_step():
    rng = np.random.default_rng(1)
    u, x0 = rng.normal(size=(3, 50, 1)), rng.normal(size=(3, 2))
    theta = SPRING.theta() * rng.uniform(0.5, 2, size=(3, 2))
    x, _ = simulate(SPRING, u, x0, theta)
    for b in range(3):
        assert np.array_equal(simulate(SPRING, u[b : b + 1], x0[b], theta[b])[0][0], x[b])
    stepped = advance(SPRING, x[:, 10], u[:, 10], 0.05, 2, Varying(("k", "d"), theta))
    assert np.array_equal(stepped, x[:, 11])


def test_parameters_can_vary_in_time():
    u = np.zeros((1, 100, 1))
    stiff = np.where(np.arange(100) < 50, 4.0, 9.0)[None, :, None]
    x, _ = simulate(SPRING, u, np.array([1.0, 0.0]), varying=Varying(["k"], stiff))
    constant, _ = simulate(SPRING, u, np.array([1.0, 0.0]))
    assert np.array_equal(x[0, :51], constant[0, :51])
    assert not np.allclose(x[0, 60:], constant[0, 60:], atol=1e-3)


def test_what_numba_refuses_runs_as_python_with_one_warning():
    def awkward(x, u, theta):
        return [x[1], sum({"pull": -theta[0] * x[0], "drag": -theta[1] * x[1], "push": u[0]}.values())]

    slow = Simulator(**{**SPRING.__dict__, "rhs": awkward, "name": "awkward"})
    u = np.ones((1, 40, 1))
    with pytest.warns(RuntimeWarning, match="plain Python"):
        x, _ = simulate(slow, u, np.array([1.0, 0.0]))
    assert x == pytest.approx(simulate(SPRING, u, np.array([1.0, 0.0]))[0], abs=1e-12)
    simulate(slow, u, np.array([1.0, 0.0]))  # no second warning: warnings are errors here


def test_a_statement_that_numba_does_not_know_runs_as_python_with_one_warning():
    def checked(x, u, theta):
        if x[0] > 1e9:
            raise ValueError(f"the spring is at {x[0]:.3g} m")
        return np.array([x[1], -theta[0] * x[0] - theta[1] * x[1] + u[0]])

    slow = Simulator(**{**SPRING.__dict__, "rhs": checked, "name": "checked"})
    with pytest.warns(RuntimeWarning, match="plain Python"):
        x, _ = simulate(slow, np.ones((1, 40, 1)), np.array([1.0, 0.0]))
    assert x == pytest.approx(simulate(SPRING, np.ones((1, 40, 1)), np.array([1.0, 0.0]))[0], abs=1e-12)


def test_a_tuple_is_as_good_as_an_array():
    def plain(x, u, theta):
        return (x[1], -theta[0] * x[0] - theta[1] * x[1] + u[0])

    pair = Simulator(**{**SPRING.__dict__, "rhs": plain, "name": "pair"})
    assert compiled(pair).native
    u = np.ones((1, 40, 1))
    assert np.array_equal(simulate(pair, u, np.zeros(2))[0], simulate(SPRING, u, np.zeros(2))[0])


def cubic(x, u, theta):
    return -theta[2] * x[0] ** 3


def test_a_balance_term_appends_its_parameter():
    stiffens = Term("hardening", "the spring stiffens", "balance:v_m_s", (variable("k3", 2.0),), term=cubic)
    hard = with_mechanism(SPRING, stiffens)
    assert [v.name for v in hard.parameters] == ["k", "d", "k3"]
    assert hard.mechanisms == ("hardening",)
    x, u = np.array([0.7, 0.2]), np.array([0.1])
    expected = spring_rhs(x, u, SPRING.theta()) + np.array([0, -2.0 * 0.7**3])
    assert compiled(hard).rhs(x, u, hard.theta()) == pytest.approx(expected)
    absent = hard.with_values(k3=0.0)
    inputs = np.ones((1, 60, 1))
    assert simulate(absent, inputs, x)[0] == pytest.approx(simulate(SPRING, inputs, x)[0])


def test_a_flux_term_acts_on_every_balance_that_shares_it():
    def choke(x, u, theta):
        return -theta[2]

    choked = Term("choke", "less flows between", "flux:between", (variable("c", 0.1),), term=choke)
    leak = with_mechanism(TANKS, choked)
    x, u = np.array([1.0, 0.5]), np.array([0.3])
    plain = compiled(TANKS).rhs(x, u, TANKS.theta())
    assert compiled(leak).rhs(x, u, leak.theta()) - plain == pytest.approx([0.1, -0.1])


def test_input_and_output_terms_and_two_mechanisms_together():
    def offset(x, u, theta):
        return theta[-1]

    pushed = with_mechanism(SPRING, Term("push", "", "input:F_N", (variable("dF", 0.5),), term=offset))
    both = with_mechanism(pushed, Term("zero", "", "output:pos_m", (variable("dy", 0.25),), term=offset))
    x, u = np.array([0.7, 0.2]), np.array([0.1])
    assert compiled(both).rhs(x, u, both.theta()) == pytest.approx(spring_rhs(x, u + 0.5, SPRING.theta()))
    assert compiled(both).output(x, u, both.theta()) == pytest.approx([0.95])
    assert both.mechanisms == ("push", "zero")


def test_a_mechanism_can_bring_its_own_state():
    def lagged(x, u, theta):
        return -theta[2] * x[2]

    def lag(x, u, theta):
        return np.array([(x[1] - x[2]) / 0.5])

    drag = Term(
        "late_drag", "", "balance:v_m_s", (variable("c", 1.5),), states=(variable("lag"),), term=lagged, derivative=lag
    )
    late = with_mechanism(SPRING, drag)
    assert [v.name for v in late.states] == ["x_m", "v_m_s", "lag"]
    assert late.initial(np.zeros(1), np.ones(1), late.theta()) == pytest.approx([1, 0, 0])
    x, u = np.array([0.7, 0.2, 0.4]), np.array([0.0])
    base = spring_rhs(x[:2], u, SPRING.theta())
    assert compiled(late).rhs(x, u, late.theta()) == pytest.approx([base[0], base[1] - 0.6, -0.4])


def test_every_catalogued_amplitude_is_the_plant_when_absent():
    for mechanism in CATALOGUE:
        changed = with_mechanism(PLANT, mechanism)
        assert changed.mechanisms == (mechanism.name,)
        names = [v.name for v in mechanism.parameters]
        assert set(names) <= {v.name for v in PLANT.parameters}
        present = [v.nominal for v in mechanism.parameters]
        assert list(mechanism.absent) != present


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: SPRING.with_values(q=1.0), "has no parameter 'q'"),
        (
            lambda: with_mechanism(SPRING, Term("m", "", "balance:z", (variable("c", 1.0),), term=cubic)),
            "has no balance 'z'",
        ),
        (lambda: Term("m", "", "door:z", (variable("c", 1.0),), term=cubic), "mechanism 'm': port 'door:z' must read"),
        (lambda: Port("balance", ""), "port 'balance' must read balance:NAME, flux:NAME, output:NAME, input:NAME"),
        (lambda: Term("m", "", "balance:z", (), term=cubic), "has no parameters; the first is its size"),
        (lambda: Amplitude("m", "", "balance:z", (variable("c", 1.0),)), "absent has 0 values for 1 parameters"),
        (lambda: with_mechanism(SPRING, LATE), "mechanism 'late': needs whole records, so no equations can hold it"),
        (lambda: Variable("x", "1", 0.0, 1.0, 2.0), "outside"),
        (lambda: simulate(SPRING, np.zeros((1, 5, 2)), np.zeros(2)), "u has 2 columns"),
        (lambda: simulate(SPRING, np.zeros((1, 5, 1)), np.zeros(2), substeps=0), "substeps"),
        (lambda: Simulator(**{**SPRING.__dict__, "rhs": None}), "give rhs"),
        (lambda: Simulator(**{**SPRING.__dict__, "states": SPRING.states * 2}), "named twice"),
    ],
)
def test_a_wrong_description_is_refused_in_words(make, message):
    with pytest.raises(ValueError, match=message):
        make()


@pytest.mark.parametrize(
    ("given", "kind"),
    [({"term": cubic}, "Term"), ({"series": lambda t, y, p: y}, "Series"), ({"absent": (0.0,)}, "Amplitude")],
)
def test_a_mechanism_of_no_kind_is_refused_and_the_kind_is_named(given, kind):
    line = rf"mechanism 'm': write {kind}\(...\) in place of Mechanism\(...\); a mechanism is a Term, an Amplitude or a"
    with pytest.raises(TypeError, match=line):
        Mechanism(name="m", says="", port="balance:z", parameters=(variable("c", 1.0),), **given)


def test_a_port_reads_as_it_is_written_and_finds_its_variable():
    late = Port.parse("output:pos_m")
    assert (late.place, late.variable, str(late)) == ("output", "pos_m", "output:pos_m")
    assert LATE.port == late
    assert late.variable_of(SPRING) is SPRING.outputs[late.index(SPRING)]
    assert replace(LATE, port="input:F_N").port == Port("input", "F_N")


@settings(max_examples=30, deadline=None)
@given(st.floats(0.1, 20), st.floats(0, 2), st.floats(-3, 3))
def test_a_free_oscillator_never_gains_energy(k, d, x0):
    machine = SPRING.with_values(k=k, d=d)
    x, _ = simulate(machine, np.zeros((1, 200, 1)), np.array([x0, 0.0]))
    energy = 0.5 * k * x[0, :, 0] ** 2 + 0.5 * x[0, :, 1] ** 2
    assert energy[-1] <= energy[0] * (1 + 1e-6) + 1e-12
