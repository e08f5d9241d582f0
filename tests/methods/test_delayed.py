"""Fixed-lag smoothing of DeepONet-Kalman: no delay, a delay, the readings that it may see."""

from __future__ import annotations

import numpy as np
import pytest
from helpers.compressor_recordings import small_batch, trained_twin

from twinbench.bench.contract.subject import record
from twinbench.machines.compressor import COMPRESSOR
from twinbench.methods.deeponet_kalman.delayed import LOOKS_BACK
from twinbench.methods.deeponet_kalman.method import DeepONetKalman
from twinbench.methods.estimator import Sample

SAMPLES, DELAY = 400, 80
DELAY_S = DELAY * COMPRESSOR.sample_period_s


@pytest.fixture(scope="module")
def twin() -> DeepONetKalman:
    return trained_twin()


@pytest.fixture(scope="module")
def measured() -> np.ndarray:
    """(2, N, 7) readings of two machines."""
    return small_batch(5, sequences=2, samples=1200).measured[:, :SAMPLES]


def filtered(twin: DeepONetKalman, measured: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Means (N, 2, 10) and variances (N, 2, 10) of the filter at every tick."""
    said = record(twin, measured)
    return said.mean, np.diagonal(said.cov, axis1=2, axis2=3)


def test_without_a_delay_it_is_the_filter(twin, measured):
    ticks = np.arange(0, SAMPLES, 7)
    known = twin.smooth(measured, ticks, 0.0)
    means, _ = filtered(twin, measured)
    np.testing.assert_array_equal(known.mean.reshape(2, len(ticks), -1), means[ticks].swapaxes(0, 1))


def test_readings_after_the_delay_tell_nothing_and_those_within_do(twin, measured):
    tick = 200
    at = np.array([tick])
    known = twin.smooth(measured, at, DELAY_S)
    later, within = measured.copy(), measured.copy()
    later[:, tick + DELAY + 1 :] *= 1.01
    within[:, tick + DELAY - DELAY // LOOKS_BACK] = np.nan
    np.testing.assert_array_equal(twin.smooth(later, at, DELAY_S).mean, known.mean)
    assert (twin.smooth(within, at, DELAY_S).mean != known.mean).any()


def doubted(twin: DeepONetKalman, measured: np.ndarray) -> np.ndarray:
    """(2, N) how likely it is at most, in a tick's delay, that some sensor fails."""
    state, failing = twin.init(2), np.empty((2, SAMPLES))
    for k in range(SAMPLES):
        state, _ = twin.step(state, Sample(k * twin.machine.sample_period_s, measured[:, k]))
        failing[:, k] = (state.memory[0]["modes"]["mu"] @ twin.model.modes.out).max(axis=1)
    return np.stack([failing[:, k : k + DELAY + 1].max(axis=1) for k in range(SAMPLES)], axis=1)


def test_what_is_known_later_is_known_better(twin, measured):
    ticks = np.arange(100, SAMPLES)
    means, variances = filtered(twin, measured)
    sure = doubted(twin, measured)[:, ticks] < 0.01
    assert sure.sum() > 200
    for delay_s in (DELAY_S, np.inf):
        known = twin.smooth(measured, ticks, delay_s)
        own = np.diagonal(known.cov, axis1=1, axis2=2).reshape(2, len(ticks), -1)
        assert (own > 0.0).all()
        share = own / variances[ticks].swapaxes(0, 1)
        # Later readings may also make it doubt a sensor. Variances of health change with the slope of its map, too.
        if delay_s == DELAY_S:
            assert (share[sure][:, :5] < 1.001).all()
        assert (share[..., :5] < 1.001).mean() > 0.95
        assert (np.median(share, axis=(0, 1)) < 1.0).all()
        np.testing.assert_array_equal(known.mean.reshape(2, len(ticks), -1)[:, -1], means[-1])
