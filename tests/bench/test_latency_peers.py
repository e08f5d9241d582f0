"""The peers: one problem, whoever reckons it."""

from __future__ import annotations

import numpy as np
import pytest

from twinbench.bench.latency.compiled_peers import CompiledPeer, ekf, ukf
from twinbench.bench.latency.peers import (
    N_STATES,
    FilterpyEKF,
    FilterpyUKF,
    numba_move,
    numba_observe,
    numpy_move,
    numpy_observe,
)
from twinbench.data.benchmark import DesignConfig, simulate_benchmark
from twinbench.data.corrupt import Corruption
from twinbench.physics.health import to_theta


@pytest.fixture(scope="module")
def machine():
    """Readings (N, 7) and the true states (N, 5) of a recording without gaps."""
    design = DesignConfig(
        seed=3, n_train=1, n_validation=1, n_calibration=1, n_test=1, n_single=0, minutes=2.0, warmup_minutes=0.5
    )
    test = simulate_benchmark(design, Corruption(dropout=0.0, spikes=0.0)).test
    return test.measured[0], test.truth.states[0, :, :N_STATES]


def test_the_model_is_the_same_in_numpy_and_compiled(machine):
    rng = np.random.default_rng(0)
    readings, states = machine
    for k in range(0, 2000, 400):
        z = np.concatenate([states[k], 0.3 * rng.normal(size=5)])
        np.testing.assert_allclose(numba_move(z, readings[k, :4]), numpy_move(z, readings[k, :4]), rtol=1e-12)
        np.testing.assert_allclose(numba_observe(z, readings[k, :4]), numpy_observe(z, readings[k, :4]), rtol=1e-12)


@pytest.mark.parametrize(("filterpys", "tick"), [(FilterpyEKF, ekf), (FilterpyUKF, ukf)])
def test_all_forms_of_a_filter_are_one_filter_and_it_follows_the_machine(machine, filterpys, tick):
    readings, states = machine
    slow, fast = (filterpys(readings[0], *model) for model in MODELS)
    compiled = CompiledPeer(readings[0], tick)
    for row in readings[1:1200]:
        for peer in (slow, fast, compiled):
            peer.update(row)
    sd = np.sqrt(np.diag(slow.cov))
    for peer in (fast, compiled):
        assert np.abs((peer.mean - slow.mean) / sd).max() < 1e-6
        assert np.abs((peer.cov - slow.cov) / np.outer(sd, sd)).max() < 1e-6
    assert compiled.mean[1] == pytest.approx(states[1199, 1], rel=0.01)
    assert compiled.mean[2] == pytest.approx(states[1199, 2], rel=0.03)
    assert np.isfinite(to_theta(compiled.mean[N_STATES:])).all()


MODELS = ((numpy_move, numpy_observe), (numba_move, numba_observe))
