"""What pages show of a committed run follows from its scores: a report made anew says the same."""

from __future__ import annotations

import re
import shutil
from pathlib import Path

import pandas as pd
import pytest
from helpers.tiny_run import run_here

from twinbench.bench.compare.page import says
from twinbench.bench.report.provenance import bullets
from twinbench.bench.report.write import write_report

RESULTS = Path(__file__).parents[2] / "results"
ROUND_OFF = 1e-6
"""Relative deviation of a table's numbers that another processor may bring."""
NUMBER = re.compile(r"\d[\d,]*\.?\d*")


def alike(made: str, committed: str) -> bool:
    """The same words, and the same numbers but for one in the last digit: a 5 that is rounded may go either way."""
    if NUMBER.sub("#", made) != NUMBER.sub("#", committed):
        return False
    pairs = zip(NUMBER.findall(made), NUMBER.findall(committed), strict=True)
    return all(one == other or abs(_value(one) - _value(other)) < 1.5 * _last_digit(one, other) for one, other in pairs)


def _value(text: str) -> float:
    return float(text.replace(",", ""))


def _last_digit(*texts: str) -> float:
    return max(10.0 ** -len(text.partition(".")[2]) for text in texts)


def test_a_word_or_more_than_a_rounded_digit_makes_texts_differ():
    assert alike("errs 92.3 % (88.5–95.2)", "errs 92.2 % (88.5–95.2)")
    assert not alike("errs 92.3 %", "errs 92.1 %")
    assert not alike("errs 92.3 %", "err 92.3 %")


def copied(name: str, folder: Path) -> Path:
    """A committed run without its figures, to report on anew."""
    ignored = shutil.ignore_patterns("figures", "report.html")
    return Path(shutil.copytree(RESULTS / name, folder / name, ignore=ignored))


@pytest.mark.parametrize(
    "name", ["paper", *(pytest.param(name, marks=pytest.mark.slow) for name in ("motor", "two_tanks"))]
)
def test_a_report_made_anew_says_what_is_committed(name, tmp_path, monkeypatch):
    run_here(monkeypatch)
    out = copied(name, tmp_path)
    write_report(out)
    made = sorted(path.relative_to(out) for path in out.rglob("*.md"))
    assert len(made) > 10
    for path in made:
        assert alike((out / path).read_text(), (RESULTS / name / path).read_text()), path
    for path in (out / "tables").glob("*.csv"):
        committed = pd.read_csv(RESULTS / name / "tables" / path.name)
        pd.testing.assert_frame_equal(pd.read_csv(path), committed, rtol=ROUND_OFF)


@pytest.mark.parametrize("name", ["cascaded_tanks", "train_compressor"])
def test_what_is_said_of_recordings_follows_from_their_scores(name):
    folder = RESULTS / "compare" / name
    said = bullets(*says(pd.read_csv(folder / "scores.csv")))
    assert alike(said, (folder / "answer.md").read_text())


def test_a_sentence_that_does_not_follow_from_the_scores_is_noticed(tmp_path, monkeypatch):
    run_here(monkeypatch)
    out = copied("motor", tmp_path)
    scores = pd.read_csv(out / "scores.csv")
    worse = scores["estimator"].eq("deeponet_kalman") & scores["metric"].eq("health_life_pct")
    scores.assign(value=scores["value"].where(~worse, 3.0 * scores["value"])).to_csv(out / "scores.csv", index=False)
    write_report(out)
    assert not alike((out / "answer.md").read_text(), (RESULTS / "motor" / "answer.md").read_text())
