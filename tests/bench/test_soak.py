"""The soak, in small: it is sound on a sound twin, and says so where it is not."""

from __future__ import annotations

import numpy as np
import pytest
from helpers.compressor_recordings import small_batch, trained_twin

from twinbench.bench.benchmarks.soak import faulty, run
from twinbench.methods.deeponet_kalman.method import DeepONetKalman


@pytest.fixture(scope="module")
def twin() -> DeepONetKalman:
    """One of our own, as one test breaks it."""
    twin = DeepONetKalman(**DeepONetKalman.contract_settings)
    twin.arrays = dict(trained_twin().arrays)
    twin.restore()
    return twin


def test_a_sound_twin_stays_sound_and_a_broken_one_is_told(twin):
    recordings = small_batch(2).measured
    found = run(twin, recordings, 60_000, seed=1)
    assert found["updates"] == 60_000
    assert found["unsound_updates"] == 0
    assert found["least_eigenvalue_of_correlation"] > 0.0
    twin.twin["filter"]["Q"][0, 3, 3] = -1.0
    assert run(twin, recordings, 1_000, seed=1)["unsound_updates"] > 0


def test_the_faults_are_there(twin):
    clean = np.tile(small_batch(2).measured[0], (4, 1))
    rng, spread = np.random.default_rng(0), np.nanstd(clean, axis=0)
    readings, lag_s = faulty(clean, spread, rng)
    assert (np.isnan(readings) & ~np.isnan(clean)).any(axis=0).sum() >= 3
    assert (np.abs(readings - clean) > 10.0 * spread).any()
    assert (np.diff(readings, axis=0) == 0.0).sum() > (np.diff(clean, axis=0) == 0.0).sum()
    assert lag_s.max() > 0.0
