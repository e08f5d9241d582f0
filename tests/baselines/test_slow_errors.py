"""The slow part of a model's error: nothing for the plant itself, what was put in for a machine that errs."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from twinbench.baselines.slow_errors import error_keep, slow_error_sd
from twinbench.bench.contract.subject import small_benchmark
from twinbench.machines.compressor import COMPRESSOR
from twinbench.physics.compressor import PLANT
from twinbench.physics.integrate import Varying, advance

HEALTH, SAMPLE_PERIOD_S, STATES = COMPRESSOR.health_names, COMPRESSOR.sample_period_s, len(COMPRESSOR.estimated)
PER_TICK = np.array([1e-4, 2e-3, 0.05, 0.01, 1e-3])


@pytest.fixture(scope="module")
def recording():
    return small_benchmark().validation.select(slice(0, 1), slice(0, 2401))


def errs_by(recording, error):
    """The recording with states that the plant moves by, and an error (N, 5) in each tick besides."""
    truth = recording.truth
    states = truth.states.copy()
    for k in range(states.shape[1] - 1):
        health = Varying(HEALTH, truth.health[:, k])
        states[:, k + 1] = advance(PLANT, states[:, k], truth.inputs[:, k], SAMPLE_PERIOD_S, 2, health)
        states[:, k + 1, :STATES] += error[k]
    return replace(recording, truth=replace(truth, states=states))


def test_the_exact_model_has_none(recording):
    assert (slow_error_sd(PLANT, recording, 2) < 1e-9 * PER_TICK).all()


def test_a_lasting_error_is_found_and_a_quick_one_averages_out(recording):
    samples = recording.truth.states.shape[1]
    lasting = errs_by(recording, np.tile(PER_TICK, (samples, 1)))
    np.testing.assert_allclose(slow_error_sd(PLANT, lasting, 2), PER_TICK, rtol=1e-6)
    quick = errs_by(recording, PER_TICK * np.random.default_rng(0).normal(size=(samples, STATES)))
    assert (slow_error_sd(PLANT, quick, 2) < 0.3 * PER_TICK).all()


def test_slow_errors_stay_for_minutes():
    assert 0.9 < error_keep(COMPRESSOR) ** (60.0 / SAMPLE_PERIOD_S) < 1.0
