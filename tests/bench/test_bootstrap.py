"""Means, paired differences and multiples of the floor over sequences."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy import stats

from twinbench.bench.statistics.bootstrap import (
    RESAMPLES,
    SequenceScores,
    differences,
    interval,
    means,
    ratios,
    resample_weights,
    sequence_scores,
)

SCORES = arrays(float, 8, elements=st.floats(0.1, 100.0).map(lambda v: round(v, 3)))


def long_table(values: dict[str, np.ndarray], metric: str = "error_pct") -> pd.DataFrame:
    """Scores by estimator, each (seeds, sequences), in the layout of scores.csv."""
    return pd.DataFrame(
        [
            (name, seed, f"test-{s:02d}", metric, value)
            for name, table in values.items()
            for seed, row in enumerate(np.atleast_2d(table))
            for s, value in enumerate(row)
        ],
        columns=["estimator", "seed", "sequence", "metric", "value"],
    )


def table(values: dict[str, np.ndarray]) -> SequenceScores:
    return sequence_scores(long_table(values), "error_pct")


def test_seeds_are_averaged_inside_the_sequence():
    scores = table({"a": np.array([[1.0, 10.0], [3.0, 30.0]]), "oracle": np.array([[1.0, 2.0]])})
    assert scores.estimators == ("oracle", "a")
    np.testing.assert_allclose(scores.values, [[1.0, 2.0], [2.0, 20.0]])
    assert scores.reasons == {}


def test_more_seeds_do_not_narrow_the_interval():
    one = np.random.default_rng(0).gamma(4.0, size=(1, 10))
    frame = means(table({"one": one, "three": np.repeat(one, 3, axis=0)})).set_index("estimator")
    np.testing.assert_allclose(
        frame.loc["one", ["mean", "low", "high"]].astype(float),
        frame.loc["three", ["mean", "low", "high"]].astype(float),
    )


@pytest.mark.parametrize("n", [4, 10, 25])
def test_interval_is_scipys_percentile_bootstrap_at_the_expanded_level(n):
    values = np.random.default_rng(n).gamma(2.0, size=n)
    tail = stats.norm.cdf(-np.sqrt(n / (n - 1)) * stats.t.ppf(0.975, n - 1))
    oracle = stats.bootstrap(
        (values,), np.mean, confidence_level=1 - 2 * tail, n_resamples=40_000, method="percentile", rng=1
    ).confidence_interval
    row = means(table({"a": values})).iloc[0]
    spread = values.std() / np.sqrt(n)
    assert row["mean"] == pytest.approx(values.mean())
    assert row["low"] == pytest.approx(oracle.low, abs=0.15 * spread)
    assert row["high"] == pytest.approx(oracle.high, abs=0.15 * spread)


def test_ten_sequences_are_covered_at_95_per_cent():
    """Monte Carlo on data whose mean is known; plain percentiles would cover 90 %."""
    n, repeats = 10, 1_500
    data = np.random.default_rng(3).normal(size=(repeats, n))
    bounds = np.array([interval(resample_weights(n) @ values, n) for values in data])
    covered = ((bounds[:, 0] <= 0) & (bounds[:, 1] >= 0)).mean()
    low, high = stats.binom.ppf([0.001, 0.999], repeats, 0.95) / repeats
    assert low <= covered <= high


def test_every_resample_draws_as_many_sequences_as_there_are_and_none_is_preferred():
    weights = resample_weights(10)
    assert weights.shape == (RESAMPLES, 10)
    np.testing.assert_allclose(weights.sum(axis=1), 1.0)
    np.testing.assert_allclose(weights.mean(axis=0), 0.1, atol=0.004)
    assert resample_weights(10) is weights


@settings(max_examples=25, deadline=None)
@given(values=SCORES, shift=st.floats(-50, 50).map(lambda v: round(v, 3)))
def test_a_common_shift_moves_means_and_leaves_differences(values, shift):
    other = values[::-1] * 1.5
    before, after = table({"a": values, "b": other}), table({"a": values + shift, "b": other + shift})
    columns = ["mean", "low", "high"]
    np.testing.assert_allclose(means(after)[columns], means(before)[columns] + shift, atol=1e-9)
    columns = ["difference", "low", "high"]
    np.testing.assert_allclose(differences(after, "b")[columns], differences(before, "b")[columns], atol=1e-9)


@settings(max_examples=25, deadline=None)
@given(values=SCORES, gap=st.floats(0.1, 10.0), factor=st.floats(1.1, 9.0))
def test_sequences_are_shared_so_a_constant_gap_or_factor_has_no_spread(values, gap, factor):
    """Resampled apart, their intervals would be as wide as the sequences differ."""
    paired = differences(table({"a": values + gap, "b": values}), "b").iloc[0]
    np.testing.assert_allclose([paired["difference"], paired["low"], paired["high"]], gap)
    above = ratios(table({"a": values * factor, "oracle": values})).iloc[0]
    np.testing.assert_allclose([above["ratio"], above["low"], above["high"]], factor)


def test_order_of_the_rows_does_not_matter():
    frame = long_table({"a": np.random.default_rng(1).gamma(2.0, size=(3, 6)), "oracle": np.ones((1, 6))})
    shuffled = frame.sample(frac=1.0, random_state=4)
    pd.testing.assert_frame_equal(
        means(sequence_scores(frame, "error_pct")), means(sequence_scores(shuffled, "error_pct"))
    )


def test_times_above_the_floor_is_the_ratio_of_the_means():
    frame = ratios(table({"a": np.array([1.0, 9.0, 2.0]), "oracle": np.array([1.0, 2.0, 1.0])}))
    assert list(frame["estimator"]) == ["a"]
    assert frame["ratio"][0] == pytest.approx(3.0)
    assert 1.0 <= frame["low"][0] < 3.0 < frame["high"][0] <= 4.5


def test_a_floor_of_zero_gives_infinity_not_a_warning():
    frame = ratios(table({"a": np.array([1.0, 2.0, 3.0]), "oracle": np.zeros(3)}))
    assert np.isinf(frame["ratio"][0])


def test_one_sequence_has_a_mean_but_no_interval():
    row = means(table({"a": np.array([2.0])})).iloc[0]
    assert row["mean"] == 2.0
    assert np.isnan(row["low"])
    assert np.isnan(row["high"])


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_a_failed_score_keeps_its_estimator_with_the_reason(bad):
    scores = table({"a": np.array([[1.0, 2.0, bad], [1.0, 4.0, bad]]), "oracle": np.array([[1.0, 1.0, 4.0]])})
    assert scores.reasons == {"a": "no score in 2 of 6 (seed 0, 1; test-02)"}
    frame = means(scores).set_index("estimator")
    assert frame.loc["a", "mean"] == pytest.approx(2.0)
    assert frame.loc["a", "n_sequences"] == 2
    assert frame.loc["a", "reason"] == scores.reasons["a"]
    # Only what both have is compared: 2.0 over 1.0, without the floor's third sequence.
    assert ratios(scores)["ratio"][0] == pytest.approx(2.0)
    # What the reference lacks is everybody's matter.
    assert differences(scores, "a")["reason"][0] == f"a: {scores.reasons['a']}"


def test_one_failed_seed_is_told():
    scores = table({"a": np.array([[1.0, 2.0], [3.0, np.nan]])})
    np.testing.assert_allclose(scores.values, [[2.0, 2.0]])
    assert "seed 1; test-01" in scores.reasons["a"]


def test_an_estimator_without_a_single_score_still_appears():
    good = long_table({"oracle": np.ones(3)})
    scores = sequence_scores(good, "error_pct", failed={"gru_kf": "fit ran out of memory"})
    row = means(scores).set_index("estimator").loc["gru_kf"]
    assert np.isnan(row["mean"])
    assert row["n_sequences"] == 0
    assert row["reason"] == "fit ran out of memory"


def test_an_estimator_with_scores_of_other_metrics_only_still_appears():
    both = pd.concat([long_table({"oracle": np.ones(3)}), long_table({"a": np.ones(3)}, metric="other")])
    assert "a" in sequence_scores(both, "error_pct").reasons


def test_a_delay_where_nothing_changes_is_undefined_not_failed():
    values = {"a": np.array([5.0, np.nan, 7.0]), "b": np.array([6.0, np.nan, np.nan])}
    scores = sequence_scores(long_table(values, "delay_s"), "delay_s")
    assert scores.undefined == ("test-01",)
    assert scores.sequences == ("test-00", "test-02")
    assert list(scores.reasons) == ["b"]
    # Of a metric that is always defined, a sequence that nobody got through is a failure of all.
    assert set(table(values).reasons) == {"a", "b"}


def test_no_change_anywhere_leaves_no_sequence_and_no_crash():
    nothing = sequence_scores(long_table({"a": np.full(3, np.nan)}, "delay_s"), "delay_s")
    assert nothing.sequences == ()
    assert np.isnan(means(nothing)["mean"][0])


def test_unknown_metric_estimator_and_double_rows_are_refused():
    frame = long_table({"a": np.ones(2)})
    with pytest.raises(ValueError, match="no scores of 'speed'; there are: error_pct"):
        sequence_scores(frame, "speed")
    with pytest.raises(ValueError, match="two scores of error_pct for estimator a, seed 0, sequence test-00"):
        sequence_scores(pd.concat([frame, frame]), "error_pct")
    with pytest.raises(ValueError, match="'oracle' has no error_pct; these have: a"):
        ratios(table({"a": np.ones(2)}))
