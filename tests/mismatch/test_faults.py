"""Sensor and input faults: none when absent, and what they say against a direct calculation."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from motor import MOTOR
from scipy.integrate import solve_ivp
from two_tanks import TANKS

from twinbench.mismatch.faults import faults
from twinbench.mismatch.reversal import Turned
from twinbench.mismatch.series import held
from twinbench.physics.compressor import PLANT

RNG = np.random.default_rng(3)
TIME_S = np.cumsum(RNG.uniform(0.02, 0.3, 400))
VALUES = 120.0 + np.cumsum(RNG.normal(size=400))
BY_NAME = {m.name: m for m in faults(MOTOR, 0.1)}
NAMES = ("bias", "gain", "lag", "delay", "drift", "saturation", "quantisation", "stuck")


def apply(name, theta, values=VALUES, time_s=TIME_S):
    return BY_NAME[name].series(time_s, values, np.atleast_1d(np.asarray(theta, dtype=float)))


def own(mechanism, size=None):
    theta = np.array([v.nominal for v in mechanism.parameters])
    theta[0] = theta[0] if size is None else size
    return theta


def test_every_channel_has_every_fault():
    names = {m.name for m in faults(TANKS, 1.0)}
    assert names == {f"sensor_{n}@{c}" for n in NAMES for c in ("level1_cm", "level2_cm")} | {
        f"input_{n}@pump_V" for n in (*NAMES, "saturation_both")
    }
    for m in faults(PLANT):
        assert m.kind == ("sensor" if m.port.place == "output" else "input")
        assert m.port.variable in m.says
    parameters = [v.name for m in faults(PLANT) for v in m.parameters]
    assert len(set(parameters)) == len(parameters)


@pytest.mark.parametrize("mechanism", BY_NAME.values(), ids=BY_NAME)
def test_absent_is_identity_and_typical_is_not(mechanism):
    v = next(v for v in MOTOR.outputs + MOTOR.inputs if mechanism.port.variable == v.name)
    values = v.nominal + v.scale * (VALUES - VALUES.mean()) / VALUES.std()
    assert np.array_equal(mechanism.series(TIME_S, values, own(mechanism, 0.0)), values)
    wrong = mechanism.series(TIME_S, values, own(mechanism))
    assert wrong.shape == values.shape
    assert np.isfinite(wrong).all()
    assert not np.allclose(wrong, values, rtol=1e-9)


@pytest.mark.parametrize("mechanism", BY_NAME.values(), ids=BY_NAME)
def test_gaps_are_held_over_and_nothing_given_is_changed(mechanism):
    values = VALUES.copy()
    values[[0, 1, 50, 51, 399]] = np.nan
    filled = values.copy()
    filled[[0, 1]], filled[[50, 51]], filled[399] = values[2], values[49], values[398]
    before = values.copy()
    theta = own(mechanism)
    assert np.array_equal(mechanism.series(TIME_S, values, theta), mechanism.series(TIME_S, filled, theta))
    assert np.array_equal(values, before, equal_nan=True)


def test_bias_gain_drift_saturation_quantisation():
    assert apply("sensor_bias@speed_rad_s", 3.0) == pytest.approx(VALUES + 3.0)
    assert apply("sensor_gain@speed_rad_s", 0.1) == pytest.approx(1.1 * VALUES)
    assert apply("input_drift@load_Nm", 0.01) == pytest.approx(VALUES + 0.01 * (TIME_S - TIME_S[0]))
    assert apply("sensor_saturation@amps_A", [1.0, 121.0]) == pytest.approx(np.minimum(VALUES, 121.0))
    half = apply("sensor_saturation@amps_A", [0.5, 121.0])
    assert half == pytest.approx((VALUES + np.minimum(VALUES, 121.0)) / 2)
    steps = apply("sensor_quantisation@amps_A", 0.25)
    assert np.array_equal(steps * 4, np.round(steps * 4))
    assert np.abs(steps - VALUES).max() <= 0.125 + 1e-12


def test_stuck_stands_still_over_the_end_of_the_record():
    out = apply("input_stuck@voltage_V", 0.25)
    since_s = TIME_S[-1] - 0.25 * (TIME_S[-1] - TIME_S[0])
    assert np.array_equal(out[since_s >= TIME_S], VALUES[since_s >= TIME_S])
    assert np.ptp(out[since_s < TIME_S]) == 0.0
    assert np.ptp(apply("input_stuck@voltage_V", 1.0)) == 0.0


def test_a_slow_sensor_solves_its_differential_equation():
    tau_s = 0.7
    truth = solve_ivp(
        lambda t, y: (np.interp(t, TIME_S, VALUES) - y) / tau_s,
        (TIME_S[0], TIME_S[-1]),
        VALUES[:1],
        t_eval=TIME_S,
        rtol=1e-9,
        atol=1e-9,
        max_step=0.02,
    ).y[0]
    assert apply("sensor_lag@speed_rad_s", tau_s) == pytest.approx(truth, abs=2e-4)


def steps_on(fine_s):
    """The recorded steps at fine times."""
    return VALUES[np.searchsorted(TIME_S, fine_s, side="right") - 1]


def over_samples(fine_s, fine):
    """Means of a fine signal over each sample but the last."""
    area = np.concatenate(([0.0], np.cumsum(0.5 * (fine[1:] + fine[:-1]) * np.diff(fine_s))))
    return np.diff(np.interp(TIME_S, fine_s, area)) / np.diff(TIME_S)


def test_a_slow_or_late_actuator_gives_the_mean_of_what_passes_in_each_step():
    fine_s = np.arange(TIME_S[0], TIME_S[-1] + 1e-3, 5e-4)
    lagged, y = np.empty(len(fine_s)), VALUES[0]
    for k, value in enumerate(steps_on(fine_s)):
        lagged[k] = y
        y += (1.0 - np.exp(-5e-4 / 0.4)) * (value - y)
    assert apply("input_lag@voltage_V", 0.4)[:-1] == pytest.approx(over_samples(fine_s, lagged), abs=0.02)
    late = steps_on(np.maximum(fine_s - 0.37, TIME_S[0]))
    assert apply("input_delay@voltage_V", 0.37)[:-1] == pytest.approx(over_samples(fine_s, late), abs=0.05)


def test_a_delay_of_whole_samples_shifts():
    even_s = 0.1 * np.arange(400)
    for name in ("sensor_delay@amps_A", "input_delay@load_Nm"):
        out = apply(name, 0.3, time_s=even_s)
        assert out[3:] == pytest.approx(VALUES[:-3], abs=1e-6)
        assert out[:3] == pytest.approx(np.full(3, VALUES[0]), abs=1e-6)


@settings(max_examples=50, deadline=None)
@given(
    st.sampled_from(
        ["sensor_lag@amps_A", "sensor_delay@amps_A", "input_lag@load_Nm", "input_delay@load_Nm", "input_stuck@load_Nm"]
    ),
    st.floats(0.0, 1.0).map(lambda size: round(size, 9)),
    st.lists(st.tuples(st.floats(1e-3, 10.0), st.floats(-1e3, 1e3)), min_size=1, max_size=30),
)
def test_what_is_slow_late_or_stuck_stays_within_what_was_there(name, size, samples):
    gaps, values = (np.array(column) for column in zip(*samples, strict=True))
    out = apply(name, size, values, np.cumsum(gaps))
    slack = 1e-6 * (1.0 + np.abs(values).max())
    assert (out >= values.min() - slack).all()
    assert (out <= values.max() + slack).all()
    assert apply(name, size, np.full(len(values), 5.0), np.cumsum(gaps)) == pytest.approx(np.full(len(values), 5.0))


@settings(max_examples=30, deadline=None)
@given(st.sampled_from(["sensor_lag@amps_A", "sensor_delay@amps_A", "input_lag@load_Nm", "input_delay@load_Nm"]))
def test_a_vanishing_lag_or_delay_is_none(name):
    assert apply(name, 1e-6) == pytest.approx(VALUES, abs=1e-3)


def test_a_channel_never_read_stays_empty():
    assert np.isnan(held(np.full(4, np.nan))).all()


def test_an_input_saturates_on_both_sides():
    values = np.array([-250.0, -100.0, 0.0, 100.0, np.nan, 250.0])
    both = apply("input_saturation_both@voltage_V", [1.0, 150.0], values, np.arange(6.0))
    assert both == pytest.approx([-150.0, -100.0, 0.0, 100.0, 100.0, 150.0])
    leaky = apply("input_saturation_both@voltage_V", [0.8, 150.0], values, np.arange(6.0))
    assert leaky == pytest.approx([-170.0, -100.0, 0.0, 100.0, 100.0, 170.0])


def test_a_channel_that_is_not_symmetrical_saturates_at_two_limits():
    both = apply("input_saturation_both@load_Nm", [1.0, 10.0, 40.0], np.array([-5.0, 10.0, 30.0, 60.0]), np.arange(4.0))
    assert both == pytest.approx([10.0, 10.0, 30.0, 40.0])
    names = [v.name for v in BY_NAME["input_saturation_both@load_Nm"].parameters[1:]]
    assert names == ["saturation_both_lower_limit_load_Nm", "saturation_both_limit_load_Nm"]


def test_an_input_that_never_went_back_is_not_said_to_saturate_on_both_sides():
    names = {m.name for m in faults(MOTOR, 0.1, Turned(reversed=frozenset({"load_Nm"})))}
    assert "input_saturation_both@load_Nm" in names
    assert "input_saturation_both@voltage_V" not in names
    assert "input_saturation@voltage_V" in names
