"""The engine's parts against oracles: simulation, noise, fit."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from motor import MOTOR
from motor_case import record

from twinbench.data.recording import Recording
from twinbench.mismatch.faults import faults
from twinbench.mismatch.fit import Problem, Unknown
from twinbench.mismatch.machine import Machine, Setting
from twinbench.mismatch.noise import noise_floor
from twinbench.mismatch.series import held
from twinbench.mismatch.solve import solve
from twinbench.mismatch.steps import settle_step
from twinbench.mismatch.tracks import prepare
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
    settle_step(machine, [slow], np.array([1.0, 0.5, 0.5]))
    x0 = machine.start(slow)
    fine = slow.block_means(machine.run(Setting(slow, machine.theta, x0)))
    coarse = machine.run(Setting(slow, machine.theta, x0), blocks=True)
    assert (np.sqrt(np.nanmean((coarse - fine) ** 2, axis=0)) < 0.05 * np.nanstd(fine, axis=0)).all()
    problem = Problem(machine, [slow], (), np.ones(3), [x0])
    np.testing.assert_allclose(problem.refined(problem.z0).residual(0, problem.z0), slow.means - fine, atol=1e-9)


def test_a_problem_with_too_few_parameters_is_refused(machine, track):
    with pytest.raises(ValueError, match=f"theta has 1 values; the machine has {len(machine.theta)} parameters"):
        Problem(machine, [track], (), np.ones(3), theta=machine.theta[:1])


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
    problem = Problem(machine, [clean], unknowns, np.ones(3), [machine.start(track)])
    z, cost = solve(problem, problem.z0, 20)
    assert dict(zip(names, z, strict=True)) == pytest.approx(true, rel=2e-3)
    assert cost < 1.0


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
    settle_step(machine, [track], np.array([0.01, 0.5, 0.001]))
    x0 = machine.start(track)
    x0[0] += 0.2
    fine = track.block_means(machine.run(Setting(track, machine.theta, x0)))
    coarse = machine.run(Setting(track, machine.theta, x0), blocks=True)
    assert track.coarse.samples[0] == 18
    assert (np.abs(coarse - fine) < np.array([0.01, 0.5, 0.001])).all()
