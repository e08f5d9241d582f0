"""The row that never looks: the filters' prior, whatever is measured."""

from __future__ import annotations

import numpy as np
import pytest

from twinbench.baselines.always_prior import AlwaysPrior
from twinbench.baselines.oracle import Oracle
from twinbench.bench.contract.subject import ground_of, record, small_benchmark
from twinbench.machines.compressor import COMPRESSOR

STATES = len(COMPRESSOR.estimated)


@pytest.fixture(scope="module")
def fitted():
    split = small_benchmark()
    estimators = AlwaysPrior(), Oracle()
    for estimator in estimators:
        estimator.fit(split.train, split.validation, 0)
    return estimators


def test_it_says_what_the_filters_say_before_they_look(fitted):
    prior, oracle = (estimator.init(2) for estimator in fitted)
    health = slice(STATES, None)
    for part in ("mean", "low", "high"):
        np.testing.assert_allclose(getattr(prior, part)[:, health], getattr(oracle, part)[:, health], rtol=1e-12)
    np.testing.assert_allclose(
        prior.mean[:, health], np.tile(COMPRESSOR.coordinates.to_theta(COMPRESSOR.prior[0]), (2, 1)), rtol=1e-12
    )
    # The filter takes every fiftieth state, this one all.
    spread = np.sqrt(np.diagonal(oracle.cov[0]))[:STATES]
    assert (np.abs(prior.mean - oracle.mean)[:, :STATES] < 0.1 * spread).all()


def test_it_says_so_whatever_is_measured(fitted):
    prior, _ = fitted
    calm, absurd = (
        record(prior, ground_of(COMPRESSOR).recordings[name][:, :200]) for name in ("undisturbed", "absurd")
    )
    np.testing.assert_array_equal(calm.mean, absurd.mean)
    assert np.ptp(calm.mean, axis=0).max() == 0.0
    assert np.isnan(calm.nis).all()


def test_it_forecasts_the_mean_of_training_whatever_the_inputs(fitted):
    prior, _ = fitted
    truth = small_benchmark().train.truth
    assert truth is not None
    said = prior.forecast(prior.init(2), np.zeros((2, 30, 4)))
    np.testing.assert_allclose(said, np.tile(truth.outputs.mean(axis=(0, 1)), (2, 30, 1)))
