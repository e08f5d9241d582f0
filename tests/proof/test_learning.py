"""The decision that is learnt from concealed cases, against another library, and from the rows that are kept."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy.special import expit
from scipy.stats import poisson
from sklearn.linear_model import LogisticRegression

from twinbench.mismatch.naming.decision import FEATURES, RULE, Rule, learnt_rule
from twinbench.proof.concealed.outcome import WRONG_NAMES
from twinbench.proof.concealed.plan import FULL
from twinbench.proof.learning.__main__ import main
from twinbench.proof.learning.fit import (
    CONFIDENCE,
    SHRINKAGE,
    WRONG_SETS,
    at_most,
    in_the_suite,
    learnt,
    least_of_a_set,
    least_probability,
    logistic,
)

ROWS = Path(__file__).parents[2] / "results" / "learning"


def drawn(n: int = 3000) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(1)
    x = rng.normal(size=(n, 3)) * [1.0, 2.0, 0.5] + [0.0, 1.0, -1.0]
    return x, rng.random(n) < expit(x @ [0.8, 0.3, 1.1] - 0.4)


def test_with_no_share_it_is_the_ridge_regression_of_another_library() -> None:
    x, y = drawn()
    count = np.random.default_rng(4).uniform(0.3, 2.0, len(x))
    w = logistic(x, y, np.ones(len(x)), count)
    mean, spread = x.mean(axis=0), x.std(axis=0)
    other = LogisticRegression(C=1.0 / SHRINKAGE, tol=1e-10, max_iter=1000).fit((x - mean) / spread, y, count)
    assert w[1:] == pytest.approx(other.coef_[0] / spread, rel=1e-3)
    assert w[0] == pytest.approx(other.intercept_[0] - np.sum(other.coef_[0] * mean / spread), rel=1e-3)


def test_a_known_share_is_taken_off_and_what_speaks_against_counts_nothing() -> None:
    x, among = drawn(20_000)
    rng = np.random.default_rng(2)
    share = rng.uniform(0.2, 1.0, len(x))
    y = among & (rng.random(len(x)) < share)
    w = logistic(np.column_stack((x, -x[:, 0])), y, share, np.ones(len(x)))
    assert w[1:4] == pytest.approx([0.8, 0.3, 1.1], abs=0.15)
    assert w[4] == 0.0


def test_sets_are_said_from_where_on_they_state_what_is_promised() -> None:
    rng = np.random.default_rng(6)
    q, count = rng.uniform(0.4, 1.0, 300), rng.uniform(0.3, 2.0, 300)
    t = least_of_a_set(q, count)
    for limit, kept in ((t, True), (q[q < t].max(), False)):
        said = q >= limit
        assert (np.average(1.0 - q[said], weights=count[said]) <= WRONG_SETS) == kept
    assert least_of_a_set(np.full(9, 0.9), np.ones(9)) == 1.0


def test_a_verdict_with_two_wrong_names_is_wrong_once() -> None:
    p = np.array([0.95, 0.94, 0.9, 0.8, 0.7, 0.6])
    wrong, case = np.array([True, True, False, True, False, True]), np.array([0, 0, 1, 2, 3, 4])
    cases = 200
    expected = WRONG_NAMES * cases
    assert poisson.cdf(1, expected) < 1.0 - CONFIDENCE < poisson.cdf(2, expected), "one wrong verdict may be"
    assert least_probability(p, wrong, case, np.ones(cases)) == pytest.approx(0.9)
    assert least_probability(p, wrong, case, np.ones(10)) > 0.95, "too few cases say nothing"


def test_rows_count_as_their_cells_do_in_the_suite() -> None:
    cells = ["clean"] * 3 + ["foreign"] * 12 + ["left_out"] * 6
    count = in_the_suite([{"cell": cell} for cell in cells])
    assert count.mean() == pytest.approx(1.0)
    shares = {cell: count[[c == cell for c in cells]].sum() for cell in set(cells)}
    assert shares["foreign"] / shares["clean"] == pytest.approx(FULL["foreign"] / FULL["clean"])
    assert shares["left_out"] / shares["clean"] == pytest.approx(FULL["left_out"] / FULL["clean"])


@pytest.mark.parametrize("seen", [0, 1, 7])
def test_what_counts_alike_is_bounded_as_a_poisson_count(seen: int) -> None:
    for each in (1.0, 0.4):
        bound = at_most(np.full(seen, each), np.full(50, each))
        assert poisson.cdf(seen, bound / each) == pytest.approx(1.0 - CONFIDENCE)


def test_what_counts_differently_is_bounded_as_often_as_promised() -> None:
    rng = np.random.default_rng(5)
    each, expected, rows = np.array([0.5, 1.0, 1.8]), np.array([6.0, 2.0, 1.0]), [150, 100, 200]
    every = np.repeat(each, rows)
    bounds = [at_most(np.repeat(each, rng.poisson(expected)), every) for _ in range(2000)]
    kept = np.mean(np.array(bounds) >= each @ expected)
    assert CONFIDENCE - 0.02 < kept < CONFIDENCE + 0.1


def test_the_rule_is_the_one_that_its_rows_give(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    made = tmp_path / "decision.json"
    monkeypatch.setattr("twinbench.proof.learning.__main__.RULE", made)
    assert main(["--rows", str(ROWS), "--out", str(tmp_path)]) == 0
    kept, again = json.loads(RULE.read_text()), json.loads(made.read_text())
    for name in ("weights", "say_name", "say_set", "left_out"):
        assert again[name] == pytest.approx(kept[name], rel=1e-3), name
    curve = pd.read_csv(tmp_path / "tradeoff.csv")
    pd.testing.assert_frame_equal(curve, pd.read_csv(ROWS / "tradeoff.csv"), rtol=1e-2)
    assert curve["wrong"].is_monotonic_decreasing
    assert curve["named"].is_monotonic_decreasing
    own = curve[curve["say_name"] >= again["say_name"]].iloc[0]
    assert own["wrong"] <= again["left_out"]["wrong_in_the_suite"] * (1.0 + 1e-3)  # which the table rounds
    rule = learnt_rule()
    assert isinstance(rule, Rule)
    assert set(rule.weights) == {"constant", *FEATURES}


def test_nothing_is_learnt_from_a_handful(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--rows", str(tmp_path)]) == 2
    assert "too few to learn from" in capsys.readouterr().err


def test_rows_that_failed_are_left_out() -> None:
    rows = [json.loads(path.read_text()) for path in sorted(ROWS.glob("*.json"))]
    assert learnt([*rows, {"failed": "it did", "case": "x"}])["left_out"] == learnt(rows)["left_out"]
