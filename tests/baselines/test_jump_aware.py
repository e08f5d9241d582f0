"""What the oracle makes of a step: a leap of health is found at once, a failed sensor is left out."""

from __future__ import annotations

import numpy as np
import pytest

from twinbench.baselines.oracle import Oracle
from twinbench.baselines.oracle_smoother import OracleSmoother
from twinbench.bench.contract.subject import record, small_benchmark
from twinbench.data.corrupt import Corruption, corrupt
from twinbench.machines.compressor import COMPRESSOR
from twinbench.methods.estimator import FLAG_GATED
from twinbench.physics.compressor import PLANT
from twinbench.physics.integrate import Varying, simulate

CHANNELS, HEALTH = COMPRESSOR.channels, COMPRESSOR.health_names
LEAPS_AT = 1600
FIRST = slice(0, 1)


@pytest.fixture(scope="module")
def oracle():
    estimator = OracleSmoother()
    estimator.fit(small_benchmark().train, small_benchmark().validation, 0)
    return estimator


def machine(parameter="", size=0.0):
    """Readings (1, 2400, 7) and health of the first test machine, one parameter of which leaps by ``size``."""
    truth = small_benchmark().test.truth
    health = np.tile(truth.health[FIRST, :1], (1, 2400, 1))
    if parameter:
        health[:, LEAPS_AT:, HEALTH.index(parameter)] += size
    u = truth.inputs[FIRST]
    u, health = u[:, : health.shape[1]], health[:, : u.shape[1]]
    _, y = simulate(PLANT, u, truth.states[0, 0], varying=Varying(HEALTH, health))
    return corrupt(COMPRESSOR, u[0], y[0], Corruption(), np.random.default_rng(3))[None], health


@pytest.mark.parametrize(("parameter", "size", "off"), [("capacity", -0.06, 0.02), ("T_bias_K", 4.0, 1.5)])
def test_a_leap_is_followed_within_seconds(oracle, parameter, size, off):
    readings, _ = machine(parameter, size)
    said = record(oracle, readings)
    at = 5 + HEALTH.index(parameter)
    before, after = (said.mean[k, 0, at] for k in (LEAPS_AT - 1, LEAPS_AT + 400))
    assert after - before == pytest.approx(size, abs=off)
    assert not (said.flags & FLAG_GATED).any(), "no sensor was to blame"


def test_without_leaps_it_lags(oracle):
    readings, health = machine("capacity", -0.06)
    still = Oracle(leap=1e-6)
    still.arrays = oracle.arrays
    still.restore()
    late = slice(LEAPS_AT + 200, None)
    wrong = [np.abs(record(e, readings).mean[late, 0, 5] - health[0, late, 0]).mean() for e in (oracle, still)]
    assert wrong[0] < 0.7 * wrong[1]


@pytest.mark.parametrize("channel", ["p_dis_bar", "m_flow_kg_s"])
def test_a_sensor_that_fails_is_left_out_until_it_fits_again(oracle, channel):
    readings, _ = machine()
    c = CHANNELS.index(channel)
    faulty = readings.copy()
    rng = np.random.default_rng(5)
    fault = slice(LEAPS_AT - 600, LEAPS_AT - 100)
    faulty[:, fault, c] *= 1.0 + 0.2 * rng.normal(size=500)  # noise that no data sheet has
    said, sane = record(oracle, faulty), record(oracle, readings)
    out = ~said.accepted[:, 0, c - 4]
    assert out[LEAPS_AT - 350 : LEAPS_AT - 120].mean() > 0.95
    assert (said.flags[LEAPS_AT - 350 : LEAPS_AT - 120] & FLAG_GATED).any()
    assert out[LEAPS_AT + 100 :].mean() < 0.1
    typical = np.array([v.scale for v in PLANT.parameters[:5]])
    gap = np.abs(said.mean[-200:, 0, 5:] - sane.mean[-200:, 0, 5:]) / typical
    assert gap.mean() < 1.0


def test_hindsight_knows_when_health_leapt(oracle):
    readings, health = machine("capacity", -0.06)
    ticks = np.arange(readings.shape[1])
    known = oracle.smooth(readings, ticks)
    said = record(oracle, readings)
    near = slice(LEAPS_AT - 400, LEAPS_AT + 400)
    # The course of capacity; its level takes longer than two minutes to tell from leakage, either way.
    wrong = [(mean[near] - health[0, near, 0]).std() for mean in (known.mean[:, 5], said.mean[:, 0, 5])]
    assert wrong[0] < 0.7 * wrong[1]
    course = known.mean[near, 5]
    half = np.argmax(course < 0.5 * (course[0] + course[-1]))
    assert abs(half - 400) * COMPRESSOR.sample_period_s < 3.0
    variance = np.diagonal(known.cov, axis1=1, axis2=2)
    assert (variance > 0.0).all()
    assert np.median(variance[:, 5:] / np.diagonal(said.cov[:, 0], axis1=1, axis2=2)[:, 5:]) < 1.0


def test_the_oracle_has_no_delay(oracle):
    with pytest.raises(ValueError, match="looks at the whole recording, not 60 s ahead"):
        oracle.smooth(machine()[0], np.array([0]), 60.0)


def test_at_the_end_hindsight_is_the_filter(oracle):
    readings, _ = machine()
    last = np.array([readings.shape[1] - 1])
    known, said = oracle.smooth(readings, last), record(oracle, readings)
    spread = np.sqrt(np.diagonal(known.cov[0]))
    np.testing.assert_allclose(known.mean[0] / spread, said.mean[-1, 0] / spread, atol=0.2)
