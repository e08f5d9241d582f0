"""Where a mechanism's own states start."""

from __future__ import annotations

import numpy as np
from motor import MOTOR

from twinbench.mismatch.catalogue import generic
from twinbench.physics.compose import with_mechanism


def test_a_second_thermal_mass_starts_as_warm_as_what_it_touches():
    mechanism = next(m for m in generic(MOTOR) if m.name == "second_thermal_mass@T_winding_K")
    motor = with_mechanism(MOTOR, mechanism)
    assert mechanism.states[0].nominal != 391.0
    x0 = motor.initial(np.zeros(2), np.array([120.0, 40.0, 391.0]), motor.theta())
    assert x0.tolist() == [40.0, 120.0, 391.0, 391.0]
