"""Machines that nobody tuned on: the oil cooler, and lumped networks drawn at random."""

from __future__ import annotations

import functools
import itertools
import json
import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from twinbench.data.scenario import stream
from twinbench.mismatch.model import whole_catalogue
from twinbench.physics.compose import plain_rhs
from twinbench.physics.integrate import simulate
from twinbench.physics.simulator import Simulator, Term, Variable
from twinbench.proof.concealed.engine import Engine
from twinbench.proof.concealed.faults import faults, faulty
from twinbench.proof.concealed.generate import Item, draw, write
from twinbench.proof.concealed.integrate import Equations, Parameters, Steps, run
from twinbench.proof.concealed.lumped import random_machine
from twinbench.proof.concealed.lumped_law import OWN, STILL, law, packed, reading, states
from twinbench.proof.concealed.machine import Machine
from twinbench.proof.concealed.machines import MACHINES, machine_of, machines
from twinbench.proof.concealed.networks import DOMAINS
from twinbench.proof.concealed.plan import cases
from twinbench.proof.concealed.severity import Take, Yardstick, readings
from twinbench.proof.lumped.network import Link, Network
from twinbench.proof.lumped.twin import steady, twin, twin_of
from twinbench.proof.twins import simulator_of

SEED = 41
DRAWN = range(20)
SAMPLES = 600
EACH_DOMAIN = range(4, 8)
OF_DRAWN = pytest.mark.parametrize(
    "number", [pytest.param(n, marks=[pytest.mark.slow] * (n not in EACH_DOMAIN)) for n in DRAWN]
)
"""One of each domain; the others by ``make test-slow``, as each has to be compiled."""


def simulator(machine: Machine) -> Simulator:
    return simulator_of(machine.simulator, machine.network)


@functools.cache
def yardstick(number: int) -> Yardstick:
    m = random_machine(SEED, number)
    seconds = m.seconds["train"][0]
    takes = [Take(f"{part}_1", 0.0, m.operate(stream(6, part), seconds, part)) for part in ("train", "held")]
    return Yardstick(m, takes, m.p())


# Truth and twin.


@OF_DRAWN
def test_a_random_truth_without_effects_is_its_twin(number: int) -> None:
    """Written separately, by two integrators."""
    m = random_machine(SEED, number)
    u = m.operate(stream(5, number), SAMPLES * m.period_s, "train")
    x0 = m.settled(u, m.p(), 0.0)
    truth = readings(m, Take("train_1", 0.0, u), u, x0, Parameters.steady(m.p()), m.fine)
    own = x0[: len(simulator(m).states)]
    y = simulate(simulator(m), u[None], own, dt_s=m.period_s, substeps=8)[1][0]
    assert (np.sqrt(np.mean((y - truth) ** 2, axis=0)) < 0.02 * m.sigma()).all()
    assert (truth.std(axis=0) > 2.0 * m.sigma()).all()  # it is moved


@OF_DRAWN
def test_a_random_machine_settles_before_it_is_recorded(number: int) -> None:
    m = random_machine(SEED, number)
    u = m.operate(stream(8, number), 10.0 * m.period_s, "held")
    x0, dx = m.settled(u, m.p(), 0.0), np.empty(len(m.start(u[0], m.p())))
    m.law(0.0, x0, u[0], m.p(), dx)
    scale = np.array([v.scale for v in simulator(m).states])
    assert (np.abs(dx[: len(scale)]) * m.settle_s / 10.0 < 1e-3 * scale).all()
    assert simulator(m).initial(u[0], x0[: len(scale)][m_reads(m)], simulator(m).theta()) == pytest.approx(
        x0[: len(scale)], abs=1e-3 * scale.max(), rel=1e-3
    )


def m_reads(machine: Machine) -> list[int]:
    names = [v["name"] for v in machine.network["states"]]
    return [names.index(name) for name in machine.network["reads"]]


