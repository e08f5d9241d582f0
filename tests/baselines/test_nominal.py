"""Recalibration finds the constants that generated the data, and makes a fair opponent of the nominal model."""

import numpy as np
import pytest

from twinbench.baselines.nominal_ekf import recalibrate, rescaled
from twinbench.data.benchmark import DesignConfig, simulate_benchmark
from twinbench.machines.compressor import COMPRESSOR
from twinbench.physics.compressor import PLANT
from twinbench.physics.integrate import Varying, simulate
from twinbench.physics.nominal import NOMINAL, RECALIBRATED

HEALTH = COMPRESSOR.health_names


@pytest.fixture(scope="module")
def train():
    return simulate_benchmark(
        DesignConfig(n_train=4, n_validation=1, n_calibration=1, n_test=1, n_single=0, minutes=8.0, warmup_minutes=1.0)
    ).train


def test_wrong_constants_of_the_exact_plant_are_found(train):
    wrong = np.array([1.06, 0.95, 0.8, 1.1])
    factors = recalibrate(rescaled(PLANT, RECALIBRATED, wrong), train, minutes=6.0)
    assert factors * wrong == pytest.approx(1.0, abs=0.03)


def flow_error(machine, train):
    """Mean of simulated minus true flow, in parts of the mean."""
    x0 = train.truth.states[:, 0, : len(machine.states)]
    _, y = simulate(machine, train.truth.inputs, x0, varying=Varying(HEALTH, train.truth.health))
    flow = train.truth.outputs[:, 400:, 2]
    return float((y[:, 400:, 2] - flow).mean() / flow.mean())


def test_the_nominal_model_delivers_too_much_until_it_is_recalibrated(train):
    factors = recalibrate(NOMINAL, train, minutes=6.0)
    assert len(factors) == len(RECALIBRATED)
    assert flow_error(NOMINAL, train) > 0.02
    assert abs(flow_error(rescaled(NOMINAL, RECALIBRATED, factors), train)) < 0.01
