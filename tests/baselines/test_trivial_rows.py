"""Rows that cost nothing: the mean of training whatever is read, and the last readings as they stand."""

from __future__ import annotations

import numpy as np
import pytest

from twinbench.baselines.always_prior import AlwaysPrior
from twinbench.baselines.last_value import LastValue
from twinbench.baselines.training_mean import TrainingMean
from twinbench.bench.contract.subject import small_benchmark
from twinbench.machines.compressor import COMPRESSOR
from twinbench.methods.estimator import Sample
from twinbench.physics.compressor import M_REF_KG_S
from twinbench.physics.places import places

ESTIMATE, STATES = places(COMPRESSOR.quantities), len(COMPRESSOR.estimated)

READING = np.array([[0.95, 298.0, 1350.0, 0.5, 3.0, 420.0, 0.5 * M_REF_KG_S]])


def fitted(kind):
    split = small_benchmark()
    estimator = kind()
    estimator.fit(split.train, split.validation, 0)
    return estimator


def test_the_mean_of_training_is_that_and_its_intervals_hold_training():
    estimator, truth = fitted(TrainingMean), small_benchmark().train.truth
    state, _ = estimator.step(estimator.init(1), Sample(0.0, READING))
    true = truth.estimated.reshape(-1, 10)
    np.testing.assert_allclose(state.mean[0], true.mean(axis=0))
    np.testing.assert_allclose(
        ((state.low <= true) & (true <= state.high)).mean(axis=0).clip(max=0.95), 0.95, atol=1e-3
    )
    said = estimator.forecast(state, np.zeros((1, 5, 4)))
    np.testing.assert_allclose(said, np.tile(truth.outputs.mean(axis=(0, 1)), (1, 5, 1)))


def test_the_last_value_is_held_over_gaps_and_foretold():
    estimator = fitted(LastValue)
    state = estimator.init(1)
    state, _ = estimator.step(state, Sample(0.0, READING))
    state, _ = estimator.step(state, Sample(0.05, np.full((1, 7), np.nan)))
    assert state.mean[0, ESTIMATE.p_exh_bar] == 3.0
    assert state.mean[0, ESTIMATE.T_gas_K] == 420.0
    assert state.mean[0, ESTIMATE.flow_memory] == pytest.approx(0.5)
    np.testing.assert_allclose(estimator.forecast(state, np.zeros((1, 3, 4))), np.tile(READING[:, 4:], (1, 3, 1)))


def test_the_last_value_knows_no_more_of_health_than_the_prior():
    last, prior = fitted(LastValue), fitted(AlwaysPrior)
    state, _ = last.step(last.init(1), Sample(0.0, READING))
    health = slice(STATES, None)
    np.testing.assert_array_equal(state.mean[:, health], prior.init(1).mean[:, health])
    np.testing.assert_array_equal(state.high[:, health], prior.init(1).high[:, health])