def test_all_four_domains_take_turns_and_another_seed_draws_others() -> None:
    words = ("mass", "rotor"), ("heat",), ("tank", "accumulator"), ("ladder",)
    for number in DRAWN:
        says = random_machine(SEED, number).network["says"]
        assert any(word in says for word in words[number % 4]), says
        assert 2 <= len(random_machine(SEED, number).network["states"]) <= 6
    assert random_machine(SEED, 1).network == random_machine.__wrapped__(SEED, 1).network
    assert random_machine(SEED, 1).network != random_machine(SEED + 1, 1).network


# Effects.


@OF_DRAWN
def test_every_effect_is_in_the_catalogue_of_its_twin(number: int) -> None:
    m = random_machine(SEED, number)
    catalogue = {c.name: c for c in whole_catalogue(simulator(m), (), m.period_s)}
    ports = {f"balance:{v.name}" for v in simulator(m).states} | {f"input:{v.name}" for v in simulator(m).inputs}
    for effect in m.effects:
        assert effect.size in {v.name for v in catalogue[effect.name].parameters}
        assert set(effect.ports) <= ports
    for effect in m.foreign:
        assert effect.name not in catalogue
        assert effect.ports
        assert set(effect.ports) <= ports
    assert {f.name for f in faults(m)} <= set(catalogue)


@pytest.mark.parametrize("number", EACH_DOMAIN)
def test_every_effect_changes_readings_and_fades_to_nothing(number: int) -> None:
    """At a billionth of its size an effect changes next to nothing: it brings no lag or step with it."""
    m, y = random_machine(SEED, number), yardstick(number)
    for effect in (*m.effects, *m.foreign):
        there = y.with_parameters(m.p(**{effect.slot: 5.0 * effect.typical}))
        nearly = y.with_parameters(m.p(**{effect.slot: 1e-9 * effect.typical}))
        off = [np.abs((a - b) / m.sigma()).max() for a, b in zip(nearly, y.base, strict=True)]
        assert max(off) < 1e-5, effect.name
        assert min(y.measure(there)) > 1e-3, effect.name


@pytest.mark.parametrize(("number", "sensor"), [(40, "v1_rad_s"), (20, "q10_rad")])
def test_a_steady_force_on_what_a_spring_holds_is_drawn_only_where_the_spring_is_read(number: int, sensor: str) -> None:
    """It only stretches the spring: of a speed it shows nothing but how its form differs from the catalogue's."""
    m = random_machine(SEED, number)
    assert m.network["reads"] == (sensor,)
    assert [(link["a"], link["b"]) for link in m.network["links"] if link["kind"] == "spring"] == [("v1_rad_s", "")]
    assert ("offset@v1_rad_s" in {e.name for e in m.effects}) == sensor.startswith("q")


ALIKE = ("friction", "loss@", "linear_leak", "quadratic_leak", "constant_drop", "offset", "hardening_spring")


@pytest.mark.parametrize("number", EACH_DOMAIN)
def test_the_catalogue_approximates_an_effect_but_does_not_contain_it(number: int) -> None:
    m, y = random_machine(SEED, number), yardstick(number)
    terms = {c.name: c for c in whole_catalogue(simulator(m)) if isinstance(c, Term)}
    n, theta = len(simulator(m).states), simulator(m).theta()
    x = run(Equations(law, states, len(y.starts[0])), Steps(0.0, m.period_s, 4), y.takes[0].u, y.starts[0],
            Parameters.steady(m.p()))[0]  # fmt: skip
    told = 0
    for effect in m.effects:
        if not any(word in effect.name for word in ALIKE) or "unequal" in effect.name:
            continue
        told, term, dx, without = told + 1, terms[effect.name], np.empty(x.shape[1]), np.empty(x.shape[1])
        at = term.port.index(simulator(m))
        own = np.array([v.nominal for v in term.parameters])
        truth, catalogue = np.empty(len(x)), np.empty(len(x))
        for k, (row, u) in enumerate(zip(x, y.takes[0].u, strict=True)):
            m.law(0.0, row, u, m.p(exponent=1.93, **{effect.slot: own[0]}), dx)
            m.law(0.0, row, u, m.p(exponent=1.93), without)
            truth[k] = dx[at] - without[at]
            catalogue[k] = term.term(row[:n], u, np.concatenate([theta, own]))
        ratio = truth @ catalogue / (catalogue @ catalogue)
        left = np.linalg.norm(truth - ratio * catalogue) / np.linalg.norm(truth)
        assert 0.8 < ratio < 1.25, effect.name
        assert 1e-4 < left < 0.25, effect.name
    assert told


