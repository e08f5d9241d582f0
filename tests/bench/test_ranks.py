"""Ranks and what follows from them, against independent implementations."""

from __future__ import annotations

import gc
from itertools import pairwise

import numpy as np
import pandas as pd
import pytest
import scikit_posthocs
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy import stats
from statsmodels.stats.multitest import multipletests
from statsmodels.stats.power import TTestPower

from twinbench.bench.statistics.bootstrap import SequenceScores, sequence_scores
from twinbench.bench.statistics.ranks import (
    cliques,
    critical_difference,
    friedman,
    holm,
    rank,
    rank_biserial,
    sequences_needed,
    smallest_gap,
    smallest_p,
    wilcoxon_p,
)


@pytest.fixture(scope="module", autouse=True)
def _little_to_collect() -> None:
    """statsmodels collects garbage at every call, a second each where earlier tests have left much in memory."""
    gc.collect()
    gc.freeze()


def table(values: np.ndarray, metric: str = "p_nrmse_pct", names: tuple[str, ...] = ()) -> SequenceScores:
    names = names or tuple("abcdefgh"[: len(values)])
    sequences = tuple(f"s{i}" for i in range(values.shape[1]))
    return SequenceScores(metric, names, sequences, values, {}, ())


def gamma(k: int, n: int, seed: int) -> np.ndarray:
    """Scores of k estimators on n sequences: harder sequences are harder for all, later ones are worse."""
    rng = np.random.default_rng(seed)
    return rng.gamma(3.0, size=(1, n)) * rng.gamma(6.0, size=(k, n)) * np.linspace(1, 2, k)[:, None]


@pytest.mark.parametrize(("k", "n", "seed"), [(3, 6, 0), (7, 10, 1), (6, 25, 2)])
def test_friedman_is_scipys_and_nemenyi_is_scikit_posthocs(k, n, seed):
    values = gamma(k, n, seed)
    ranking = rank(table(values))
    oracle = stats.friedmanchisquare(*values)
    assert ranking.friedman_statistic == pytest.approx(oracle.statistic)
    assert ranking.friedman_p == pytest.approx(oracle.pvalue)
    expected = scikit_posthocs.posthoc_nemenyi_friedman(pd.DataFrame(values.T, columns=list("abcdefgh"[:k])))
    for pair in ranking.pairs.itertuples():
        assert pair.nemenyi_p == pytest.approx(expected.loc[pair.first, pair.second], abs=1e-6)
        # The critical difference cuts where the p-value does.
        assert (pair.rank_gap > ranking.critical_difference) == (pair.nemenyi_p < 0.05)


def test_friedman_with_ties_is_scipys():
    values = np.array([[1.0, 2, 3, 1, 1], [1, 2, 4, 2, 2], [2, 1, 3, 3, 3]])
    oracle = stats.friedmanchisquare(*values)
    assert friedman(stats.rankdata(values, axis=0)) == pytest.approx((oracle.statistic, oracle.pvalue))


@pytest.mark.parametrize(("k", "n", "expected"), [(4, 14, 1.25), (5, 30, 1.11), (10, 10, 4.28)])
def test_critical_difference_is_demsars(k, n, expected):
    """q of Demsar (2006), table 5(a): 2.569, 2.728, 3.164; his example has 4 classifiers, 14 data sets."""
    assert critical_difference(k, n) == pytest.approx(expected, abs=0.006)


@pytest.mark.parametrize("seed", range(3))
def test_pairs_are_scipys_wilcoxon_and_statsmodels_holm(seed):
    values = gamma(5, 10, seed)
    pairs = rank(table(values)).pairs
    by_name = dict(zip("abcde", values, strict=True))
    p = [stats.wilcoxon(by_name[row.first], by_name[row.second], method="exact").pvalue for row in pairs.itertuples()]
    np.testing.assert_allclose(pairs["wilcoxon_p"], p)
    reject, adjusted, _, _ = multipletests(p, alpha=0.05, method="holm")
    np.testing.assert_allclose(pairs["holm_p"], adjusted)
    np.testing.assert_array_equal(pairs["resolved"], reject)


@given(arrays(float, st.integers(1, 12), elements=st.floats(0.0, 1.0)))
@settings(max_examples=60, deadline=None)
def test_holm_is_statsmodels_and_never_below_the_raw_value(p):
    adjusted = holm(p)
    np.testing.assert_allclose(adjusted, multipletests(p, method="holm")[1])
    assert (adjusted >= p).all()
    np.testing.assert_array_equal(np.sort(adjusted), adjusted[np.argsort(p, kind="stable")])


def test_holm_is_step_down_not_one_threshold():
    """Bonferroni would give .04, .08, .12, .16."""
    np.testing.assert_allclose(holm(np.array([0.04, 0.01, 0.03, 0.02])), [0.06, 0.04, 0.06, 0.06])


