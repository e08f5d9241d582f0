"""How finely a machine is integrated: against steps that are much finer, whatever the recorder's rate."""

from __future__ import annotations

import numpy as np
import pytest
from motor import MOTOR
from motor_case import record

from twinbench.mismatch.machine import Machine, Setting
from twinbench.mismatch.steps import BLOCKED, settle_step
from twinbench.mismatch.tracks import prepare

NOISE = np.array([0.5, 0.5, 0.05])


@pytest.mark.parametrize("linear", [True, False])
@pytest.mark.parametrize("dt_s", [0.02, 0.2, 1.0])
def test_a_step_is_fine_enough_however_seldom_a_machine_is_read(dt_s: float, linear: bool) -> None:
    """At one reading a second the current follows its input within a tenth of what lies between two."""
    (track,) = prepare([record("seldom", 4, seconds=max(40.0, 60.0 * dt_s), dt_s=dt_s)], MOTOR, linear=linear)
    machine = Machine(MOTOR, ())
    assert settle_step(machine, [track], NOISE) == ""
    setting = Setting(track, machine.theta, machine.start(track))
    ours, by_blocks, step_s = machine.run(setting), machine.run(setting, blocks=True), machine.step_s
    machine.step_s = step_s / 16.0
    exact = machine.run(setting)
    assert (np.sqrt(np.mean((ours - exact) ** 2, axis=0)) < 0.05 * NOISE / 10.0).all()
    missed = by_blocks - track.block_means(exact)
    enough = np.maximum(0.2 * NOISE, BLOCKED * np.std(exact, axis=0))
    assert (np.sqrt(np.nanmean(missed**2, axis=0)) < 1.1 * enough).all()
