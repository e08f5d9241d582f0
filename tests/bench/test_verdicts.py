"""A sentence says no more than the tests of the tables: made-up scores whose answer is known."""

from __future__ import annotations

from itertools import product

import numpy as np
import pandas as pd
import pytest

from twinbench.bench.report.main_table import comparison, extremes, quickest, quickest_form
from twinbench.bench.report.paper import NONE, paper_says, parts_say
from twinbench.bench.report.verdicts import verdicts
from twinbench.bench.statistics.scores import FORECAST_ERRORS, STATE_ERRORS
from twinbench.bench.statistics.summary import LIFE, PARAMETERS, Summary, summarise
from twinbench.machines.compressor import ESTIMATED, HEALTH

SEQUENCES = 30
NOTHING = pd.DataFrame(columns=["estimator", "condition", "metric", "value"])
ERRORS = (*STATE_ERRORS, *FORECAST_ERRORS, LIFE, PARAMETERS, *(f"{h}_life_pct" for h in HEALTH))
LEVELS = {"oracle": 1.0, "always_prior": 3.0, "gru_kf": 2.9, "pinn_ukf": 1.0, "deeponet_kalman": 1.0, "lstm_rls": 6.0}


def scores(levels: dict[str, float], spread: float = 0.3, kind: str = "test", **changed: float) -> pd.DataFrame:
    """One seed: each recording has a difficulty that all share, and each estimator its level and its own luck.

    Args:
        changed: levels of one metric, ``metric__estimator``.
    """
    rng = np.random.default_rng(11)
    rows = []
    for metric in ERRORS:
        hard = rng.uniform(0.7, 1.5, SEQUENCES)
        for name, usual in levels.items():
            level = changed.get(f"{metric}__{name}", usual)
            for s, value in enumerate(level * hard * np.exp(spread * rng.standard_normal(SEQUENCES))):
                rows.append((name, 0, f"{kind}-{s:02d}", metric, value))
    for q, quantity in enumerate(ESTIMATED):
        for name in levels:
            for s in range(SEQUENCES):
                rows.append((name, 0, f"{kind}-{s:02d}", f"coverage_{quantity}_pct", 90.0 + q))
                rows.append((name, 0, f"{kind}-{s:02d}", f"calibrated_coverage_{quantity}_pct", 94.0 + 0.2 * q))
    return pd.DataFrame(rows, columns=["estimator", "seed", "sequence", "metric", "value"])


def said(summary: Summary, begins: str) -> str:
    (found,) = [text for text in verdicts(summary, pd.DataFrame()) if text.startswith(begins)]
    return found


def test_a_leader_is_told_from_those_whom_the_test_tells() -> None:
    summary = summarise(scores(LEVELS), {})
    text = said(summary, "In filtered pressure")
    first, second = sorted(("pinn_ukf", "deeponet_kalman"), key=lambda e: summary.value(e, "p_nrmse_pct").mean)
    names = {"pinn_ukf": "PINN + UKF", "deeponet_kalman": "DeepONet-Kalman"}
    assert f"In filtered pressure {names[first]} has the least error" in text
    assert text.endswith(f"The tests tell it from all ranked estimators but {names[second]}.")


def test_one_who_is_told_from_all_is_said_to_be_and_one_from_nobody_too() -> None:
    alone = summarise(scores(LEVELS | {"pinn_ukf": 4.0}, spread=0.05), {})
    assert said(alone, "In filtered flow").endswith("The tests tell it from every other ranked estimator.")
    alike = summarise(scores(dict.fromkeys(LEVELS, 1.0)), {})
    assert said(alike, "In filtered flow").endswith("The tests tell it from no other ranked estimator.")


def test_skill_needs_an_interval_above_zero() -> None:
    text = said(
        summarise(scores(LEVELS), {}), "Of the rows that cost nothing, Always at the prior errs least in health"
    )
    better, rest = text.split("No difference is found for: ")
    assert "By the paired 95 % interval 3 of 5 others err less: " in better
    assert "DeepONet-Kalman has a skill of 0.6" in better
    assert rest == "GRU + KF. Worse: LSTM + RLS."


def test_that_nobody_has_skill_is_said_and_without_a_row_that_costs_nothing_nothing_is() -> None:
    begins = "Of the rows that cost nothing"
    nobody = summarise(scores(LEVELS | {"always_prior": 0.1}), {})
    assert "none of 5 others errs less. Worse: " in said(nobody, f"{begins}, Always at the prior errs least in health")
    alone = summarise(scores({name: level for name, level in LEVELS.items() if name != "always_prior"}), {})
    assert not any(text.startswith(begins) for text in verdicts(alone, pd.DataFrame()))


def test_a_parameter_without_skill_is_named() -> None:
    changed = {"leakage_life_pct__deeponet_kalman": 3.0}
    text = said(summarise(scores(LEVELS, **changed), {}), "DeepONet-Kalman has skill")
    assert text.endswith("and none is shown in leakage.")
    assert "leakage" not in text.partition(", and none")[0]


@pytest.mark.parametrize(
    ("level", "says"),
    [(0.9, "It errs at most 1.15 times"), (1.6, "It errs more than 1.15 times"), (1.15, "Whether it errs more")],
)
def test_nearness_to_the_reference_is_decided_by_the_interval(level: float, says: str) -> None:
    summary = summarise(scores(LEVELS | {"deeponet_kalman": level}), {})
    value = summary.value("deeponet_kalman", LIFE)
    wanted = {
        "It errs at most 1.15 times": value.times_high <= 1.15,
        "It errs more than 1.15 times": value.times_low > 1.15,
        "Whether it errs more": value.times_low <= 1.15 < value.times_high,
    }
    assert wanted[says]
    (text,) = [one for one in verdicts(summary, pd.DataFrame()) if says in one]
    assert "health" in text.partition(says)[2].split(". ")[0]


