"""Harder conditions are what they say, and nothing but the readings or the load is touched."""

from __future__ import annotations

import numpy as np
import pytest

from twinbench.data.benchmark import PARTS, DesignConfig, simulate_benchmark
from twinbench.data.disturb import CONDITIONS, FAULTS, Condition, conditions, faults, simulate_condition, with_fault
from twinbench.machines.compressor import CHANNELS, SAMPLE_PERIOD_S
from twinbench.machines.motor import MOTOR
from twinbench.machines.two_tanks import TWO_TANKS

SMALL = DesignConfig(n_train=1, n_validation=1, n_calibration=1, n_test=2, n_single=0, minutes=4.0, warmup_minutes=0.5)


@pytest.fixture(scope="module")
def undisturbed():
    return simulate_condition(SMALL, Condition("fault", "none"))


@pytest.mark.parametrize("fault", FAULTS, ids=lambda f: f.name)
def test_a_fault_begins_and_ends_and_touches_its_channels_only(fault, undisturbed):
    before = undisturbed.measured[0]
    after = with_fault(before, fault, np.random.default_rng(0))
    touched = ~((before == after) | (np.isnan(before) & np.isnan(after)))
    assert not touched[:, [i for i, c in enumerate(CHANNELS) if c not in fault.channels]].any()
    rows = np.flatnonzero(touched.any(axis=1))
    begin = len(before) // 2
    assert begin <= rows[0] <= begin + 20
    assert rows[-1] < begin + fault.seconds / SAMPLE_PERIOD_S
    assert rows[-1] > min(begin + fault.seconds / SAMPLE_PERIOD_S, len(before)) - 60


def test_faster_wear_ends_sooner_at_the_same_place(undisturbed):
    fast = simulate_condition(SMALL, Condition("pace", "fast", pace=4.0))
    assert fast.truth.health[:, -1] == pytest.approx(undisturbed.truth.health[:, -1])
    moved = [np.ptp(b.truth.health, axis=1) for b in (fast, undisturbed)]
    assert (moved[0] == pytest.approx(moved[1])) or (moved[0] >= moved[1] - 1e-12).all()
    changing = (np.diff(undisturbed.truth.health, axis=1) != 0).sum()
    assert (np.diff(fast.truth.health, axis=1) != 0).sum() < 0.5 * changing


def test_loads_beyond_the_envelope_reach_farther(undisturbed):
    beyond = simulate_condition(SMALL, Condition("envelope", "far", beyond=0.4))
    N = CHANNELS.index("N_rpm")
    assert np.ptp(beyond.truth.inputs[..., N]) == pytest.approx(1.4 * np.ptp(undisturbed.truth.inputs[..., N]))


def test_every_condition_has_a_name_of_its_own():
    names = [c.name for c in CONDITIONS]
    assert len(set(names)) == len(names)
    assert sum(c.group == "noise and dropout" for c in CONDITIONS) == 30


def test_a_gradual_bias_grows_and_fades():
    readings = np.ones((12_000, len(CHANNELS)))
    (fault,) = (f for f in FAULTS if f.name == "gradual bias p_dis_bar")
    shift = (with_fault(readings, fault, np.random.default_rng(0)) - readings)[:, CHANNELS.index("p_dis_bar")]
    there = np.flatnonzero(shift)
    assert len(there) * SAMPLE_PERIOD_S == pytest.approx(fault.seconds)
    whole = shift[there] == shift.max()
    assert whole.sum() * SAMPLE_PERIOD_S == pytest.approx(fault.seconds - 2.0 * fault.rise_s, abs=0.2)
    assert np.abs(np.diff(shift)).max() < 1.01 * shift.max() * SAMPLE_PERIOD_S / fault.rise_s


def test_the_sequences_are_none_of_the_benchmarks(undisturbed):
    ours = simulate_benchmark(SMALL)
    seen = {row.tobytes() for part in (getattr(ours, name) for name in PARTS) for row in part.truth.inputs[:, :100]}
    assert not seen & {row.tobytes() for row in undisturbed.truth.inputs[:, :100]}


@pytest.mark.parametrize("machine", [TWO_TANKS, MOTOR], ids=lambda m: m.name)
def test_any_machine_has_faults_of_its_own_channels(machine):
    every = faults(machine)
    assert {c for f in every for c in f.channels} == set(machine.channels)
    commands = {noise.channel for noise in machine.noise if noise.white == 0.0}
    assert not {f.channels[0] for f in every if f.name.startswith("loss ")} & commands
    assert not [c for c in conditions(machine) if c.group == "envelope"]  # it has no loads beyond
    lost = next(f for f in every if f.name == f"stuck {machine.outputs[0]}")
    batch = simulate_condition(SMALL, Condition("fault", lost.name, fault=lost), machine)
    assert batch.machine is machine
    column = batch.measured[0, :, len(machine.inputs)]
    held = np.flatnonzero(np.diff(column) == 0.0)
    begin = len(column) // 2
    assert set(range(begin, round(begin + 60.0 / machine.sample_period_s) - 1)) <= {*held}


def test_a_drift_is_in_the_sensors_own_noise():
    readings = np.ones((6_000, len(MOTOR.channels)))
    (fault,) = (f for f in faults(MOTOR) if f.name == "bias amps_A")
    shift = (with_fault(readings, fault, np.random.default_rng(0), MOTOR) - readings)[:, MOTOR.channels.index("amps_A")]
    assert shift.max() == pytest.approx(6.0 * np.hypot(0.3, 0.2))
    assert np.count_nonzero(shift) * MOTOR.sample_period_s == pytest.approx(60.0)
