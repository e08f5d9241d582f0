"""Stribeck friction and Bouc-Wen hysteresis against their closed forms."""

from __future__ import annotations

import math

import numpy as np
import pytest
from motor import MOTOR

from twinbench.mismatch.catalogue import generic
from twinbench.mismatch.friction import TURN_ROUND
from twinbench.mismatch.structure import typical_rates
from twinbench.physics.check import check_mechanism
from twinbench.physics.simulator import Mechanism

SPEED, TRAVEL, STEP_S = 100.0, 40.0, 1e-4


def find(name: str) -> Mechanism:
    return next(m for m in generic(MOTOR) if m.name == name)


def loop(omega, exponent: float, gamma: float, z: float = 0.0) -> list[float]:
    """The built-up force after each step of speeds, by explicit Euler."""
    m = find("bouc_wen_hysteresis@omega_rad_s")
    theta = np.concatenate((MOTOR.theta(), [1.0, TRAVEL, exponent, gamma]))
    out = []
    for speed in omega:
        z += STEP_S * float(m.derivative(np.array([0.0, speed, 300.0, z]), np.zeros(2), theta)[0])
        out.append(z)
    return out


@pytest.mark.parametrize("name", ["stribeck_friction@omega_rad_s", "bouc_wen_hysteresis@omega_rad_s"])
def test_they_keep_the_word_of_a_mechanism_and_belong_to_dry_friction(name):
    check_mechanism(MOTOR, find(name))
    assert find(name).contains == "coulomb_friction@omega_rad_s"


@pytest.mark.parametrize("omega", [150.0, 20.0, -8.0])
def test_stribeck_friction_is_larger_at_low_speed(omega):
    m = find("stribeck_friction@omega_rad_s")
    x, theta = np.array([40.0, omega, 330.0]), np.concatenate((MOTOR.theta(), [3.0, 0.5, 10.0]))
    expected = -3.0 * (1.0 + 0.5 * math.exp(-((omega / 10.0) ** 2))) * math.tanh(omega / (0.05 * 40.0))
    assert m.term(x, np.zeros(2), theta) == pytest.approx(expected)
    assert m.term(np.array([40.0, 0.0, 330.0]), np.zeros(2), theta) == 0.0


def test_bouc_wen_without_gamma_and_of_first_order_is_the_plain_hysteresis():
    plain, bouc_wen = find("hysteresis@omega_rad_s"), find("bouc_wen_hysteresis@omega_rad_s")
    own = MOTOR.theta()
    for omega in (80.0, -80.0):
        for z in (-0.9, -0.2, 0.0, 0.6):
            x = np.array([40.0, omega, 330.0, z])
            first = plain.derivative(x, np.zeros(2), np.concatenate((own, [1.0, TRAVEL])))
            second = bouc_wen.derivative(x, np.zeros(2), np.concatenate((own, [1.0, TRAVEL, 1.0, 0.0])))
            assert second == pytest.approx(first)


def test_the_first_loading_with_exponent_two_is_a_tanh_of_the_way():
    """z' = v (1 - z^2)/(travel + limit v) while v and z are positive, whatever gamma is."""
    limit_s = TURN_ROUND * MOTOR.states[1].scale / typical_rates(MOTOR)[1]
    time_s = STEP_S * np.arange(1, 5001)
    expected = np.tanh(SPEED * time_s / (TRAVEL + limit_s * SPEED))
    for gamma in (-0.4, 0.0, 0.5):
        assert loop(np.full(5000, SPEED), 2.0, gamma) == pytest.approx(expected, abs=2e-3)


def test_with_half_gamma_the_way_back_is_straight_and_the_force_never_exceeds_its_largest():
    limit_s = TURN_ROUND * MOTOR.states[1].scale / typical_rates(MOTOR)[1]
    back = loop(np.full(1000, -SPEED), 3.0, 0.5, z=0.8)
    fall = SPEED * STEP_S * np.arange(1, 1001) / (TRAVEL + limit_s * SPEED)
    loaded = 0.8 - fall > 0.0
    assert loaded.sum() > 500
    assert np.array(back)[loaded] == pytest.approx(0.8 - fall[loaded], abs=1e-9)
    to_and_fro = loop(SPEED * np.sign(np.sin(np.arange(60_000) / 9000.0)), 1.5, 0.2)
    assert np.abs(to_and_fro).max() <= 1.0
    assert np.abs(to_and_fro).max() > 0.95


def test_a_sharper_exponent_reaches_the_full_force_sooner():
    ends = [loop(np.full(2000, SPEED), n, 0.2)[-1] for n in (1.0, 2.0, 5.0)]
    assert ends[0] < ends[1] < ends[2] <= 1.0