def test_wilcoxon_is_exact_with_ties_and_zeros():
    """Against all 2^n sign patterns of the differences that are not zero."""
    difference = np.array([0.0, 1.0, 1.0, 2.0, -1.0, 3.0, 3.0, -2.0, 4.0])
    moved = difference[difference != 0]
    ranks = stats.rankdata(np.abs(moved))
    signs = np.array(np.meshgrid(*[[-1, 1]] * len(moved))).reshape(len(moved), -1)
    sums = np.abs(ranks @ signs)
    exact = (sums >= abs(ranks @ np.sign(moved)) - 1e-9).mean()
    assert wilcoxon_p(difference) == pytest.approx(exact)
    assert wilcoxon_p(np.zeros(5)) == 1.0


def test_rank_biserial_in_closed_form():
    assert rank_biserial(np.array([1.0, 2.0, 3.0])) == 1.0
    assert rank_biserial(np.array([-1.0, -2.0, -3.0])) == -1.0
    assert rank_biserial(np.array([1.0, -2.0, 3.0, 0.0])) == pytest.approx((1 + 3 - 2) / 6)
    assert rank_biserial(np.zeros(3)) == 0.0
    # scipy's statistic is the smaller of the two rank sums.
    difference = np.random.default_rng(0).normal(0.5, 1.0, size=12)
    smaller = stats.wilcoxon(difference).statistic
    assert abs(rank_biserial(difference)) == pytest.approx(1 - 2 * smaller / (12 * 13 / 2))


def test_effect_and_difference_point_the_same_way():
    values = np.vstack([np.arange(1.0, 11.0) + 5.0, np.arange(1.0, 11.0)])
    pair = rank(table(values, names=("worse", "better"))).pairs.iloc[0]
    assert (pair["first"], pair["second"]) == ("better", "worse")
    assert pair["effect_size"] == 1.0
    assert pair["median_difference"] == pytest.approx(5.0)
    assert pair["rank_gap"] == pytest.approx(1.0)
    assert pair["resolved"]


@settings(max_examples=15, deadline=None)
@given(arrays(float, (4, 7), elements=st.integers(1, 50).map(float)))
def test_ranks_do_not_change_under_a_monotone_transform_of_each_sequence(values):
    scale = np.arange(1.0, 8.0)
    before, after = rank(table(values)), rank(table(np.log(values) * scale + scale**2))
    assert before.estimators == after.estimators
    np.testing.assert_array_equal(before.ranks, after.ranks)
    assert before.friedman_p == after.friedman_p
    assert before.cliques == after.cliques


@settings(max_examples=15, deadline=None)
@given(arrays(float, (5, 6), elements=st.integers(0, 9).map(float)))
def test_ranks_of_each_sequence_sum_to_the_same_and_come_best_first(values):
    ranking = rank(table(values))
    np.testing.assert_allclose(ranking.ranks.sum(axis=0), 15.0)
    assert (np.diff(ranking.mean_ranks) >= 0).all()
    assert 0.0 <= ranking.friedman_p <= 1.0
    assert (ranking.pairs["rank_gap"] >= 0).all()
    # Bars are runs of neighbours, none inside another.
    spans = [(ranking.estimators.index(bar[0]), ranking.estimators.index(bar[-1])) for bar in ranking.cliques]
    assert spans == sorted(set(spans))
    assert all(low < high for low, high in spans)
    assert all(a[1] < b[1] for a, b in pairwise(spans))


def test_cliques_are_the_largest_runs_within_the_gap():
    names = tuple("abcde")
    mean_ranks = np.array([1.0, 2.0, 2.9, 4.0, 5.0])
    expected = (("a", "b", "c"), ("b", "c", "d"), ("d", "e"))
    assert cliques(names, mean_ranks, 2.0) == expected
    assert cliques(names, mean_ranks, 0.5) == ()
    assert cliques(names, mean_ranks, 4.0) == (names,)


def test_without_a_friedman_difference_all_are_one_clique():
    same = np.tile(np.array([[1.0, 2.0, 3.0, 2.0, 1.0, 3.0]]), (3, 1))
    ranking = rank(table(same))
    assert ranking.friedman_p == 1.0
    assert ranking.cliques == (("a", "b", "c"),)
    assert not ranking.pairs["resolved"].any()


def test_nothing_is_located_where_friedman_finds_nothing():
    """The extreme mean ranks are further apart than the critical difference, yet Friedman's p is .066."""
    ranks = [
        [5, 5, 5, 3, 4, 5],
        [4, 1, 2, 5, 3, 2],
        [3, 2, 1, 2, 2, 1],
        [2, 4, 3, 1, 5, 3],
        [1, 3, 4, 4, 1, 4],
    ]
    ranking = rank(table(np.array(ranks, dtype=float)))
    assert np.ptp(ranking.mean_ranks) > ranking.critical_difference
    assert ranking.cliques == (ranking.estimators,)


