"""Honesty of intervals: where the answer is known, an exact Kalman filter on a linear-Gaussian toy."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats

from twinbench.bench.estimates import Estimates
from twinbench.bench.statistics.bootstrap import means, sequence_scores
from twinbench.bench.statistics.coverage import (
    coverage_by_regime,
    coverage_table,
    expected_band,
)
from twinbench.bench.statistics.regimes import AFTER_HEALTH_S, AFTER_LOAD_S, REGIMES, regimes
from twinbench.bench.statistics.scores import score
from twinbench.data.batch import Batch, Truth
from twinbench.machines.compressor import COMPRESSOR, ESTIMATED

RUNS, TICKS = 400, 30
SURE = 0.999
"""Level of the bands that the toy must keep to: a right filter fails once in a thousand."""


@cache
def toy() -> tuple[Batch, Estimates]:
    """400 runs of a ten-state linear system with three sensors, and its exact textbook Kalman filter.

    x' = F x + w, y = H x + v; the first state is drawn from the filter's prior, so that the filter's
    posterior is the true one: NIS is chi-square(3) and white, NEES chi-square(10), coverage 95 %.
    """
    rng = np.random.default_rng(7)
    rotation = np.linalg.qr(rng.normal(size=(10, 10)))[0]
    F = rotation @ np.diag(np.linspace(0.5, 0.98, 10)) @ rotation.T
    H = rng.normal(size=(3, 10))
    Q = 0.1 * np.cov(rng.normal(size=(10, 40)))
    R = np.diag([0.5, 1.0, 2.0])
    offset = 20.0  # away from zero, where relative errors mean nothing
    P = np.eye(10)
    x = rng.normal(size=(RUNS, 10))
    m = np.zeros((RUNS, 10))
    truth, mean, half, nis, covs = [], [], [], [], []
    for k in range(TICKS):
        if k:
            x = x @ F.T + rng.multivariate_normal(np.zeros(10), Q, size=RUNS)
            m, P = m @ F.T, F @ P @ F.T + Q
        y = x @ H.T + rng.multivariate_normal(np.zeros(3), R, size=RUNS)
        S = H @ P @ H.T + R
        K = P @ H.T @ np.linalg.inv(S)
        v = y - m @ H.T
        m, P = m + v @ K.T, (np.eye(10) - K @ H) @ P
        truth.append(x + offset)
        mean.append(m + offset)
        half.append(np.tile(1.96 * np.sqrt(np.diag(P)), (RUNS, 1)))
        nis.append(np.einsum("bi,ij,bj->b", v, np.linalg.inv(S), v))
        covs.append(np.tile(P, (RUNS, 1, 1)))
    X, M, half_, N = (np.stack(values, axis=1) for values in (truth, mean, half, nis))
    names = tuple(f"run-{b:03d}" for b in range(RUNS))
    time_s = np.arange(float(TICKS))
    inputs = np.ones((RUNS, TICKS, 4)) * np.array([1.0, 298.0, 1350.0, 0.5])
    batch = Batch(names, time_s, np.zeros((RUNS, TICKS, 7)), Truth(X[..., :5], X[..., 5:], X[..., :3], inputs))
    origins = [9, 29]
    exact = Estimates(
        "exact",
        0,
        names,
        time_s,
        M,
        M - half_,
        M + half_,
        N,
        np.full(N.shape, 3, dtype=np.int8),
        np.zeros(N.shape, dtype=np.int16),
        time_s[origins],
        np.array([1.0]),
        np.zeros((RUNS, 2, 1, 3)),
        M[:, origins],
        np.stack([covs[k] for k in origins], axis=1),
        np.full(10, np.nan),
    )
    return batch, exact


def overconfident(estimates: Estimates, factor: float = 0.7) -> Estimates:
    """The same estimates, sure of themselves: every sd times ``factor``."""
    return replace(
        estimates,
        estimator="overconfident",
        low=estimates.mean - factor * (estimates.mean - estimates.low),
        high=estimates.mean + factor * (estimates.high - estimates.mean),
        nis=estimates.nis / factor**2,
        cov_at_origin=estimates.cov_at_origin * factor**2,
    )


def last_tick(estimates: Estimates) -> Estimates:
    """One tick a run: as many independent trials as there are runs."""
    cut = {k: getattr(estimates, k)[:, -1:] for k in ("mean", "low", "high", "nis", "nis_dof", "flags")}
    at = {k: getattr(estimates, k)[:, -1:] for k in ("forecast", "mean_at_origin", "cov_at_origin")}
    return replace(estimates, time_s=estimates.time_s[-1:], forecast_time_s=estimates.time_s[-1:], **cut, **at)


def chi2_band(dof: int, n: int) -> tuple[float, float]:
    """Bounds of the mean over n independent values of chi-square(dof) / dof, which are surely kept.

    Bar-Shalom, Li and Kirubarajan (2001), Estimation with Applications to Tracking and Navigation, 5.4.
    """
    low, high = stats.chi2.interval(SURE, dof * n)
    return low / (dof * n), high / (dof * n)


def mean_score(estimates: Estimates, metric: str) -> float:
    frame = score(estimates, toy()[0])
    return float(frame.loc[frame["metric"] == metric, "value"].mean())


def test_nis_of_the_exact_filter_is_in_its_band_and_of_the_overconfident_is_not():
    exact = toy()[1]
    low, high = chi2_band(3, RUNS * TICKS)
    assert 0.97 < low < mean_score(exact, "nis_ratio") < high < 1.03
    assert mean_score(overconfident(exact), "nis_ratio") > high
    assert mean_score(overconfident(exact, 1.3), "nis_ratio") < low


def test_nis_of_the_exact_filter_lies_inside_95_per_cent_of_the_time():
    exact = toy()[1]
    low, high = np.array(stats.binom.interval(SURE, RUNS * TICKS, 0.95)) / (RUNS * TICKS) * 100
    assert low < mean_score(exact, "nis_inside_pct") < high
    assert mean_score(overconfident(exact), "nis_inside_pct") < low
    assert mean_score(exact, "nis_median_ratio") == pytest.approx(1.0, abs=0.05)


def test_nees_of_the_exact_filter_is_in_its_band_and_of_the_overconfident_is_not():
    exact = last_tick(toy()[1])
    low, high = chi2_band(10, RUNS)
    assert low < mean_score(exact, "nees_ratio") < high
    assert mean_score(overconfident(exact), "nees_ratio") == pytest.approx(mean_score(exact, "nees_ratio") / 0.7**2)
    assert mean_score(overconfident(exact), "nees_ratio") > high


@pytest.mark.parametrize("quantity", ESTIMATED)
def test_the_exact_filter_covers_95_per_cent_of_independent_trials(quantity):
    exact = last_tick(toy()[1])
    low, high = np.array(stats.binom.interval(SURE, RUNS, 0.95)) / RUNS * 100
    assert low <= mean_score(exact, f"coverage_{quantity}_pct") <= high
    # 0.7 of 1.96 sd hold 83 %.
    assert mean_score(overconfident(exact), f"coverage_{quantity}_pct") < low


def test_nis_can_look_right_while_the_state_is_overconfident():
    """NIS sees the innovations alone: a covariance that shrinks after each update passes it."""
    lying = replace(toy()[1], cov_at_origin=0.25 * toy()[1].cov_at_origin)
    low, high = chi2_band(3, RUNS * TICKS)
    assert low < mean_score(lying, "nis_ratio") < high
    assert mean_score(lying, "nees_ratio") > 3.5


def cell_rows(estimates: Estimates, runs: int) -> pd.DataFrame:
    """Coverage of the first runs, as a runner would store it."""
    few = {k: getattr(estimates, k)[:runs] for k in ("mean", "low", "high")}
    rows = coverage_by_regime(replace(estimates, names=estimates.names[:runs], **few), toy()[0])
    return rows.assign(estimator=estimates.estimator, seed=estimates.seed)


def test_table_of_ten_runs_tells_the_exact_from_the_overconfident():
    exact = toy()[1]
    table = coverage_table(pd.concat([cell_rows(exact, 10), cell_rows(overconfident(exact, 0.5), 10)]))
    everywhere = table[(table["regime"] == "all") & (table["quantity"] == "mean")].set_index("estimator")
    assert everywhere.loc["exact", "low"] < 95 < everywhere.loc["exact", "high"]
    assert everywhere.loc["overconfident", "high"] < everywhere.loc["overconfident", "expected_low"] < 95
    assert (table["expected_pct"] == 95).all()
    assert (table["low"] <= table["coverage_pct"]).all()
    assert (table["coverage_pct"] <= table["high"]).all()


def test_table_agrees_with_the_scores():
    """Where every sequence weighs the same, the table holds the means of the scores with their intervals."""
    batch, exact = toy()
    table = coverage_table(cell_rows(exact, 20)).query("regime == 'all'").set_index("quantity")
    long = score(exact, batch).assign(estimator="exact", seed=0)
    long = long[long["sequence"].isin(exact.names[:20])]
    metrics = {quantity: f"coverage_{quantity}_pct" for quantity in ESTIMATED} | {"mean": "coverage95_pct"}
    for quantity, metric in metrics.items():
        row = means(sequence_scores(long, metric)).iloc[0]
        np.testing.assert_allclose(
            table.loc[quantity, ["coverage_pct", "low", "high"]].astype(float),
            row[["mean", "low", "high"]].astype(float),
        )


def rows_of(values: list[tuple[str, int, str, float, int]]) -> pd.DataFrame:
    """Rows of regime "all", the same share for all quantities."""
    return pd.DataFrame(
        [(e, seed, s, "all", q, share, share - 1.0, ticks) for e, seed, s, share, ticks in values for q in ESTIMATED],
        columns=["estimator", "seed", "sequence", "regime", "quantity", "inside_pct", "calibrated_pct", "ticks"],
    )


def test_table_averages_seeds_and_weighs_sequences_by_their_samples():
    rows = rows_of(
        [
            ("a", 0, "s0", 80.0, 100),
            ("a", 1, "s0", 100.0, 100),
            ("a", 0, "s1", 60.0, 300),
            ("a", 1, "s1", 60.0, 300),
        ]
    )
    table = coverage_table(rows)
    np.testing.assert_allclose(table["coverage_pct"], (90 * 100 + 60 * 300) / 400)
    np.testing.assert_allclose(table["calibrated_pct"], table["coverage_pct"] - 1.0)
    assert (table["n_sequences"] == 2).all()
    assert len(table) == 11
    assert table["quantity"].iloc[-1] == "mean"


def test_interval_of_the_table_weighs_sequences_by_their_samples_too():
    """Nine sequences hardly enter the regime: most resamples hold the tenth, and then it decides alone."""
    rows = rows_of([("a", 0, f"s{i}", 0.0, 1) for i in range(9)] + [("a", 0, "s9", 100.0, 10_000)])
    table = coverage_table(rows)
    assert (table["high"] > 99.9).all()
    assert (table["low"] == 0.0).all()


def test_table_never_hides_a_failure():
    rows = rows_of(
        [
            ("a", 0, "s0", np.nan, 100),
            ("a", 0, "s1", 90.0, 100),
            ("b", 0, "s0", 95.0, 100),
            ("b", 0, "s1", 95.0, 100),
        ]
    )
    table = coverage_table(rows, failed={"c": "diverged", "b": "seed 1: out of memory"})
    a, b, c = (table[table["estimator"] == name] for name in "abc")
    assert a["coverage_pct"].isna().all()
    assert (a["reason"] == "no finite interval in s0").all()
    assert (b["coverage_pct"] == 95.0).all()
    assert (b["reason"] == "seed 1: out of memory").all()
    assert len(c) == 1
    assert np.isnan(c["coverage_pct"].iloc[0])
    assert c["reason"].iloc[0] == "diverged"


def test_one_quantity_without_an_interval_in_one_seed_is_no_mean_either():
    rows = rows_of([("a", seed, s, 90.0, 100) for seed in (0, 1) for s in ("s0", "s1")])
    rows.loc[0, "inside_pct"] = np.nan  # p_int_bar, seed 0, s0
    table = coverage_table(rows).set_index("quantity")
    assert table.index[table["coverage_pct"].isna()].tolist() == ["p_int_bar", "mean"]
    assert table.loc["mean", "reason"] == "no finite interval in s0"


@pytest.mark.parametrize("n", [5, 10, 200])
def test_expected_band_holds_95_per_cent_of_exact_filters(n):
    low, high = expected_band(n)
    covered = stats.binom.cdf(round(high * n / 100), n, 0.95) - stats.binom.cdf(round(low * n / 100) - 1, n, 0.95)
    assert covered >= 0.95
    # Any narrower and it would not.
    inner = stats.binom.cdf(round(high * n / 100) - 1, n, 0.95) - stats.binom.cdf(round(low * n / 100), n, 0.95)
    assert inner < 0.95


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_regimes_divide_the_samples(seed):
    rng = np.random.default_rng(seed)
    shape = (3, 60)
    inputs = rng.uniform(0.8, 1.1, size=(*shape, 4)) * [1.0, 298.0, 1350.0, 0.5]
    truth = Truth(np.zeros((*shape, 5)), np.zeros((*shape, 5)), rng.uniform(2, 5, size=(*shape, 3)), inputs)
    masks = regimes(
        COMPRESSOR, np.arange(0.0, 600.0, 10.0), truth, [[(100.0, 200.0)], [(300.0, 300.0), (310.0, 320.0)], []]
    )
    assert list(masks) == list(REGIMES)
    for parts in (("speed_low", "speed_middle", "speed_high"), ("ratio_low", "ratio_middle", "ratio_high")):
        counts = [masks[part].sum() for part in parts]
        assert max(counts) - min(counts) <= 1
        assert sum(counts) == 180
    lately = np.stack([masks[name] for name in ("after_health", "after_load", "steady_before", "steady_after")])
    assert (lately.sum(axis=0) == 1).all()
    assert masks["speed_low"].sum()
    assert inputs[masks["speed_low"]][:, 2].max() <= inputs[masks["speed_high"]][:, 2].min()


def test_regimes_follow_the_changes_of_health_and_load():
    inputs = np.ones((2, 60, 4))
    inputs[1, 20:, 3] = 0.7  # the valve moves at 200 s
    truth = Truth(np.ones((2, 60, 5)), np.ones((2, 60, 5)), np.ones((2, 60, 3)), inputs)
    time_s = np.arange(0.0, 600.0, 10.0)
    masks = regimes(COMPRESSOR, time_s, truth, [[(100.0, 200.0), (400.0, 400.0)], [(230.0, 230.0)]])
    fresh = [(100.0, 200.0 + AFTER_HEALTH_S), (400.0, 400.0 + AFTER_HEALTH_S)]
    expected = sum((start <= time_s) & (time_s < end) for start, end in fresh).astype(bool)
    np.testing.assert_array_equal(masks["after_health"][0], expected)
    np.testing.assert_array_equal(time_s[masks["steady_before"][0]], np.arange(0.0, 100.0, 10.0))
    assert not masks["after_load"][0].any()
    np.testing.assert_array_equal(time_s[masks["after_load"][1]], np.arange(200.0, 230.0, 10.0))
    assert AFTER_LOAD_S > 30.0, "from 230 s on health comes first"
    np.testing.assert_array_equal(time_s[masks["steady_after"][1]], np.arange(230.0 + AFTER_HEALTH_S, 600.0, 10.0))


def test_rows_say_how_many_samples_a_regime_has_and_skip_empty_ones():
    time_s = np.arange(300.0)
    health = np.tile([1.0, 1.0, 0.015, 1.0, 0.0], (2, 300, 1))
    health[0, 100:, 4] = 3.0
    states = np.ones((2, 300, 5))
    inputs = np.ones((2, 300, 4))
    inputs[0, :, 2] = np.linspace(900, 1400, 300)
    inputs[1, :, 2] = np.linspace(1400, 1800, 300)
    batch = Batch(("step", "calm"), time_s, np.zeros((2, 300, 7)), Truth(states, health, np.ones((2, 300, 3)), inputs))
    exact = batch.truth.estimated
    low = exact - 1.0
    low[0, 100:110, 9] = 3.5  # the step is missed for ten samples
    _, e = toy()
    estimates = replace(e, names=batch.names, time_s=time_s, mean=exact, low=low, high=exact + 1.0)
    rows = coverage_by_regime(estimates, batch).set_index(["sequence", "regime", "quantity"])
    assert rows.loc[("step", "after_health", "T_bias_K"), "ticks"] == AFTER_HEALTH_S
    assert rows.loc[("step", "after_health", "T_bias_K"), "inside_pct"] == pytest.approx(100 * 110 / 120)
    assert rows.loc[("step", "after_load", "T_bias_K"), "inside_pct"] == 100.0
    commissioned = 60  # seconds, a fifth of the recording, which are not ranked
    assert rows.loc[("step", "after_load", "T_bias_K"), "ticks"] == 300 - AFTER_HEALTH_S - commissioned
    present = {(s, r) for s, r, _ in rows.index}
    assert ("calm", "after_load") in present
    assert ("calm", "after_health") not in present
    assert ("calm", "speed_low") not in present
    assert ("step", "speed_low") in present
    # The bias alone is missed.
    assert rows.loc[("step", "after_health", "capacity"), "inside_pct"] == 100.0
