"""DeepONet-Kalman on machines that are no compressor: other sizes, other paces, no lag, one reading."""

from __future__ import annotations

import functools

import numpy as np
import onnxruntime
import pytest
from helpers.lone_tank import LONE_TANK

from twinbench.common.errors import BadInput
from twinbench.data.benchmark import DesignConfig, Split, simulate_benchmark
from twinbench.machines.machine import Machine
from twinbench.machines.motor import MOTOR
from twinbench.machines.two_tanks import TWO_TANKS
from twinbench.methods.deeponet_kalman.export import INPUTS, filter_arrays, operator_graph
from twinbench.methods.deeponet_kalman.method import DeepONetKalman
from twinbench.methods.deeponet_kalman.online import Online
from twinbench.methods.deeponet_kalman.plain import PlainTwin
from twinbench.methods.estimator import Sample, State

MACHINES = pytest.mark.parametrize(
    "machine", [*(pytest.param(m, marks=pytest.mark.slow) for m in (TWO_TANKS, MOTOR)), LONE_TANK], ids=lambda m: m.name
)
TICKS = 100


@functools.cache
def population(machine: Machine) -> Split:
    return simulate_benchmark(
        DesignConfig(n_train=2, n_validation=1, n_calibration=1, n_test=2, n_single=0, minutes=5.0, warmup_minutes=1.0),
        machine=machine,
    )


@functools.cache
def trained(machine: Machine) -> DeepONetKalman:
    twin, split = DeepONetKalman(machine, **DeepONetKalman.contract_settings), population(machine)
    twin.fit(split.train, split.validation, 0)
    return twin


def rows(machine: Machine) -> np.ndarray:
    """Readings (N, C) with single ones missing, the last output gone for a while, and one that steps for good."""
    readings = population(machine).test.measured[0].copy()
    readings[np.random.default_rng(0).random(readings.shape) < 0.02] = np.nan
    readings[40:60, -1] = np.nan
    readings[75:, len(machine.inputs)] += 25.0 * machine.noise[len(machine.inputs)].white
    return readings


def after(twin: DeepONetKalman, readings: np.ndarray) -> State:
    state = twin.init(1)
    for k, row in enumerate(readings):
        state, _ = twin.step(state, Sample(k * twin.machine.sample_period_s, row[None]))
    return state


@MACHINES
def test_what_is_saved_goes_on_as_it_was_and_foretells_readings(machine, tmp_path):
    twin, readings = trained(machine), rows(machine)
    state = after(twin, readings[:TICKS])
    n, ny, nu = len(machine.quantities), len(machine.outputs), len(machine.inputs)
    assert state.mean.shape == state.low.shape == state.high.shape == (1, n)
    assert state.cov.shape == (1, n, n)
    assert (state.low <= state.mean).all()
    assert (state.mean <= state.high).all()
    ahead = twin.forecast(state, np.nan_to_num(population(machine).test.measured[:1, TICKS : TICKS + 20, :nu]))
    assert ahead.shape == (1, 20, ny)
    assert np.isfinite(ahead).all()
    twin.save(tmp_path / "twin.npz")
    again = after(DeepONetKalman.load(tmp_path / "twin.npz", machine), readings[:TICKS])
    assert np.array_equal(again.mean, state.mean)
    assert np.array_equal(again.cov, state.cov)


@MACHINES
def test_the_compiled_form_equals_the_plain_one(machine):
    twin, readings = trained(machine), rows(machine)
    online, plain = Online(twin), PlainTwin(twin)
    late = np.random.default_rng(1).uniform(0.0, 1.2, readings.shape) * machine.sample_period_s
    likeliest = set()
    for k, row in enumerate(readings[:TICKS]):
        lag_s = late[k] if k < TICKS // 2 else np.zeros_like(late[k])
        online.update(row, lag_s)
        state, info = plain.update(Sample(k * machine.sample_period_s, row[None], lag_s[None]))
        sd, where = np.sqrt(np.diagonal(state.cov[0])), f"at tick {k}"
        likeliest.add(int(plain.mu.argmax()))
        assert (np.abs(online.state.mean - state.mean) / sd).max() < 1e-3, where
        assert np.abs((online.state.cov[0] - state.cov[0]) / np.outer(sd, sd)).max() < 1e-3, where
        np.testing.assert_allclose(online.info.nis, info.nis, rtol=1e-2, atol=1e-3, err_msg=where)
        assert online.info.flags[0] == info.flags[0], where
        np.testing.assert_array_equal(online.info.accepted, info.accepted, err_msg=where)
    assert len(likeliest) > 1 or len(machine.outputs) == 1


@MACHINES
def test_the_graph_is_the_compiled_operator(machine):
    twin, parts = trained(machine), trained(machine).parts
    session = onnxruntime.InferenceSession(operator_graph(twin))
    plain, readings = PlainTwin(twin), population(machine).test.measured[0]
    window, rng = twin.config["window"], np.random.default_rng(2)
    whole = np.ones(parts.channels)
    carried = [np.tile(readings[0], (window, 1)), np.ones((window, parts.channels)), np.zeros(len(plain_slow(machine)))]
    for k in range(70):
        plain.ticks += 1
        plain.take_in(readings[k].astype(np.float32).astype(float), whole)
        x = twin.model.state_mean + twin.model.state_scale * rng.normal(size=parts.states)
        zeta = rng.normal(size=parts.health)
        plain.z[: parts.states], plain.z[plain.health] = x, zeta
        feed = dict(zip(INPUTS, map(np.float32, (readings[k], whole, x, zeta, *carried)), strict=True))
        increment, jacobian, *carried = session.run(None, feed)
    scaled, slope = plain.increments()
    np.testing.assert_allclose(increment / twin.model.increment, scaled, rtol=0.0, atol=1e-4)
    units = twin.model.increment[:, None] / np.r_[twin.model.state_scale, np.full(len(twin.model.acting), 4.0)]
    acting = np.r_[np.arange(parts.states), parts.states + twin.model.acting]
    np.testing.assert_allclose(jacobian[:, acting] / units, slope, rtol=0.0, atol=1e-4)
    assert not np.delete(jacobian, acting, axis=1).any()


def plain_slow(machine: Machine) -> np.ndarray:
    """Of each slow channel and running mean, where the channel stands."""
    return np.repeat(range(len(machine.inputs), len(machine.channels)), 2)


def test_a_filter_that_the_exported_arrays_cannot_say_is_refused_in_a_line():
    with pytest.raises(BadInput, match="two_tanks has 0 and 0") as told:
        filter_arrays(trained(TWO_TANKS))
    assert "\n" not in str(told.value)