def test_a_clear_order_is_found():
    values = gamma(3, 12, 0)[:1] * np.array([[1.0], [4.0], [16.0]])
    ranking = rank(table(values))
    assert ranking.estimators == ("a", "b", "c")
    assert ranking.pairs["resolved"].all()
    assert ranking.cliques == ()  # critical difference .96 at 12 sequences, gaps of 1


def test_calibration_is_ranked_by_distance_to_its_ideal():
    values = np.array([[95.0, 94.0, 96.0], [100.0, 100.0, 100.0], [60.0, 70.0, 80.0]])
    assert rank(table(values, "coverage95_pct", ("right", "wide", "narrow"))).estimators == (
        "right",
        "wide",
        "narrow",
    )


def test_a_failed_score_drops_its_estimator_with_the_reason_and_spares_the_rest():
    frame = pd.DataFrame(
        [
            (name, 0, f"s{i}", "p_nrmse_pct", value)
            for name, row in zip("abcd", gamma(4, 8, 5), strict=True)
            for i, value in enumerate(row)
        ],
        columns=["estimator", "seed", "sequence", "metric", "value"],
    )
    frame.loc[(frame["estimator"] == "b") & (frame["sequence"] == "s3"), "value"] = np.nan
    ranking = rank(sequence_scores(frame, "p_nrmse_pct", failed={"e": "diverged"}))
    assert ranking.dropped == {"b": "no score in 1 of 8 (seed 0; s3)", "e": "diverged"}
    assert "e is not ranked: diverged." in ranking.notes
    without = rank(sequence_scores(frame[frame["estimator"] != "b"], "p_nrmse_pct"))
    assert ranking.estimators == without.estimators
    assert ranking.friedman_p == without.friedman_p
    assert np.isfinite(ranking.friedman_p)


def test_too_little_to_rank_is_refused_with_the_reasons():
    scores = SequenceScores("p_nrmse_pct", ("a", "b"), ("s0", "s1"), np.ones((2, 2)), {"b": "diverged"}, ())
    with pytest.raises(ValueError, match="there are 1 and 2; b: diverged"):
        rank(scores)


def test_two_estimators_have_a_wilcoxon_but_no_friedman():
    ranking = rank(table(gamma(2, 8, 0)))
    assert np.isnan(ranking.friedman_p)
    assert len(ranking.pairs) == 1
    assert np.isfinite(ranking.pairs["wilcoxon_p"][0])


@pytest.mark.parametrize(("n", "level"), [(10, 0.05), (10, 0.05 / 21), (5, 0.01), (40, 0.05)])
def test_smallest_gap_is_the_t_tests_power(n, level):
    effect = TTestPower().solve_power(nobs=n, alpha=level, power=0.8, alternative="two-sided")
    assert smallest_gap(2.5, n, level) == pytest.approx(2.5 * effect, rel=1e-4)


def test_smallest_p_is_reached_when_one_estimator_always_wins():
    """With 7 estimators ten sequences just can, nine cannot: 21 pairs times 2 / 2^n."""
    assert smallest_p(7, 10) == pytest.approx(21 * 2 / 2**10)
    assert smallest_p(7, 10) < 0.05 < smallest_p(7, 9)
    assert sequences_needed(7) == 10
    values = np.random.default_rng(0).gamma(2.0, size=(1, 10)) * np.arange(1.0, 8.0)[:, None]
    assert rank(table(values)).pairs["holm_p"].min() == pytest.approx(smallest_p(7, 10))


def test_the_resolution_floor_is_told_with_the_ranking():
    values = gamma(7, 4, 0)
    ranking = rank(table(values))
    floor = ranking.resolution
    assert (floor.n_sequences, floor.n_estimators, floor.sequences_needed) == (4, 7, 10)
    assert floor.rank_gap == ranking.critical_difference
    assert floor.paired_gap == pytest.approx(ranking.pairs["smallest_gap"].median())
    pair = ranking.pairs.iloc[0]
    a, b = (values["abcdefg".index(pair[name])] for name in ("first", "second"))
    assert pair["smallest_gap"] == pytest.approx(smallest_gap(np.std(a - b, ddof=1), 4, 0.05 / 21))
    assert any("4 sequences and 7 estimators" in note for note in ranking.notes)
    assert any("cannot resolve any pair" in note and "takes 10 sequences" in note for note in ranking.notes)


@pytest.mark.parametrize("seed", range(2))
def test_the_smallest_gap_is_found_four_times_out_of_five(seed):
    """Monte Carlo: normal differences with just that mean, t test at the family-wise level of 3 pairs."""
    n, level, repeats = 10, 0.05 / 3, 4_000
    gap = smallest_gap(1.0, n, level)
    difference = np.random.default_rng(seed).normal(gap, 1.0, size=(repeats, n))
    found = (stats.ttest_1samp(difference, 0.0, axis=1).pvalue < level).mean()
    assert found == pytest.approx(0.8, abs=0.025)
