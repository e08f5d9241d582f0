"""Every metric against its closed form on made-up truth, and what happens where there is no number."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from twinbench.bench.estimates import Estimates
from twinbench.bench.statistics.bootstrap import NOT_EVERYWHERE
from twinbench.bench.statistics.scores import CONSISTENCY, DEFINITIONS, METRICS, ideal, parameter_error_series, score
from twinbench.bench.statistics.tracking import health_change
from twinbench.data.batch import Batch, Truth
from twinbench.machines.compressor import COMPRESSOR, ESTIMATED, HEALTH, SAMPLE_PERIOD_S

N = 12_001  # ten minutes
STRIDE = SAMPLE_TICKS = 20
CHANGE_S = (200.0, 300.0)
RANKED = slice(120 * SAMPLE_TICKS, None, STRIDE)
"""Of ten minutes the first two are commissioning."""
CAPACITY = ESTIMATED.index("capacity")
SPANS = {"capacity": 0.12, "efficiency": 0.10, "leakage": 0.037, "heat_transfer": 0.35, "T_bias_K": 6.0}


def made_up_truth() -> Batch:
    """Two sequences: "ramp" loses a tenth of its capacity from 200 to 300 s, "calm" nothing."""
    time_s = SAMPLE_PERIOD_S * np.arange(N)
    wave = np.sin(2 * np.pi * time_s / 97.0)
    states = np.stack([0.9 + 0.02 * wave, 3.0 + 0.5 * wave, 420 + 10 * wave, 380 + 0 * wave, 1 + 0.1 * wave], axis=-1)
    states = np.stack([states, 1.05 * states])
    health = np.tile(np.array([1.0, 1.0, 0.015, 1.0, 0.0]), (2, N, 1))
    health[0, :, 0] -= 0.1 * np.clip((time_s - CHANGE_S[0]) / (CHANGE_S[1] - CHANGE_S[0]), 0, 1)
    outputs = np.stack([states[..., 1], states[..., 2], 0.12 * states[..., 4]], axis=-1)
    inputs = np.broadcast_to([0.95, 298.0, 1350.0, 0.5], (2, N, 4)).copy()
    measured = np.full((2, N, 7), np.nan)  # no score may look at the measurements
    return Batch(("ramp", "calm"), time_s, measured, Truth(states, health, outputs, inputs))


TRUTH = made_up_truth()


def perfect(truth: Batch = TRUTH) -> Estimates:
    """The truth itself, with intervals of plus and minus two sd of a thousandth of each value and one."""
    assert truth.truth is not None
    ticks, origins = slice(0, None, STRIDE), np.arange(60.0, 600.0, 60.0)
    exact = truth.truth.estimated[:, ticks]
    half = 0.002 * np.abs(exact) + 0.002
    leads = np.array([1.0, 10.0, 60.0])
    rows = np.rint((origins[:, None] + leads) / SAMPLE_PERIOD_S).astype(int)
    at = truth.truth.estimated[:, np.rint(origins / SAMPLE_PERIOD_S).astype(int)]
    shape = exact.shape[:2]
    return Estimates(
        "perfect",
        0,
        truth.names,
        truth.time_s[ticks],
        exact,
        exact - half,
        exact + half,
        np.full(shape, 3.0),
        np.full(shape, 3, dtype=np.int8),
        np.zeros(shape, dtype=np.int16),
        origins,
        leads,
        truth.truth.outputs[:, rows.clip(max=N - 1)],
        at,
        np.broadcast_to(np.eye(10), (*at.shape, 10)).copy(),
        np.ones(10),
    )


def scores(estimates: Estimates, truth: Batch = TRUTH) -> pd.DataFrame:
    """Metrics by sequence, as a square table."""
    return score(estimates, truth).pivot(index="sequence", columns="metric", values="value")


def off_by(name: str, error: float) -> Estimates:
    estimates = perfect()
    mean = estimates.mean.copy()
    mean[..., ESTIMATED.index(name)] += error
    return replace(estimates, mean=mean)


def test_every_metric_is_defined_and_the_binding_names_are_there():
    frame = score(perfect(), TRUTH)
    assert list(frame.columns) == ["sequence", "metric", "value"]
    of_the_change = [f"{kind}_capacity_1_s" for kind in ("delay", "recovery", "watched")]
    assert list(dict.fromkeys(frame["metric"])) == [*METRICS, *of_the_change]
    assert len(frame) == 2 * len(METRICS) + 3
    assert set(DEFINITIONS) - set(METRICS) == {"delay_s", "recovery_s"}
    assert {
        "p_nrmse_pct",
        "T_nrmse_pct",
        "m_nrmse_pct",
        "p_open60_pct",
        "T_open60_pct",
        "m_open60_pct",
        "health_life_pct",
        "parameter_error_pct",
        "coverage95_pct",
        "nis_ratio",
    } <= set(DEFINITIONS)
    assert set(CONSISTENCY) < set(DEFINITIONS)
    assert all(sentence.endswith(".") for sentence in DEFINITIONS.values())


def test_the_truth_itself_scores_zero_and_covers_everything():
    table = scores(perfect())
    errors = [m for m in METRICS if ideal(m) is None and m not in NOT_EVERYWHERE]
    np.testing.assert_allclose(table[errors], 0.0, atol=1e-6)
    assert (table[[m for m in METRICS if "coverage" in m]] == 100.0).all(axis=None)
    assert table.loc["ramp", "delay_capacity_1_s"] == 0.0
    assert table.loc["ramp", "recovery_capacity_1_s"] == 0.0
    assert table.loc["ramp", "watched_capacity_1_s"] == pytest.approx(600.0 - CHANGE_S[1])
    absent = ["health_moving_pct", "health_after_sudden_pct"]
    assert table.loc["calm", [*absent, "delay_capacity_1_s", "watched_capacity_1_s"]].isna().all()
    np.testing.assert_allclose(table.loc["calm", [m for m in NOT_EVERYWHERE if m in METRICS and m not in absent]], 0.0)


@pytest.mark.parametrize(
    ("key", "state", "error", "zero"),
    [("p", "p_exh_bar", 0.03, 0.0), ("T", "T_gas_K", -2.0, 273.15), ("m", "flow_memory", 0.01, 0.0)],
)
def test_state_errors_in_closed_form(key, state, error, zero):
    """A constant error; temperature is normalised in degC: 2 K at 420 K are 1.4 %, not 0.5 %."""
    table = scores(off_by(state, error))
    true = TRUTH.truth.estimated[:, RANKED, ESTIMATED.index(state)] - zero
    for row, values in zip(("ramp", "calm"), true, strict=True):
        assert table.loc[row, f"{key}_nrmse_pct"] == pytest.approx(100 * abs(error) / values.mean())
        assert table.loc[row, f"{key}_mape_pct"] == pytest.approx(100 * np.mean(abs(error) / values))
    others = [f"{k}_nrmse_pct" for k in "pTm" if k != key]
    np.testing.assert_allclose(table[others], 0.0, atol=1e-6)


def test_nrmse_squares_and_mape_does_not():
    estimates = perfect()
    mean = estimates.mean.copy()
    mean[:, ::4, 1] += 0.4  # every fourth tick: RMSE is half of it, mean absolute error a quarter
    table = scores(replace(estimates, mean=mean))
    p = TRUTH.truth.states[0, RANKED, 1]
    share = len(p[::4]) / len(p)
    assert table.loc["ramp", "p_nrmse_pct"] == pytest.approx(100 * 0.4 * np.sqrt(share) / p.mean())
    assert table.loc["ramp", "p_mape_pct"] == pytest.approx(100 * (0.4 / p[::4]).sum() / len(p))


@pytest.mark.parametrize("lead", [1, 10, 60])
def test_open_loop_errors_belong_to_their_lead_and_output(lead):
    estimates = perfect()
    forecast = estimates.forecast.copy()
    forecast[:, :, (1, 10, 60).index(lead)] += [0.05, 1.5, 0.001]
    table = scores(replace(estimates, forecast=forecast))
    base = TRUTH.truth.outputs[0, 120 * SAMPLE_TICKS :].mean(axis=0) - [0, 273.15, 0]
    expected = 100 * np.array([0.05, 1.5, 0.001]) / base
    got = table.loc["ramp", [f"{k}_open{lead}_pct" for k in "pTm"]].astype(float)
    np.testing.assert_allclose(got, expected, rtol=1e-6)
    np.testing.assert_allclose(table[[f"p_open{other}_pct" for other in (1, 10, 60) if other != lead]], 0.0, atol=1e-9)


def test_a_lead_shorter_than_a_tick_is_judged_at_the_next_tick():
    period_s, estimates = 4.0, perfect()
    slow = replace(TRUTH, time_s=period_s * np.arange(N), machine=replace(COMPRESSOR, sample_period_s=period_s))
    origins = np.rint(estimates.forecast_time_s / SAMPLE_PERIOD_S).astype(int)
    rows = origins[:, None] + [1, 2, 15]  # 4, 8 and 60 s
    late = replace(
        estimates,
        time_s=slow.time_s[::STRIDE],
        forecast_time_s=slow.time_s[origins],
        forecast=TRUTH.truth.outputs[:, rows],
    )
    table = score(late, slow)
    kept = table[table["metric"].isin([f"{key}_open{lead}_pct" for key in "pTm" for lead in (1, 10, 60)])]
    assert len(kept) == 18
    np.testing.assert_allclose(kept["value"].astype(float), 0.0, atol=1e-9)


def test_a_forecast_past_the_end_is_not_judged_but_a_missing_one_is():
    estimates = perfect()
    # 60 s after the origin at 600 s nothing is known.
    late = replace(estimates, forecast_time_s=estimates.forecast_time_s + 60.0)
    rows = np.rint((late.forecast_time_s[:, None] + late.leads_s) / SAMPLE_PERIOD_S).astype(int)
    forecast = TRUTH.truth.outputs[:, rows.clip(max=N - 1)].copy()
    forecast[:, rows >= N] = np.nan
    at = TRUTH.truth.estimated[:, np.rint(late.forecast_time_s / SAMPLE_PERIOD_S).astype(int)]
    late = replace(late, forecast=forecast, mean_at_origin=at)
    assert scores(late)["p_open60_pct"].to_numpy() == pytest.approx(0.0)
    last = np.flatnonzero(rows[:, 2] < N)[-1]
    forecast[1, last, 2, 0] += 0.3  # the last that can be judged is
    ranked = (late.forecast_time_s[: last + 1] >= 120.0).sum()
    base = np.sqrt(ranked) * TRUTH.truth.outputs[1, 120 * SAMPLE_TICKS :, 0].mean()
    assert scores(late).loc["calm", "p_open60_pct"] == pytest.approx(30.0 / base)
    forecast[0, 1, 2, 0] = np.nan
    table = scores(replace(late, forecast=forecast))
    assert np.isnan(table.loc["ramp", "p_open60_pct"])
    assert np.isfinite(table.loc["calm", "p_open60_pct"])
    assert np.isfinite(table.loc["ramp", "T_open60_pct"])


@pytest.mark.parametrize("name", HEALTH)
def test_parameter_errors_in_closed_form(name):
    error = 0.1 * SPANS[name]
    table = scores(off_by(name, error)).loc["calm"]
    assert table[f"{name}_range_pct"] == pytest.approx(10.0)
    assert table["parameter_range_pct"] == pytest.approx(2.0)
    assert table[f"{name}_life_pct"] == pytest.approx(10.0)
    for metric in ("health_life_pct", "health_still_pct", "health_commissioning_pct", "health_without_sudden_pct"):
        assert table[metric] == pytest.approx(2.0), metric
    healthy = {"capacity": 1.0, "efficiency": 1.0, "leakage": 0.015, "heat_transfer": 1.0}
    relative = 100 * error / healthy[name] if name in healthy else 0.0
    for metric in (
        "parameter_error_pct",
        "parameter_median_pct",
        "parameter_p90_pct",
        "parameter_terminal_pct",
    ):
        assert table[metric] == pytest.approx(relative / 4, abs=1e-9)
    if name in healthy:
        assert table[f"{name}_error_pct"] == pytest.approx(relative)
    assert table["T_bias_error_K"] == pytest.approx(0.6 if name == "T_bias_K" else 0.0)


def test_median_p90_and_terminal_error_look_at_the_right_samples():
    estimates = perfect()
    mean = estimates.mean.astype(np.float64)
    ticks = mean.shape[1]
    capacity = TRUTH.truth.health[:, ::STRIDE, 0]
    # A relative error that grows linearly from 0 to 40 % once it counts: a quarter of it is the mean of the four.
    grown = np.linspace(0, 1, ticks - 120)
    mean[..., CAPACITY] = capacity * (1 + 0.4 * np.concatenate([np.full(120, 7.0), grown]))
    estimates = replace(estimates, mean=mean)
    table = scores(estimates).loc["ramp"]
    assert table["parameter_error_pct"] == pytest.approx(5.0)
    assert table["parameter_median_pct"] == pytest.approx(5.0)
    assert table["parameter_p90_pct"] == pytest.approx(9.0)
    assert table["parameter_terminal_pct"] == pytest.approx(10 * (1 - 29.5 / 480), rel=1e-3)
    np.testing.assert_allclose(parameter_error_series(estimates, TRUTH)[0], 10 * grown, atol=1e-9)


def late_capacity(delay_s: float) -> Estimates:
    """The capacity that was true ``delay_s`` ago."""
    estimates = perfect()
    mean = estimates.mean.copy()
    ago = np.rint((estimates.time_s - delay_s).clip(0) / SAMPLE_PERIOD_S).astype(int)
    mean[..., CAPACITY] = TRUTH.truth.health[:, ago, 0]
    return replace(estimates, mean=mean)


@settings(max_examples=15, deadline=None)
@given(st.integers(0, 120))
def test_effective_delay_is_found(delay):
    assert score_of(late_capacity(float(delay)), "delay_capacity_1_s") == pytest.approx(delay)


def score_of(estimates: Estimates, metric: str) -> float:
    return float(scores(estimates).loc["ramp", metric])


def test_an_estimate_that_does_not_follow_has_no_delay():
    estimates = perfect()
    for constant in (1.0, 0.95):
        mean = estimates.mean.copy()
        mean[..., CAPACITY] = constant
        assert np.isnan(score_of(replace(estimates, mean=mean), "delay_capacity_1_s"))
    # One that goes the other way does not follow either.
    mean[..., CAPACITY] = 2.0 - TRUTH.truth.health[:, ::STRIDE, 0]
    assert np.isnan(score_of(replace(estimates, mean=mean), "delay_capacity_1_s"))


def test_recovery_is_when_the_error_last_was_a_fifth_of_the_change():
    estimates = perfect()
    since = (estimates.time_s - CHANGE_S[1]).clip(0)
    mean = estimates.mean.astype(np.float64)
    # Error .08 exp(-t/30) of a change of .1: below .02 after 30 ln 4 = 41.6 s, seen at the next tick.
    mean[0, :, CAPACITY] += 0.08 * np.exp(-since / 30.0)
    assert score_of(replace(estimates, mean=mean), "recovery_capacity_1_s") == pytest.approx(42.0, abs=1.0)
    relapse = mean.copy()
    relapse[0, 500, CAPACITY] += 0.05
    assert score_of(replace(estimates, mean=relapse), "recovery_capacity_1_s") == pytest.approx(201.0, abs=1.0)
    relapse[0, -1, CAPACITY] += 0.05
    assert np.isnan(score_of(replace(estimates, mean=relapse), "recovery_capacity_1_s"))


def test_a_step_is_followed_too():
    """A sensor bias comes in one sample; the estimate takes 40 s."""
    health = TRUTH.truth.health.copy()
    health[0, :, 0] = 1.0
    health[0, TRUTH.time_s >= 300.0, 4] = 4.0
    truth = replace(TRUTH, truth=replace(TRUTH.truth, health=health))
    estimates = perfect(truth)
    mean = estimates.mean.copy()
    mean[0, :, 9] = np.where(estimates.time_s >= 340.0, 4.0, 0.0)
    table = scores(replace(estimates, mean=mean), truth).loc["ramp"]
    assert table["delay_T_bias_K_1_s"] == pytest.approx(40.0)
    assert table["recovery_T_bias_K_1_s"] == pytest.approx(40.0)


def test_the_parameter_that_changes_is_the_one_that_moved_most_of_its_range():
    health = np.tile(np.array([1.0, 1.0, 0.015, 1.0, 0.0]), (601, 1))
    health[200:, 0] -= 0.05  # 42 % of its range
    health[300:, 2] += 0.03  # less, but 81 %
    health[100:, 3] += 0.002  # less than 1 %: no change
    change = health_change(COMPRESSOR, np.arange(601.0), health)
    assert HEALTH[change.parameter] == "leakage"
    assert (change.start_s, change.end_s, change.size) == (200.0, 300.0, pytest.approx(0.03))
    assert health_change(COMPRESSOR, np.arange(601.0), np.tile(health[0], (601, 1))) is None


def test_coverage_counts_samples():
    estimates = perfect()
    mean, low, high = estimates.mean, estimates.low.copy(), estimates.high.copy()
    k = ESTIMATED.index("leakage")
    low[:, :150, k], high[:, :150, k] = mean[:, :150, k] + 1.0, mean[:, :150, k] + 2.0  # 30 of them count
    low[:, 150:200, k] = mean[:, 150:200, k]  # the bound itself is inside
    table = scores(replace(estimates, low=low, high=high))
    share = 100 * (1 - 30 / (mean.shape[1] - 120))
    np.testing.assert_allclose(table["coverage_leakage_pct"], share)
    np.testing.assert_allclose(table["coverage95_pct"], (900 + share) / 10)


def test_nis_counts_only_ticks_with_a_measurement():
    estimates = perfect()
    nis, dof = estimates.nis.copy(), estimates.nis_dof.copy()
    nis[:, ::2], dof[:, ::2] = np.nan, 0  # every other tick without any
    nis[:, 1::4], dof[:, 1::4] = 12.0, 2  # 12 is outside the band of 2 degrees of freedom
    ticks2, ticks3 = len(range(121, nis.shape[1], 4)), len(range(123, nis.shape[1], 4))
    table = scores(replace(estimates, nis=nis, nis_dof=dof))
    expected = (12.0 * ticks2 + 3.0 * ticks3) / (2 * ticks2 + 3 * ticks3)
    np.testing.assert_allclose(table["nis_ratio"], expected)
    np.testing.assert_allclose(table["nis_inside_pct"], 100 * ticks3 / (ticks2 + ticks3))
    never = replace(estimates, nis=np.full_like(nis, np.nan), nis_dof=np.zeros_like(dof))
    assert scores(never)[["nis_ratio", "nis_median_ratio", "nis_inside_pct"]].isna().all(axis=None)


def test_nees_needs_no_common_scale_and_no_diagonal_covariance():
    rng = np.random.default_rng(0)
    estimates = perfect()
    units = np.diag(10.0 ** np.linspace(-3, 3, 10))
    mixing = units @ (np.eye(10) + 0.3 * rng.normal(size=(10, 10)))
    error = rng.normal(size=(*estimates.mean_at_origin.shape[:2], 10))
    cov = np.broadcast_to(mixing @ mixing.T, estimates.cov_at_origin.shape).copy()
    shifted = replace(estimates, mean_at_origin=estimates.mean_at_origin + error @ mixing.T, cov_at_origin=cov)
    # error' (M M')^-1 error of M e is |e|^2.
    np.testing.assert_allclose(
        scores(shifted)["nees_ratio"][["ramp", "calm"]], (error[:, 1:] ** 2).sum(-1).mean(1) / 10, rtol=1e-6
    )
    twins = np.eye(10) + np.roll(np.eye(10), 5, axis=0)  # the second five equal the first: singular
    for broken in (np.diag([0.0] + 9 * [1.0]), np.full((10, 10), np.nan), -np.eye(10), twins):
        cov[0, 1] = broken
        table = scores(replace(shifted, cov_at_origin=cov))
        assert np.isnan(table.loc["ramp", "nees_ratio"])
        assert np.isfinite(table.loc["calm", "nees_ratio"])


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_a_diverged_estimate_has_no_score_and_spares_the_others(bad):
    estimates = perfect()
    mean, low, high = estimates.mean.copy(), estimates.low.copy(), estimates.high.copy()
    mean[0, 200, 1] = low[0, 200, 1] = high[0, 200, 1] = bad
    table = scores(replace(estimates, mean=mean, low=low, high=high))
    lost = ["p_nrmse_pct", "p_mape_pct"]
    lost += [f"{kind}{of}" for kind in ("", "calibrated_") for of in ("coverage_p_exh_bar_pct", "coverage95_pct")]
    assert table.loc["ramp", lost].isna().all()
    assert table.loc["calm", lost].notna().all()
    assert table.loc["ramp"].drop([*lost, "health_after_sudden_pct"]).notna().all()


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_an_estimate_that_diverges_altogether_has_no_score_and_no_warning(bad):
    estimates = perfect()
    mean = estimates.mean.copy()
    mean[:, ::3] = bad
    table = scores(replace(estimates, mean=mean))
    errors = [metric for metric in METRICS if ideal(metric) is None and "_open" not in metric]
    assert table[errors].isna().all(axis=None)
    assert table[["delay_capacity_1_s", "recovery_capacity_1_s"]].isna().all(axis=None)
    assert table.loc["ramp", "watched_capacity_1_s"] > 0.0, "that is the recording's, not the estimate's"


def test_sequences_are_matched_by_name_and_ticks_by_time():
    estimates = off_by("p_exh_bar", 0.03)
    turned = replace(
        estimates,
        names=estimates.names[::-1],
        time_s=estimates.time_s[100:],
        **{k: getattr(estimates, k)[::-1, 100:] for k in ("mean", "low", "high", "nis", "nis_dof", "flags")},
        **{k: getattr(estimates, k)[::-1] for k in ("forecast", "mean_at_origin", "cov_at_origin")},
    )
    table = scores(turned)
    p = TRUTH.truth.states[:, RANKED, 1].mean(axis=1)
    assert table.loc["ramp", "p_nrmse_pct"] == pytest.approx(3 / p[0])
    assert table.loc["calm", "p_nrmse_pct"] == pytest.approx(3 / p[1])
    assert table.loc["ramp", "p_open60_pct"] == pytest.approx(0.0)


def test_float32_as_stored_changes_no_score_that_is_printed():
    estimates = off_by("T_gas_K", 1.0)
    stored = {k: getattr(estimates, k).astype(np.float32) for k in ("mean", "low", "high", "nis")}
    pd.testing.assert_frame_equal(scores(replace(estimates, **stored)), scores(estimates), rtol=1e-4, atol=1e-3)


def test_a_recording_too_short_to_forecast_has_the_other_scores():
    estimates = perfect()
    short = replace(
        estimates,
        **{k: getattr(estimates, k)[:, :20] for k in ("mean", "low", "high", "nis", "nis_dof", "flags")},
        **{k: getattr(estimates, k)[:, :0] for k in ("forecast", "mean_at_origin", "cov_at_origin")},
        time_s=estimates.time_s[:20],
        forecast_time_s=estimates.forecast_time_s[:0],
    )
    table = scores(short)
    lost = [f"{key}_open{lead}_pct" for key in "pTm" for lead in (1, 10, 60)] + ["nees_ratio"]
    assert table[lost].isna().all(axis=None)
    sometimes = [m for m in NOT_EVERYWHERE if m in METRICS]
    assert table[list(METRICS)].drop(columns=[*lost, *sometimes]).notna().all(axis=None)


def test_wrong_truth_is_refused():
    with pytest.raises(ValueError, match="carry no truth"):
        score(perfect(), TRUTH.without_truth())
    with pytest.raises(ValueError, match="no truth for sequence 'ramp'; there is of: calm"):
        score(perfect(), TRUTH.select([1]))
    with pytest.raises(ValueError, match="no truth at 300 s"):
        score(perfect(), TRUTH.select([0, 1], slice(0, 5_999)))


def test_estimates_come_back_from_disk_as_they_were(tmp_path):
    estimates = perfect()
    estimates.save(tmp_path / "cell.npz")
    pd.testing.assert_frame_equal(score(Estimates.load(tmp_path / "cell.npz"), TRUTH), score(estimates, TRUTH))
