"""Running an estimator over recordings: what is kept, when it forecasts, and that it never sees the truth."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from twinbench.bench.evaluate import fill_gaps, run
from twinbench.bench.profile import Evaluation
from twinbench.data.batch import Batch, Truth
from twinbench.machines.compressor import CHANNELS, COMPRESSOR, SAMPLE_PERIOD_S
from twinbench.methods.estimator import Estimator, gaussian_state, no_info

TICKS = 401
EVALUATION = Evaluation(stride=3, origin_every_s=5.0, leads_s=(0.5, 2.0))


class Clock(Estimator):
    """Tells the time: every estimate is the time stamp, every forecast the inputs it was given."""

    name = "clock"
    nan_after_s = np.inf

    def fit(self, train, validation, seed):
        raise NotImplementedError

    def init(self, batch):
        return gaussian_state(np.ones((batch, 10)), np.eye(10))

    def step(self, state, sample):
        now = np.full_like(state.mean, sample.time_s if sample.time_s <= self.nan_after_s else np.nan)
        return state._replace(mean=now, low=now - 1.0, high=now + 1.0), no_info(len(now))

    def forecast(self, state, inputs):
        return inputs[..., :3]


def recordings(sequences: int = 2) -> Batch:
    time_s = np.arange(TICKS) * SAMPLE_PERIOD_S
    measured = np.broadcast_to(time_s[:, None], (sequences, TICKS, len(CHANNELS))).copy()
    return Batch(tuple(f"r{b}" for b in range(sequences)), time_s, measured)


def test_every_third_tick_is_kept() -> None:
    estimates = run(Clock(), recordings(), EVALUATION, seed=3)
    np.testing.assert_allclose(estimates.time_s, np.arange(0, TICKS, 3) * SAMPLE_PERIOD_S)
    np.testing.assert_allclose(estimates.mean[1, :, 4], estimates.time_s, rtol=1e-6)
    np.testing.assert_allclose(estimates.high - estimates.low, 2.0, rtol=1e-5)
    assert (estimates.estimator, estimates.seed, estimates.names) == ("clock", 3, ("r0", "r1"))


def test_forecasts_start_one_spacing_apart_and_see_the_inputs_of_their_leads() -> None:
    estimates = run(Clock(), recordings(), EVALUATION, seed=0)
    # 20 s: origins at 4.95, 9.95 and 14.95 s; from 19.95 s the 2 s lead would reach past the end.
    np.testing.assert_allclose(estimates.forecast_time_s, [4.95, 9.95, 14.95])
    np.testing.assert_allclose(estimates.mean_at_origin[0, :, 0], estimates.forecast_time_s)
    expected = estimates.forecast_time_s[:, None] + [0.5, 2.0]
    np.testing.assert_allclose(estimates.forecast[1, :, :, 0], expected)


def test_a_recording_shorter_than_the_lead_has_no_forecast() -> None:
    estimates = run(Clock(), recordings(), replace(EVALUATION, leads_s=(60.0,)), seed=0)
    assert estimates.forecast.shape == (2, 0, 1, 3)
    assert estimates.cov_at_origin.shape == (2, 0, 10, 10)


def test_a_lead_shorter_than_a_tick_is_one_tick() -> None:
    slow, many = replace(COMPRESSOR, sample_period_s=4.0), recordings()
    batch = replace(many, time_s=4.0 * np.arange(TICKS), measured=80.0 * many.measured, machine=slow)
    estimates = run(Clock(), batch, Evaluation(stride=3, origin_every_s=200.0, leads_s=(1.0, 10.0, 60.0)), seed=0)
    expected = estimates.forecast_time_s[:, None] + [4.0, 8.0, 60.0]
    np.testing.assert_allclose(estimates.forecast[1, :, :, 0], expected)
    alone = run(Clock(), batch, Evaluation(stride=3, origin_every_s=1e9, leads_s=(1.0,)), seed=0)
    assert alone.forecast.shape == (2, 0, 1, 3)


def test_truth_is_refused() -> None:
    batch = recordings()
    nothing = np.zeros((2, TICKS, 5))
    with pytest.raises(ValueError, match="without truth"):
        run(Clock(), replace(batch, truth=Truth(nothing, nothing, nothing, nothing)), EVALUATION, seed=0)


@pytest.mark.parametrize("origin_every_s", [5.0, 1000.0])
def test_an_estimate_that_is_no_number_is_an_error_that_says_when(origin_every_s: float) -> None:
    broken = Clock()
    broken.nan_after_s = 12.0
    with pytest.raises(FloatingPointError, match=r"clock: the estimate or its interval is not finite at 12\.15 s"):
        run(broken, recordings(), replace(EVALUATION, origin_every_s=origin_every_s), seed=0)


GAPPY = arrays(float, (2, 9, 2), elements=st.one_of(st.just(np.nan), st.floats(-1e6, 1e6)))


@given(GAPPY)
def test_fill_gaps_holds_the_last_value_and_invents_none(values: np.ndarray) -> None:
    before = values.copy()
    filled = fill_gaps(values)
    np.testing.assert_array_equal(values, before)
    for b, c in np.ndindex(2, 2):
        given_values = values[b, :, c]
        known = np.flatnonzero(~np.isnan(given_values))
        for k in range(9):
            earlier = known[known <= k]
            source = earlier[-1] if len(earlier) else known[0] if len(known) else k
            np.testing.assert_equal(filled[b, k, c], given_values[source])
