"""A motor with dry friction that its simulator lacks, and what the engine says of it."""

from __future__ import annotations

from functools import cache

import numpy as np
from helpers.plain import diagnosed
from motor import MOTOR
from motor_case import record

from twinbench.mismatch import Verdict
from twinbench.mismatch.catalogue import generic
from twinbench.mismatch.faults import faults

LISTED = (
    "coulomb_friction@omega_rad_s", "quadratic_friction@omega_rad_s", "offset@omega_rad_s", "offset@T_winding_K",
    "sensor_bias@amps_A", "sensor_gain@T_probe_K", "sensor_lag@T_probe_K", "input_bias@voltage_V",
)  # fmt: skip
CATALOGUE = tuple(m for m in (*generic(MOTOR), *faults(MOTOR, 0.08)) if m.name in LISTED)


def dry_friction(t, x, u):
    """Another form than the catalogue's: a steep arc tangent."""
    return np.array([0.0, -1.2 / np.pi * np.arctan(x[1] / 1.5) * 2.0, 0.0])


def examined(extra=lambda t, x, u: np.zeros(3), sensor=lambda t, y: y, catalogue=CATALOGUE) -> Verdict:
    fitted = [record(f"run {s}", s, extra, sensor) for s in (1, 2)]
    return diagnosed(MOTOR, fitted, [record("held out", 9, extra, sensor, reach=1.3)], catalogue)


@cache
def friction_found() -> Verdict:
    """Of the motor with dry friction; once for a process. Nobody may change it."""
    return examined(dry_friction)
