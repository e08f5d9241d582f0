"""The equations that every filter of a model shares: their slopes, the drift, the slow errors."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numba import njit

from twinbench.baselines.augmented_model import linearise, measure, shown
from twinbench.baselines.nominal_ekf import NominalEKF
from twinbench.bench.contract.subject import small_benchmark
from twinbench.machines.compressor import COMPRESSOR
from twinbench.machines.motor import MOTOR
from twinbench.machines.two_tanks import TWO_TANKS
from twinbench.physics.compile import compiled
from twinbench.physics.jit import as_argument

N_HEALTH, N_NOISE = len(COMPRESSOR.health), len(COMPRESSOR.outputs)
PRESSURE_DRIFT_SHARE = COMPRESSOR.drift.share
U = np.array([0.95, 298.0, 1350.0, 0.64])
U_SD = np.array([0.0014, 0.2, 1.5, 0.0])
WHITE, COLOURED = np.array([0.012, 0.6, 0.001]), np.array([0.008, 0.4, 0.0006])


class Watched(NominalEKF):
    """Shows its filter."""

    @property
    def equations(self):
        equations = compiled(self.simulator())
        return as_argument(equations.rhs), as_argument(equations.output), self._model


@pytest.fixture(scope="module")
def ekf():
    estimator = Watched(calibration_minutes=0.5, slow_error=1.0)
    estimator.fit(small_benchmark().train, small_benchmark().validation, 0)
    return estimator


@pytest.fixture(scope="module")
def at(ekf):
    z, P = ekf.start(1)
    return z[0] + 0.3 * np.sqrt(np.diag(P[0])) * np.cos(np.arange(z.shape[1]))


def moved(ekf, z, u=U):
    return linearise(ekf.equations[0], ekf.equations[2], z, u, U_SD)[0]


def read(ekf, z, u=U):
    """What the sensors would read."""
    innovation, _, _ = measure(*ekf.equations[1:], z, u, np.zeros(3), WHITE, COLOURED)
    return -innovation


def test_slopes_are_those_of_the_equations(ekf, at):
    _, F, _ = linearise(ekf.equations[0], ekf.equations[2], at, U, U_SD)
    _, H, _ = measure(*ekf.equations[1:], at, U, np.zeros(3), WHITE, COLOURED)
    sd = np.sqrt(np.diag(ekf.start(1)[1][0]))
    steps = 1e-3 * np.maximum(sd, 1e-9)
    for slope, function in ((F, moved), (H, read)):
        for j, step in enumerate(steps):
            ends = [function(ekf, at + sign * step * np.eye(len(at))[j]) for sign in (1.0, -1.0)]
            expected = (ends[0] - ends[1]) / (2.0 * step)
            unit = np.abs(slope).max(axis=1) + 1e-12
            np.testing.assert_allclose(slope[:, j] / unit, expected / unit, atol=0.01, err_msg=f"entry {j}")


def test_both_pressure_sensors_read_high_by_the_drift(ekf, at):
    drift = len(at) - len(ekf.arrays["slow_error.sd"]) - 1
    far = at.copy()
    far[drift] += 5.0
    share = 1.0 + PRESSURE_DRIFT_SHARE * far[drift]
    none = at.copy()
    none[drift] = 0.0
    # The machine sees the same suction pressure where the sensor reads more by the drift.
    read_high = U * np.array([share, 1.0, 1.0, 1.0])
    states = slice(0, drift - N_NOISE - N_HEALTH)
    np.testing.assert_allclose(moved(ekf, far, read_high)[states], moved(ekf, none)[states], rtol=1e-12)
    coloured = COLOURED * at[drift - N_NOISE : drift]
    clean, high = read(ekf, none) - coloured, read(ekf, far, read_high) - coloured
    np.testing.assert_allclose(high, clean * [share, 1.0, 1.0], rtol=1e-12)


def test_slow_errors_act_on_their_states_tick_by_tick(ekf, at):
    n = len(ekf.arrays["slow_error.sd"])
    other = at.copy()
    other[-n:] += ekf.arrays["slow_error.sd"]
    np.testing.assert_allclose((moved(ekf, other) - moved(ekf, at))[:n], ekf.arrays["slow_error.sd"], rtol=1e-6)


def test_it_starts_from_the_population(ekf):
    z, P = ekf.start(2)
    health = slice(ekf.reported()[-N_HEALTH], ekf.reported()[-1] + 1)
    np.testing.assert_array_equal(z[:, health], np.tile(COMPRESSOR.prior[0], (2, 1)))
    np.testing.assert_array_equal(P[1, health, health], COMPRESSOR.prior[1])


def test_a_forecast_starts_from_the_present_inputs_without_drift(ekf):
    state = ekf.init(1)
    inputs = np.tile(U, (1, 40, 1))
    z = state.memory[0][0]
    x = ekf.forecast(state, inputs)
    assert x.shape == (1, 40, 3)
    drifted = z.copy()
    drifted[-len(ekf.arrays["slow_error.sd"]) - 1] = 10.0
    lower = ekf.forecast(state._replace(memory=(drifted[None], *state.memory[1:])), inputs)
    assert (lower[0, -1, [0, 2]] < x[0, -1, [0, 2]]).all(), "less suction pressure, less of both"


@pytest.mark.parametrize("machine", [COMPRESSOR, TWO_TANKS, MOTOR], ids=lambda m: m.name)
def test_only_a_bias_acts_on_what_is_read(machine):
    for simulator in (machine.plant, machine.reduced):
        np.testing.assert_array_equal(shown(machine, simulator), [h.on_readings for h in machine.health])


@njit(cache=False)
def scaled(x, u, theta):
    """The upper level's sensor reads in proportion to what the pump gives."""
    return np.array([x[0] * theta[0], x[1] + theta[4]])


def test_a_health_parameter_that_also_acts_on_readings_is_seen():
    plant = replace(TWO_TANKS.plant, output=scaled)
    np.testing.assert_array_equal(shown(TWO_TANKS, plant), [True, False, False, False, True])
