"""The engine's parts against oracles: simulation, noise, fit, linear picture, search."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from motor import MOTOR
from motor_case import record
from scipy.signal import lfilter

from twinbench.data.recording import Recording
from twinbench.mismatch.faults import faults
from twinbench.mismatch.fit import Problem, Unknown
from twinbench.mismatch.machine import Machine, Setting
from twinbench.mismatch.many import completed
from twinbench.mismatch.noise import MEMORY_BLOCKS_MOST, Whitener, blocks_to_forget, fit_whitener, noise_floor
from twinbench.mismatch.picture import RARE, Picture, Variant
from twinbench.mismatch.proof import Gain
from twinbench.mismatch.search import EFFECT_PENALTY, best_sets, local_search, wander
from twinbench.mismatch.solve import solve
from twinbench.mismatch.tracks import held, prepare
from twinbench.physics.integrate import simulate
from twinbench.physics.nominal import NOMINAL
from twinbench.physics.simulator import Port


@pytest.fixture(scope="module")
def track():
    return prepare([record("run", 3, seconds=40.0)], MOTOR)[0]


@pytest.fixture(scope="module")
def machine():
    return Machine(MOTOR, ())


def test_the_machine_runs_as_the_simulator_does(machine, track):
    x0 = machine.start(track)
    machine.step_s = 0.04
    _, expected = simulate(MOTOR, track.u[None], x0, dt_s=0.08, substeps=2)
    np.testing.assert_allclose(machine.run(Setting(track, machine.theta, x0)), expected[0], rtol=1e-9)


def test_block_by_block_is_nearly_sample_by_sample_and_what_is_missing_is_added(machine):
    slow = prepare([record("slow", 4, seconds=60.0, dt_s=0.02)], MOTOR, blocks=600)[0]
    assert slow.coarse.samples.tolist() == [5] * 600
    machine.settle_step([slow], np.array([1.0, 0.5, 0.5]))
    x0 = machine.start(slow)
    fine = slow.block_means(machine.run(Setting(slow, machine.theta, x0)))
    coarse = machine.run(Setting(slow, machine.theta, x0), blocks=True)
    assert (np.sqrt(np.nanmean((coarse - fine) ** 2, axis=0)) < 0.05 * np.nanstd(fine, axis=0)).all()
    problem = Problem(machine, [slow], (), Whitener(np.zeros((3, 0)), np.ones(3)), [x0])
    np.testing.assert_allclose(problem.refined(problem.z0).residual(0, problem.z0), slow.means - fine, atol=1e-9)


def test_a_force_is_a_rate_of_its_balance(machine, track):
    theta = machine.theta.copy()
    theta[machine.force_at[Port("balance", "T_winding_K")]] = 0.1
    with_force = machine.run(Setting(track, theta, machine.start(track)))
    without = machine.run(Setting(track, machine.theta, machine.start(track)))
    assert (with_force - without)[1, 2] == pytest.approx(0.1 * 0.08, rel=0.02)


def test_a_divergence_ends_in_nan(machine, track):
    theta = machine.theta.copy()
    theta[MOTOR.index("L_H")] = -1e-3
    y = machine.run(Setting(track, theta, machine.start(track)))
    assert np.isfinite(y[0]).all()
    assert np.isnan(y[-1]).all()


def test_whitening_turns_an_autoregression_white():
    rng = np.random.default_rng(1)
    e = rng.normal(size=(20_000, 2))
    r = np.stack([lfilter([2.0], [1.0, -0.7, 0.2], e[:, 0]), 0.5 * e[:, 1]], axis=-1)
    whitener = fit_whitener([r], np.zeros(2))
    assert whitener.a[0, :2] == pytest.approx([0.7, -0.2], abs=0.03)
    assert whitener.sd == pytest.approx([2.0, 0.5], rel=0.02)
    assert whitener.variance() == pytest.approx(r.var(axis=0), rel=0.05)
    assert whitener(r)[5:] == pytest.approx(e[5:], abs=0.2)


def test_noise_is_whitened_and_a_slow_misfit_is_counted_for_what_it_tells():
    rng = np.random.default_rng(6)
    noise = lfilter([1.0], [1.0, -0.8], rng.normal(size=(3, 4000)), axis=-1)
    misfit = np.repeat(rng.normal(size=(3, 40)), 100, axis=-1)
    for series, slow in ((noise, False), (misfit + 0.05 * noise, True)):
        residuals = [s[:, None] for s in series]
        lasts = blocks_to_forget(list(series))
        whitener = fit_whitener(residuals, np.zeros(1))
        assert (lasts > 2 * MEMORY_BLOCKS_MOST) == slow
        assert bool(whitener.a.any()) != slow
        assert whitener.variance() == pytest.approx([np.var(series)], rel=0.1)
        cost = sum(float(np.sum(whitener(r) ** 2)) for r in residuals)
        assert cost == pytest.approx(12_000 / (lasts if slow else 1.0), rel=0.05)
    assert blocks_to_forget(list(noise)) == pytest.approx((1 + 0.8) / (1 - 0.8), rel=0.2)


def test_a_gap_is_no_reading_of_the_white_residual():
    whitener = Whitener(np.array([[0.5, 0.0, 0.0]]), np.ones(1))
    r = np.ones((10, 1))
    r[5] = np.nan
    assert np.isnan(whitener(r)[5:9, 0]).all()
    assert whitener(r)[4, 0] == pytest.approx(0.5)


def test_the_noise_floor_of_white_noise_on_a_smooth_signal():
    rng = np.random.default_rng(2)
    t = np.linspace(0, 20, 4000)
    y = np.stack([np.sin(t), t**2], axis=-1) + rng.normal(size=(4000, 2)) * [0.3, 2.0]
    assert noise_floor([y]) == pytest.approx([0.3, 2.0], rel=0.2)


def test_gaps_in_inputs_are_held():
    column = np.array([[np.nan], [1.0], [np.nan], [3.0], [np.nan]])
    assert held(column).ravel().tolist() == [1.0, 1.0, 1.0, 3.0, 3.0]


def test_the_fit_finds_the_parameters_of_another_simulation(machine, track):
    names = ("R_ohm", "J_kg_m2", "b_Nms")
    true = {"R_ohm": 0.7, "J_kg_m2": 1.3, "b_Nms": 0.07}
    theta = machine.theta.copy()
    for name, value in true.items():
        theta[MOTOR.index(name)] = value
    y = machine.run(Setting(track, theta, machine.start(track)))
    clean = replace(track, y=y, means=track.block_means(y))
    unknowns = tuple(
        Unknown(n, "parameter", MOTOR.index(n), 0.0, 5.0, v.nominal, np.inf, v.scale)
        for n in names
        for v in MOTOR.parameters
        if v.name == n
    )
    problem = Problem(machine, [clean], unknowns, Whitener(np.zeros((3, 0)), np.ones(3)), [machine.start(track)])
    z, cost = solve(problem, problem.z0, 20)
    assert dict(zip(names, z, strict=True)) == pytest.approx(true, rel=2e-3)
    assert cost < 1.0


def pictured(columns: np.ndarray, r: np.ndarray) -> Picture:
    """A picture of plain columns (N, V) and a residual (N,), nothing projected out."""
    n = columns.shape[1]
    wide = np.full(n, 1e6)
    variants = tuple(Variant(i, ()) for i in range(n))
    G, b, none = columns.T @ columns, columns.T @ r, np.zeros(n)
    return Picture(
        variants, G, b, -wide, wide, np.ones(n), [], [], none, none.astype(bool), none.astype(int), np.arange(n)
    )


def test_the_gain_of_a_set_is_that_of_least_squares():
    rng = np.random.default_rng(4)
    C, r = rng.normal(size=(200, 5)), rng.normal(size=200)
    shown = pictured(C, r)
    for chosen in ((0,), (1, 3), (0, 2, 4)):
        _, left, _, _ = np.linalg.lstsq(C[:, chosen], r, rcond=None)
        assert shown.gain(chosen) == pytest.approx(float(r @ r - left[0]), rel=1e-6)


def test_two_effects_that_look_poor_alone_are_found_together():
    rng = np.random.default_rng(5)
    common, a, b = rng.normal(size=(3, 500))
    C = np.stack([common + 0.1 * a, common + 0.1 * b, *rng.normal(size=(12, 500))], axis=-1)
    r = 30.0 * (C[:, 0] - C[:, 1]) + rng.normal(size=500)
    shown = pictured(C, r)
    assert (0, 1) in [tuple(sorted(s)) for s in best_sets(shown, 6)]
    assert local_search(shown, (0, 1, 5), 6, 16.0) == (0, 1)


def test_a_walk_finds_what_single_steps_do_not():
    rng = np.random.default_rng(7)
    true = rng.normal(size=(800, 3))
    # Two impostors carry two parts each of three effects: no single swap leads from them to the truth.
    fakes = np.stack([true[:, 0] + true[:, 1], true[:, 1] + true[:, 2]], axis=-1) + 0.3 * rng.normal(size=(800, 2))
    r = 4.0 * true.sum(axis=1) + rng.normal(size=800)
    shown = pictured(np.concatenate((fakes, true, rng.normal(size=(800, 20))), axis=1), r)
    assert wander(shown, (0, 1), 6, EFFECT_PENALTY) == (2, 3, 4)


@pytest.mark.parametrize(
    ("found", "of", "worth", "comes"),
    [
        (5, 12, 9.0, True),
        (5, 12, 5.0, False),
        (3, 60, 9.0, False),
        (3, 60, 14.0, True),
    ],
)
def test_what_is_likely_beside_so_many_effects_must_earn_less(monkeypatch, found, of, worth, comes):
    """Of independent candidates the first ones gain 1000 units, the next one ``worth``, the others nothing."""
    r = np.zeros(of)
    r[:found], r[found] = np.sqrt(1000.0), np.sqrt(worth)
    shown = pictured(np.eye(of), r)
    physics = [SimpleNamespace(mechanism=SimpleNamespace(port=Port("balance", "x"))) for _ in range(of)]
    machine = SimpleNamespace(candidates=physics)
    problem = SimpleNamespace(machine=machine)
    best = SimpleNamespace(
        problem=problem, names=tuple("abcde"[:found]), chosen=shown.variants[:found], bare=problem, z=r, first=0
    )
    monkeypatch.setattr("twinbench.mismatch.many.is_fault", lambda candidate: False)
    monkeypatch.setattr("twinbench.mismatch.many.refit", lambda problem, z, shown, chosen, rounds: chosen)
    ends = completed(best, shown)
    assert (ends == tuple(range(found + 1))) if comes else (ends is best)


def test_a_faulty_sensor_that_is_not_alone_must_earn_more():
    rng = np.random.default_rng(8)
    C = rng.normal(size=(300, 2))
    r = 0.3 * C.sum(axis=1) + 0.1 * rng.normal(size=300)
    healthy, faulty = pictured(C, r), replace(pictured(C, r), faults=np.ones(2, bool))
    assert healthy.score((0, 1), EFFECT_PENALTY) - faulty.score((0, 1), EFFECT_PENALTY) == pytest.approx(RARE)
    assert healthy.score((0,), EFFECT_PENALTY) == faulty.score((0,), EFFECT_PENALTY)
    mixed = replace(healthy, faults=np.array([True, False]))
    assert healthy.score((0, 1), EFFECT_PENALTY) - mixed.score((0, 1), EFFECT_PENALTY) == pytest.approx(RARE)


def test_a_size_beyond_its_bounds_explains_nothing():
    C = np.ones((50, 1))
    shown = pictured(C, np.full(50, -2.0))
    assert shown.gain((0,)) == pytest.approx(200.0, rel=1e-6)
    assert replace(shown, low=np.zeros(1)).gain((0,)) == -np.inf


def test_a_known_fault_is_there_without_being_asked_for(track):
    offered = {m.name: m for m in faults(MOTOR)}
    bias, slow = offered["sensor_bias@speed_rad_s"], offered["input_lag@voltage_V"]
    machine, asked = Machine(MOTOR, (), (bias, slow)), Machine(MOTOR, (bias, slow))
    theta = asked.theta.copy()
    for candidate in asked.candidates:
        theta[list(candidate.at)] = candidate.typical
    x0 = machine.start(track)
    for blocks in (False, True):
        expected = asked.run(Setting(track, theta, x0), blocks=blocks)
        np.testing.assert_array_equal(machine.run(Setting(track, machine.theta, x0), blocks=blocks), expected)
        assert np.abs(expected - asked.run(Setting(track, asked.theta, x0), blocks=blocks)).max() > 0.0


def test_what_a_start_lets_loose_in_a_stiff_machine_is_followed_sample_by_sample():
    seconds = np.arange(0.0, 60.0, 0.05)
    values = np.tile([0.95, 298.0, 1350.0, 0.64, 3.1, 430.0, 0.12], (len(seconds), 1))
    values[:, 4:] *= 1.0 + 0.01 * np.sin(seconds / 10.0)[:, None]  # slow enough for blocks
    channels = tuple(v.name for v in (*NOMINAL.inputs, *NOMINAL.outputs))
    track = prepare([Recording("run", seconds, channels, values)], NOMINAL, blocks=66)[0]
    machine = Machine(NOMINAL, ())
    machine.settle_step([track], np.array([0.01, 0.5, 0.001]))
    x0 = machine.start(track)
    x0[0] += 0.2
    fine = track.block_means(machine.run(Setting(track, machine.theta, x0)))
    coarse = machine.run(Setting(track, machine.theta, x0), blocks=True)
    assert track.coarse.samples[0] == 18
    assert (np.abs(coarse - fine) < np.array([0.01, 0.5, 0.001])).all()


def test_no_more_than_all_is_removed():
    assert Gain(0.934, 0.9, 0.96, 1.0).says == "93 % of the excess error (90 % interval 90 to 96)"
    assert Gain(9.0, -0.5, 9.0, 0.001).says == "100 % of the excess error (90 % interval -50 to 100)"