# Closed forms.


def variables(**given: tuple[str, float]) -> tuple[Variable, ...]:
    return tuple(Variable(name, unit, -1e6, 1e6, value, 1.0) for name, (unit, value) in given.items())


def network(links: tuple[Link, ...], stores: dict[str, str], theta: dict[str, float], *springs: str) -> Network:
    names = (*stores, *springs)
    inputs = sorted({link.a for link in links} - set(names) - set(theta) - {""}) or ["idle"]
    return Network(
        name="small", says="small",
        states=variables(**dict.fromkeys(names, ("1", 1.0))), inputs=variables(**dict.fromkeys(inputs, ("1", 0.0))),
        outputs=variables(**{f"read_{n}": ("1", 0.0) for n in names}),
        parameters=variables(**{n: ("1", v) for n, v in theta.items()}), stores=stores, links=links, reads=names,
    )  # fmt: skip


def both_rates(net: Network, x: list[float], u: list[float]) -> np.ndarray:
    """Rates by the twin and by the truth, which must agree."""
    p = np.array(list(packed(net, (), STILL, math.inf).values()))
    dx, s = np.empty(len(x)), twin(net)
    law(0.0, np.array(x), np.array(u), p, dx)
    assert plain_rhs(s)(np.array(x), np.array(u), s.theta()) == pytest.approx(dx, rel=1e-12, abs=1e-15)
    return dx


def course(net: Network, x0: list[float], u: float, dt_s: float, n: int) -> np.ndarray:
    p = np.array(list(packed(net, (), STILL, math.inf).values()))
    steps = Steps(0.0, dt_s, 200)
    return run(Equations(law, reading, len(x0)), steps, np.full((n, 1), u), np.array(x0), Parameters.steady(p))[0]


def test_a_capacitor_charges_through_a_resistor() -> None:
    net = network((Link("resistance", "source", "v", "R"),), {"v": "C"}, {"C": 0.5, "R": 4.0})
    assert course(net, [1.0], 10.0, 1.0, 6)[:, 0] == pytest.approx(10.0 - 9.0 * np.exp(-np.arange(6) / 2.0), rel=1e-5)


def test_a_coil_takes_up_its_current() -> None:
    net = network((Link("inductor", "source", "", "R", "i"),), {"i": "L"}, {"L": 3.0, "R": 2.0})
    assert course(net, [0.0], 8.0, 0.5, 5)[:, 0] == pytest.approx(4.0 * (1.0 - np.exp(-np.arange(5) / 3.0)), rel=1e-5)


def test_a_mass_on_a_spring_swings_with_its_period() -> None:
    net = network((Link("spring", "v", "", "k", "q"),), {"v": "m"}, {"m": 2.0, "k": 8.0}, "q")
    went = course(net, [0.0, 1.0], 0.0, math.pi / 8.0, 9)
    assert went[:, 1] == pytest.approx(np.cos(2.0 * np.arange(9) * math.pi / 8.0), abs=1e-4)


def test_a_tank_empties_by_torricelli() -> None:
    """sqrt(h) falls at a constant rate."""
    net = network((Link("orifice", "h", "", "k", knee=1e-6),), {"h": "A"}, {"A": 10.0, "k": 2.0})
    went = course(net, [16.0], 0.0, 2.0, 10)[:, 0]
    assert np.sqrt(went) == pytest.approx(4.0 - 0.1 * 2.0 * np.arange(10), rel=1e-5)


