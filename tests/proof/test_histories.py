"""The proof of sizes over time: courses, what is drawn, how rows are summed up, and bad input in one line."""

from __future__ import annotations

import itertools

import numpy as np
import pandas as pd
import pytest

from twinbench.proof.histories.__main__ import main, summary, to_markdown
from twinbench.proof.histories.drawn import Course, draw


def test_a_course_goes_as_its_kind_says() -> None:
    ramp, step = (Course(kind, 0.5, 100.0, 200.0) for kind in ("ramp", "step"))
    assert [ramp.factor(t) for t in (0.0, 100.0, 150.0, 200.0, 900.0)] == [1.0, 1.0, 1.25, 1.5, 1.5]
    assert [step.factor(t) for t in (0.0, 99.0, 100.0, 900.0)] == [1.0, 1.0, 1.5, 1.5]
    assert ramp.told == pytest.approx((ramp.factor(180.0) - ramp.factor(130.0)) / 50.0)
    assert step.told == 0.5
    assert Course("constant", 0.0, 100.0, 200.0).factor(150.0) == 1.0


def test_a_case_is_drawn_again_and_an_ideal_observer_can_tell_some_of_it() -> None:
    once, again = draw(2, 5), draw(2, 5)
    assert once.course == again.course
    assert once.course.kind == "step"
    assert 0.0 < once.ideal_sd < 0.5
    assert 0.0 < abs(once.ideal_off) < 4.0 * once.ideal_sd
    for a, b in zip((*once.learnt, *once.held), (*again.learnt, *again.held), strict=True):
        assert np.array_equal(a.values, b.values)
    ends = [(r.time_s[0], r.time_s[-1]) for r in once.learnt]
    assert all(before[1] < after[0] for before, after in itertools.pairwise(ends))


def test_rows_are_summed_up_by_kind() -> None:
    rows = pd.DataFrame(
        {
            "kind": ["constant", "ramp", "ramp", "ramp"],
            "told": ["constant", "ramp", "", "ramp"],
            "constant": [0.9, 0.01, np.nan, 0.02],
            "ideal_sd": [0.0, 0.05, 0.05, 0.9],
            "error": [np.nan, 0.1, 1.0, 0.2],
            "holds": [np.nan, 1.0, np.nan, 0.0],
            "off_s": [np.nan, -3.0, np.nan, 5.0],
            "since_holds": [np.nan, 1.0, np.nan, 1.0],
            "ideal_holds": [np.nan, 1.0, 1.0, 1.0],
        }
    )
    told = summary(rows)
    constant, ramp, both = told.to_dict("records")
    assert (constant["told as such"], constant["constant below 0.05"], constant["ideal observer can"]) == (1.0, 0.0, 0)
    assert ramp["effect found"] == ramp["told as such"] == pytest.approx(2 / 3)
    assert ramp["ideal observer can"] == 2
    assert ramp["median error where it can"] == pytest.approx(0.55)
    assert (ramp["interval holds"], ramp["median off, s"]) == (0.5, 4.0)
    # Clopper and Pearson's interval of 1 in 2 and of 3 in 3: by the quantiles of Beta(1, 2) and of Beta(3, 1).
    ends = [ramp[f"interval holds, {end}"] for end in ("from", "to")]
    assert ends == pytest.approx([1.0 - np.sqrt(0.975), np.sqrt(0.975)])
    assert ramp["ideal observer's holds, from"] == pytest.approx(0.025 ** (1 / 3))
    assert {**both, "kind": "ramp"} == ramp
    assert np.isnan(constant["interval holds"])
    assert "| ramp | 3 | 0.67 | 0.67 | 55.0 % | 0.50 (0.01 to 0.99) | 1.00 (0.16 to 1.00) |" in to_markdown(told)


def test_too_few_cases_are_refused(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--cases", "2"]) == 2
    assert capsys.readouterr().err == "twinbench.proof.histories: --cases is 2, must be at least 3: one of each kind\n"
