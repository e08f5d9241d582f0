"""The peers: one problem, whoever reckons it."""

from __future__ import annotations

import numpy as np
import pytest

from twinbench.bench.latency.compiled_peers import CompiledPeer, ekf, ukf
from twinbench.bench.latency.peers import FilterpyEKF, FilterpyUKF, Model, model_of
from twinbench.data.benchmark import DesignConfig, simulate_benchmark
from twinbench.data.corrupt import Corruption
from twinbench.machines.compressor import COMPRESSOR
from twinbench.machines.motor import MOTOR
from twinbench.machines.two_tanks import TWO_TANKS

MACHINES = (COMPRESSOR, *(pytest.param(m, marks=pytest.mark.slow) for m in (TWO_TANKS, MOTOR)))


@pytest.fixture(scope="module", params=MACHINES, ids=lambda machine: machine.name)
def recorded(request):
    """A machine's model, readings (N, nu + ny) and true states (N, n) of a recording without gaps."""
    machine = request.param
    minutes = 2.0 * machine.sample_period_s / 0.05
    design = DesignConfig(
        seed=3, n_train=1, n_validation=1, n_calibration=1, n_test=1, n_single=0, minutes=minutes, warmup_minutes=0.5
    )
    test = simulate_benchmark(design, Corruption(dropout=0.0, spikes=0.0), machine).test
    return model_of(machine), test.measured[0], test.truth.states[0, :, : len(machine.estimated)]


def test_the_model_is_the_same_in_numpy_and_compiled(recorded: tuple[Model, np.ndarray, np.ndarray]) -> None:
    rng = np.random.default_rng(0)
    model, readings, states = recorded
    nu, nh = len(model.machine.inputs), len(model.machine.health)
    for k in range(0, 1700, 400):
        z, u = np.concatenate([states[k], 0.3 * rng.normal(size=nh)]), readings[k, :nu]
        for written, compiled in zip(model.written, model.numba, strict=True):
            np.testing.assert_allclose(compiled(z, u), written(z, u), rtol=1e-12)


@pytest.mark.parametrize(("filterpys", "kind"), [(FilterpyEKF, ekf), (FilterpyUKF, ukf)])
def test_all_forms_of_a_filter_are_one_filter_and_it_follows_the_machine(recorded, filterpys, kind):
    model, readings, states = recorded
    slow, fast = (filterpys(readings[0], model, functions) for functions in (model.written, model.numba))
    compiled = CompiledPeer(readings[0], model, kind)
    for row in readings[1:1200]:
        for peer in (slow, fast, compiled):
            peer.update(row)
    sd = np.sqrt(np.diag(slow.cov))
    for peer in (fast, compiled):
        assert np.abs((peer.mean - slow.mean) / sd).max() < 1e-6
        assert np.abs((peer.cov - slow.cov) / np.outer(sd, sd)).max() < 1e-6
    n = len(model.machine.estimated)
    sound = [r.state for r in model.machine.readings if not r.bias and r.state in model.machine.estimated]
    read = [model.machine.estimated.index(state) for state in sound]
    assert compiled.mean[read] == pytest.approx(states[1199, read], rel=0.02)
    assert np.isfinite(model.machine.coordinates.to_theta(compiled.mean[n:])).all()