@settings(max_examples=30, deadline=None)
@given(st.lists(st.floats(-50.0, 50.0), min_size=4, max_size=4))
def test_what_links_exchange_is_conserved(x: list[float]) -> None:
    """No momentum, heat or volume comes from links between stores."""
    links = (
        Link("conductance", "a", "b", "g"), Link("resistance", "b", "c", "r"), Link("orifice", "a", "c", "k", knee=0.1),
        Link("spring", "a", "c", "g", "q"),
    )  # fmt: skip
    sizes = {"A": 3.0, "B": 0.2, "C": 7.0}
    net = network(links, {"a": "A", "b": "B", "c": "C"}, {**sizes, "g": 2.0, "r": 5.0, "k": 1.5}, "q")
    dx = both_rates(net, x, [0.0])
    assert dx[3] == pytest.approx(x[0] - x[2])
    assert dx[:3] @ list(sizes.values()) == pytest.approx(0.0, abs=1e-9 * np.abs(dx).max() * 10.0 + 1e-12)


def test_the_steady_state_does_not_change_and_heats_by_ohms_law() -> None:
    links = (Link("source", "heater", "a"), Link("conductance", "a", "b", "g"), Link("conductance", "room", "b", "l"))
    net = network(links, {"a": "A", "b": "B"}, {"A": 30.0, "B": 50.0, "g": 2.0, "l": 4.0, "room": 290.0})
    s = twin(net)
    x = steady(plain_rhs(s), np.array([100.0]), s.theta(), np.full(2, 300.0), np.ones(2))
    assert x == pytest.approx([290.0 + 25.0 + 50.0, 290.0 + 25.0])


def test_what_the_oil_loses_the_water_gains() -> None:
    m = MACHINES["heat_exchanger"]
    u = np.array([[0.8, 0.4, 350.0, 290.0]])
    oil, water, _ = readings(m, Take("t", 0.0, u), u, m.settled(u, m.p(), 0.0), Parameters.steady(m.p()), 1)[0]
    assert 0.8 * 2000.0 * (350.0 - oil) == pytest.approx(0.4 * 4180.0 * (water - 290.0), rel=1e-6)
    assert 290.0 < water < oil < 350.0


# Names, files, the plan.


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 10**6), st.integers(0, 3))
def test_a_network_survives_json(seed: int, domain: int) -> None:
    sketch = DOMAINS[domain](np.random.default_rng(seed))
    spans = dict.fromkeys(sketch.states, (1.0, 2.0)) | {n: v[2:] for n, v in sketch.inputs.items()}
    net = sketch.network("drawn", spans, (next(iter(sketch.states)),))
    again = Network.from_json(json.loads(json.dumps(net.to_json())))
    assert again == net
    assert twin_of(net.to_json()) is twin(again)


def test_own_parameters_stand_by_name_in_the_truth() -> None:
    m = random_machine(SEED, 2)
    names = [v["name"] for v in m.network["parameters"]]
    assert list(m.parameters)[OWN : OWN + len(names)] == names
    assert set(m.calibrate) == set(names) - set(m.network["known"])
    assert m.rippled in names


def test_random_machines_take_a_third_of_the_cases_and_are_found_by_name() -> None:
    every = machines(SEED, 8)
    assert set(every) == set(MACHINES) | {f"random_{i:03d}" for i in range(8)}
    assert machine_of("random_003", SEED) is every["random_003"]
    planned = cases(600, SEED, every)
    share = np.mean([item.machine.startswith("random") for item in planned])
    assert share == pytest.approx(1.0 / 3.0, abs=0.03)
    assert {item.machine for item in planned} == set(every)
    assert {every[item.machine].kind for item in planned} == {"tuned", "untuned", "random"}


