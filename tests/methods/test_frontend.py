"""The shared front end: spikes out, shifts through, gaps filled, nothing from the future."""

from __future__ import annotations

import numpy as np
import pytest

from twinbench.data.batch import Batch
from twinbench.machines.compressor import SAMPLE_PERIOD_S
from twinbench.methods.frontend import STUCK_S, FrontEnd

LEVEL = np.array([0.95, 298.0, 1350.0, 0.64, 3.1, 430.0, 0.12])
SD = np.array([0.0015, 0.2, 1.5, 0.001, 0.01, 0.7, 0.001])


@pytest.fixture
def measured():
    rng = np.random.default_rng(0)
    return LEVEL + SD * rng.normal(size=(2, 600, 7))


@pytest.fixture
def front_end(measured):
    """Fitted where load moves the readings by far more than their noise."""
    load = np.sin(np.arange(600) / 60.0)[:, None] * 30.0 * SD
    return FrontEnd.fit(Batch(("a", "b"), np.arange(600) * SAMPLE_PERIOD_S, measured + load))


def test_an_isolated_spike_is_replaced_by_the_last_reading(front_end, measured):
    measured[0, 300, 4] += 40 * SD[4]
    filled, accepted, ages = front_end.run(measured)
    assert not accepted[0, 300, 4]
    assert accepted[0, 299, 4]
    assert accepted[0, 301, 4]
    assert filled[0, 300, 4] == measured[0, 299, 4]
    assert ages[0, 300, 4] == pytest.approx(SAMPLE_PERIOD_S)


def test_without_the_precheck_a_spike_gets_through(front_end, measured):
    measured[0, 300, 4] += 40 * SD[4]
    filled, accepted, _ = FrontEnd.from_arrays(front_end.arrays(), threshold=np.inf).run(measured)
    assert accepted[0, 300, 4]
    assert filled[0, 300, 4] == measured[0, 300, 4]


def test_a_lasting_shift_gets_through_after_one_sample(front_end, measured):
    measured[0, 300:, 5] += 40 * SD[5]
    _, accepted, _ = front_end.run(measured)
    assert not accepted[0, 300, 5]
    assert accepted[0, 301:, 5].mean() > 0.99


def test_what_was_held_back_and_is_confirmed_is_put_right_a_tick_later(front_end, measured):
    measured[0, 300:, 0] += 40 * SD[0]
    measured[1, 300, 0] += 40 * SD[0]
    filled, accepted, _ = front_end.run(measured, hindsight=True)
    assert filled[0, 300, 0] == measured[0, 300, 0]
    assert accepted[0, 300, 0]
    assert filled[1, 300, 0] == measured[1, 299, 0]
    assert not accepted[1, 300, 0]
    others = np.arange(600) != 300
    assert np.array_equal(filled[:, others], front_end.run(measured)[0][:, others])


def test_what_no_machine_reads_stays_out_however_long_it_lasts(front_end, measured):
    measured[0, 300:, 5] = -9999.0
    filled, accepted, ages = front_end.run(measured)
    assert not accepted[0, 300:, 5].any()
    assert (filled[0, 300:, 5] == measured[0, 299, 5]).all()
    assert ages[0, -1, 5] == pytest.approx(300 * SAMPLE_PERIOD_S)


def test_an_output_that_repeats_itself_is_missing_until_it_moves_again(front_end, measured):
    stuck = round(STUCK_S / SAMPLE_PERIOD_S)
    measured[0, 300:500, 5] = measured[0, 299, 5]
    _, accepted, ages = front_end.run(measured)
    assert accepted[0, 300 : 299 + stuck, 5].all()
    assert not accepted[0, 299 + stuck : 500, 5].any()
    assert ages[0, 499, 5] == pytest.approx((201 - stuck) * SAMPLE_PERIOD_S)
    assert accepted[0, 501:, 5].all()


def test_an_input_may_be_constant_and_an_output_where_it_was_in_training(front_end, measured):
    measured[0, 300:500, 2] = measured[0, 299, 2]
    assert front_end.run(measured)[1][0, 300:500, 2].all()
    coarse = measured.copy()
    coarse[:, 100:200, 5] = LEVEL[5]
    fitted = FrontEnd.fit(Batch(("a", "b"), np.arange(600) * SAMPLE_PERIOD_S, coarse))
    assert fitted.run(coarse)[1][:, 100:200, 5].mean() > 0.99


def test_plain_noise_is_hardly_ever_rejected(front_end, measured):
    _, accepted, _ = front_end.run(measured)
    assert accepted.mean() > 0.999


def test_missing_holds_the_last_value_and_ages(front_end, measured):
    measured[1, 100:140, 6] = np.nan
    filled, accepted, ages = front_end.run(measured)
    assert not accepted[1, 100:140, 6].any()
    assert (filled[1, 100:140, 6] == measured[1, 99, 6]).all()
    assert ages[1, 139, 6] == pytest.approx(40 * SAMPLE_PERIOD_S)
    assert np.isfinite(filled).all()


def test_before_the_first_reading_the_training_mean_stands_in(front_end, measured):
    measured[0, :10, 4] = np.nan
    filled, _, ages = front_end.run(measured)
    assert (filled[0, :10, 4] == front_end.mean[4]).all()
    assert np.isinf(ages[0, :10, 4]).all()


def test_steps_equal_the_whole_run_and_leave_the_memory_alone(front_end, measured):
    measured[0, 50, 2] = np.nan
    measured[1, 60, 3] += 1.0
    measured[1, 70:, 5] += 40 * SD[5]
    filled, accepted, ages = front_end.run(measured)
    hindsight = front_end.run(measured, hindsight=True)[0]
    assert not np.array_equal(hindsight, filled)
    memory = front_end.init(2)
    for k in range(200):
        before = [part.copy() for part in memory]
        after, clean = front_end.step(memory, measured[:, k])
        assert all(np.array_equal(a, b, equal_nan=True) for a, b in zip(before, memory, strict=True))
        assert np.array_equal(clean.filled, filled[:, k])
        assert np.array_equal(clean.accepted, accepted[:, k])
        assert np.array_equal(clean.age_s, ages[:, k])
        assert k == 0 or np.array_equal(clean.before, hindsight[:, k - 1])
        memory = after


def test_arrays_round_trip(front_end, measured):
    again = FrontEnd.from_arrays(front_end.arrays())
    assert np.array_equal(again.run(measured)[0], front_end.run(measured)[0])