def test_who_passes_the_reference_is_said_and_that_nobody_does() -> None:
    passing = summarise(scores(LEVELS | {"deeponet_kalman": 0.5}), {})
    passed = said(passing, "The reference is no bound: by the paired 95 % interval ")
    assert "DeepONet-Kalman errs less than it in filtered pressure, filtered temperature" in passed
    nobody = summarise(scores(LEVELS | {"pinn_ukf": 1.5, "deeponet_kalman": 1.5}), {})
    assert said(nobody, "No ranked estimator errs less")


def test_the_true_start_held_is_no_estimator_and_must_lose() -> None:
    summary = summarise(scores(LEVELS | {"true_start_held": 2.0}), {})
    assert "It errs more than the reference" in said(summary, "True start held")
    assert not any("True start held" in text for text in verdicts(summary, pd.DataFrame()) if text.startswith("Of the"))
    still = summarise(scores(LEVELS | {"true_start_held": 0.4}), {})
    assert said(still, "True start held").endswith("too little changes in these recordings.")


def test_coverage_by_regime_names_its_ends() -> None:
    pairs = enumerate(product(("all", "after_load"), ESTIMATED[:4]))
    rows = [("deeponet_kalman", r, q, 90.0 + k, 88.0 + k, 92.0 + k) for k, (r, q) in pairs]
    columns = ["estimator", "regime", "quantity", "calibrated_pct", "calibrated_low", "calibrated_high"]
    regimes = pd.DataFrame(rows, columns=columns)
    text = verdicts(summarise(scores(LEVELS), {}), regimes)[-1]
    assert "from 90.0 % (intake pressure, all) to 97.0 % (wall temperature, after load)" in text
    assert "It lies between 93 and 97 % in 5 of 8 pairs." in text
    # Only the first interval, 88 to 92, lies outside.
    assert "In 1 of its pairs the interval over recordings lies wholly outside these bounds." in text
    assert "the reference's" not in text
    both = pd.concat([regimes, regimes.assign(estimator="oracle", calibrated_pct=95.0)])
    assert "in 5 of 8 pairs; the reference's does in 8." in verdicts(summarise(scores(LEVELS), {}), both)[-1]


def test_coverage_is_that_of_the_worst_and_best_quantity() -> None:
    summary = summarise(scores(LEVELS), {})
    least, most = extremes(summary, "gru_kf") or pytest.fail("there is coverage")
    assert (round(least[0], 9), least[1], round(most[0], 9), most[1]) == (
        90.0,
        "intake pressure",
        99.0,
        "temperature bias",
    )
    before = said(summary, "The 95 % intervals of DeepONet-Kalman, as it reports them,")
    after = said(summary, "The 95 % intervals of DeepONet-Kalman, after calibration,")
    assert before.endswith("between 93 and 97 %: no.")
    assert after.endswith("between 93 and 97 %: yes.")


def test_the_paper_holds_where_the_tests_say_so() -> None:
    table = scores(LEVELS, kind="single", **{f"{PARAMETERS}__gru_kf": 1.0})
    found = paper_says(summarise(table, {}, "single"))
    assert "Here it holds in pressure, temperature and flow; the tests do not decide in parameter" in found[0]
    assert "Holm over the paper's six" in found[0]
    assert any(text.startswith("The paper: pressure error 0.720 %") and "lies above" in text for text in found)


def test_ablations_are_told_by_their_interval() -> None:
    levels = LEVELS | {"deeponet_kalman:no_covariance_adaptation": 1.6, "deeponet_kalman:no_feasibility": 1.0}
    table = scores(levels, spread=0.02, kind="single")
    found = parts_say(table, {}, NOTHING)
    (adapted,) = [text for text in found if "covariance adaptation" in text]
    assert "grows by 1.70 percentage points. Here: it grows" in adapted
    (vacuous,) = [text for text in found if "feasibility" in text]
    assert "no difference is found" in vacuous


def test_without_recordings_of_the_papers_kind_nothing_is_claimed() -> None:
    assert paper_says(None) == [NONE]


def test_a_filter_is_as_quick_as_its_quickest_form() -> None:
    rows = [
        ("nominal_ekf", "compiled", 300.0), ("nominal_ekf", "filterpy", 500.0), ("numba_ekf", "all compiled", 25.0),
        ("deeponet_kalman", "in place", 48.0),
    ]  # fmt: skip
    latency = pd.DataFrame(rows, columns=["estimator", "implementation", "p50_us"])
    assert quickest(latency, "p50_us") == {"nominal_ekf": 25.0, "deeponet_kalman": 48.0}
    assert quickest_form(latency)["nominal_ekf"] == "all compiled"


def test_a_form_that_others_lack_stands_beside_the_one_that_all_have() -> None:
    rows = [
        ("deeponet_kalman", "in place", 19.0),
        ("deeponet_kalman", "compiled", 62.0),
        ("pinn_ukf", "compiled", 300.0),
    ]
    latency = pd.DataFrame(rows, columns=["estimator", "implementation", "p50_us"])
    summary, cost = summarise(scores(LEVELS), {}), pd.DataFrame(columns=["estimator", "stage", "cpu_s"])
    notes = " ".join(comparison(summary, "small", latency, cost).notes)
    assert "Of DeepONet-Kalman a form with nothing left in Python was timed" in notes
    assert "as DeepONet-Kalman can be: then an update of it takes 62.0 µs." in notes
    assert "left in Python" not in " ".join(comparison(summary, "small", latency[1:], cost).notes)
