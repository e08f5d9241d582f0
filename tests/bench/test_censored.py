"""Times that had not come when the recording ended: Kaplan and Meier, against statsmodels; what is counted as a run."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest
from statsmodels.duration.survfunc import SurvfuncRight

from twinbench.bench.report.tables import build_tables
from twinbench.bench.statistics.censored import (
    LEAST_WATCHED,
    Waiting,
    median,
    restricted,
    survival,
    waiting,
    watched,
)
from twinbench.bench.statistics.summary import summarise
from twinbench.bench.statistics.tracking import LONGEST_DELAY_S

COLUMNS = ["estimator", "seed", "sequence", "metric", "value"]


def rows(times: dict[str, list[list[float]]], kind="recovery", limit_s=100.0) -> pd.DataFrame:
    """Times after one change of capacity: per estimator and seed a list over sequences; errors besides."""
    found = []
    for e, (estimator, seeds) in enumerate(times.items()):
        for seed, values in enumerate(seeds):
            for s, value in enumerate(values):
                found += [
                    (estimator, seed, f"s{s}", f"{kind}_capacity_1_s", value),
                    (estimator, seed, f"s{s}", "watched_capacity_1_s", limit_s),
                ]
                other = 0 if estimator.startswith("same") else seed
                found.append((estimator, seed, f"s{s}", "parameter_error_pct", 1.0 + e + 0.1 * s + 0.01 * other))
    return pd.DataFrame(found, columns=COLUMNS)


@pytest.mark.parametrize("seed", range(5))
def test_the_curve_is_that_of_statsmodels(seed):
    rng = np.random.default_rng(seed)
    time_s = np.round(rng.exponential(30.0, 40))
    seen = rng.random(40) < 0.6
    ours_s, ours = survival(time_s, seen, np.ones((1, 40)))
    theirs = SurvfuncRight(time_s, seen.astype(int))
    at = np.searchsorted(ours_s, theirs.surv_times, side="right") - 1
    np.testing.assert_allclose(ours[0, at], theirs.surv_prob, rtol=1e-12)
    half = theirs.surv_times[theirs.surv_prob <= 0.5]
    enough = len(half) and (time_s >= half[0]).mean() >= LEAST_WATCHED
    assert median(time_s, seen, np.ones((1, 40)))[0] == (half[0] if enough else np.inf)


def test_weights_are_runs_that_are_there_as_often():
    rng = np.random.default_rng(9)
    time_s, seen, often = rng.random(12), rng.random(12) < 0.7, rng.integers(0, 4, 12)
    repeated = median(np.repeat(time_s, often), np.repeat(seen, often), np.ones((1, often.sum())))
    assert median(time_s, seen, often[None].astype(float)) == repeated


def test_one_success_of_many_is_no_quick_recovery():
    scores = rows({"lucky": [[5.0, *[np.nan] * 9]], "steady": [[40.0 + s for s in range(10)]]})
    by = {e: waiting(own) for e, own in watched(scores, "recovery_s").groupby("estimator")}
    assert (by["lucky"].median_s, by["lucky"].happened, by["lucky"].runs) == (np.inf, 1, 10)
    assert (by["steady"].median_s, by["steady"].happened) == (44.0, 10)
    assert by["steady"].low_s < 44.0 < by["steady"].high_s


def test_a_run_that_ended_first_counts_as_longer():
    times = pd.DataFrame({"sequence": list("abc"), "time_s": [10.0, 20.0, 15.0], "seen": [True, True, False]})
    # Of those still watched at 20 s the one recovers: 2/3 wait past 10 s, nobody is known to wait past 20 s.
    assert waiting(times).median_s == 20.0
    assert waiting(times[:0]) == pytest.approx(Waiting(np.nan, np.nan, np.nan, 0, 0), nan_ok=True)


def test_two_long_recordings_do_not_speak_for_all():
    """Most runs ended at 100 s without it; the two that were watched longer saw it at 500 s."""
    times_s = pd.DataFrame(
        {
            "sequence": [f"s{i}" for i in range(12)],
            "time_s": [100.0] * 10 + [500.0, 510.0],
            "seen": [False] * 10 + [True] * 2,
        }
    )
    assert SurvfuncRight(times_s["time_s"], times_s["seen"].astype(int)).quantile(0.5) == 510.0
    assert waiting(times_s).median_s == np.inf


def test_seeds_that_repeat_one_another_count_once_and_failed_ones_never():
    scores = rows({"same": [[1.0, np.nan]] * 3, "drawn": [[1.0, np.nan]] * 3, "gone": [[2.0, 3.0]]})
    scores.loc[scores["estimator"] == "gone", "value"] = np.nan
    counted = watched(scores, "recovery_s").groupby("estimator").size()
    assert counted.to_dict() == {"drawn": 6, "same": 2}


def test_each_change_of_a_recording_counts_and_its_recording_is_the_block():
    """Two changes in the first recording, one in the second; the first of all was never recovered from."""
    once = rows({"a": [[np.nan, 7.0]]})
    again = once[once["sequence"] == "s0"].replace(
        {"metric": {"recovery_capacity_1_s": "recovery_leakage_1_s", "watched_capacity_1_s": "watched_leakage_1_s"}}
    )
    again = again[again["metric"].str.contains("leakage")].assign(value=[5.0, 40.0])
    times_s = watched(pd.concat([once, again]), "recovery_s")
    assert list(times_s.sort_values(["sequence", "change"])["change"]) == ["capacity_1", "leakage_1", "capacity_1"]
    assert times_s.sort_values(["sequence", "change"])["time_s"].tolist() == [100.0, 5.0, 7.0]
    found = waiting(times_s)
    assert (found.median_s, found.happened, found.runs) == (7.0, 2, 3)
    # A paired test counts each recording once.
    mean_s = restricted(times_s, "recovery_s").set_index("sequence")["value"]
    assert mean_s.to_dict() == {"s0": 52.5, "s1": 7.0}


def test_without_any_change_there_is_no_time():
    errors = rows({"a": [[1.0]]}).query("metric == 'parameter_error_pct'")
    assert watched(errors, "recovery_s").empty
    assert watched(errors, "delay_s").empty


def test_a_delay_at_the_edge_of_the_search_was_not_found():
    scores = rows({"a": [[LONGEST_DELAY_S, LONGEST_DELAY_S - 0.2, 3.0, np.nan]]}, "delay")
    times_s = watched(scores, "delay_s")
    assert times_s["seen"].tolist() == [False, False, True, False]
    assert times_s["time_s"].tolist() == [LONGEST_DELAY_S] * 2 + [3.0, LONGEST_DELAY_S]


def test_the_table_says_of_how_many_and_marks_nobody_for_one_success():
    scores = rows({"lucky": [[0.0, *[np.nan] * 9]], "steady": [[40.0 + s for s in range(10)]]})
    nothing = pd.DataFrame(columns=["estimator", "mode", "implementation", "window", "p50_us", "memory_kB"])
    cost = pd.DataFrame([("lucky", 0, "fit", 1.0)], columns=["estimator", "seed", "stage", "cpu_s"])
    tables = {t.name: t for t in build_tables(summarise(scores, {}), pd.DataFrame(), nothing, cost, "quick")}
    lucky, steady = (
        {c.head: row[i] for i, c in enumerate(tables["following"].columns)} for row in tables["following"].rows
    )
    assert (lucky["recovery"].text, lucky["recovery"].times) == ("not reached", "1 of 10")
    assert not lucky["recovery"].best
    assert (steady["recovery"].text, steady["recovery"].times) == ("44.0", "10 of 10")
    assert steady["recovery"].best
    frame = tables["following"].frame.set_index("estimator")
    assert frame.loc["lucky", "recovery_s"] == np.inf
    assert frame.loc["steady", ["recovery_s_happened", "recovery_s_runs"]].tolist() == [10.0, 10.0]