def test_the_blind_process_builds_the_twin_from_the_description(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "tell.py").write_text("""
def tell(simulator, recordings, hold_out=(), catalogue=None):
    x, u = ([v.nominal for v in group] for group in (simulator.states, simulator.inputs))
    rate = simulator.rhs(x, u, simulator.theta())
    return {"verdict": "told", "findings": [], "rate": list(rate), "names": [m.name for m in catalogue]}
""")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    m = random_machine(SEED, 3)
    write(draw(Item("0001", "clean", m.name), SEED), tmp_path / "given")
    engine = Engine(tmp_path / "out", tmp_path / "log")
    try:
        verdict = engine.ask(tmp_path / "given", "tell:tell", 120.0)
    finally:
        engine.close()
    s = simulator(m)
    x, u = ([v.nominal for v in group] for group in (s.states, s.inputs))
    assert verdict.get("rate") == pytest.approx(plain_rhs(s)(x, u, s.theta()).tolist()), verdict
    assert {e.name for e in m.effects} <= set(verdict["names"])


@pytest.mark.parametrize("number", [*EACH_DOMAIN, -1])
def test_the_ripple_multiplies_its_parameter_by_a_wave_of_its_arguments(number: int) -> None:
    m = MACHINES["heat_exchanger"] if number < 0 else random_machine(SEED, number)
    u = m.operate(stream(9, number), SAMPLES * m.period_s, "train")[::10]
    x = np.stack([m.start(row, m.p()) for row in u])
    x *= 1.0 + 0.01 * stream(10, number).standard_normal(x.shape)
    first, second = m.ripple_arguments(x, u).T
    wave = np.sin(first + 0.7) * np.cos(second)
    rippled, meant = np.empty(x.shape[1]), np.empty(x.shape[1])
    for k in range(len(x)):
        m.law(0.0, x[k], u[k], m.p(ripple=0.01, ripple_phase=0.7), rippled)
        m.law(0.0, x[k], u[k], m.p(**{m.rippled: m.parameters[m.rippled] * (1.0 + 0.01 * wave[k])}), meant)
        assert rippled == pytest.approx(meant, rel=1e-9, abs=1e-12)
    assert 0.1 < np.std(wave) < 0.9


@pytest.mark.parametrize("tau_s", [0.1, 0.7, 5.0])
def test_a_lag_is_that_of_the_equation_for_lines_and_for_steps(tau_s: float) -> None:
    """Against many small steps of the equation itself."""
    values, period_s, fine = np.random.default_rng(0).normal(size=60).cumsum(), 0.5, 2000
    lagged = faulty("lag", tau_s, period_s * np.arange(60), values, (0.0, 1.0), False)
    share = (np.arange(fine) + 0.5) / fine
    y, lines, y_of_steps, steps = values[0], [values[0]], values[0], []
    for now, then in itertools.pairwise(values):
        means = 0.0
        for part in share:
            y += (now + part * (then - now) - y) * period_s / fine / tau_s
            y_of_steps += (now - y_of_steps) * period_s / fine / tau_s
            means += y_of_steps / fine
        lines.append(y)
        steps.append(means)
    assert lagged == pytest.approx(np.array(lines), abs=2e-3)
    assert lagged[:-1] == pytest.approx(np.array(steps), abs=5e-3)


def test_the_size_of_an_offset_has_its_sign() -> None:
    """A steady drag slows the motor down: as the catalogue has it, what adds to the rate is below nothing."""
    m = MACHINES["motor"]
    (drag,) = (e for e in m.effects if e.name == "offset@omega_rad_s")
    u, with_it, without = np.array([100.0, 5.0]), np.empty(5), np.empty(5)
    for p, rates in ((m.p(steady=1.0), with_it), (m.p(), without)):
        m.law(0.0, m.start(u, m.p()), u, p, rates)
    assert (with_it - without).sum() == pytest.approx(drag.absent + drag.scale * 1.0)
