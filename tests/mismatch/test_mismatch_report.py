"""The report of a diagnosis: the file by its schema, the page complete, offline, and honest when nothing is named."""

from __future__ import annotations

import dataclasses
import itertools
import json
import math
import re
from pathlib import Path

import matplotlib.image
import numpy as np
import pytest
from helpers.documents import check_file
from helpers.oven import LOSS, OVEN, loss_found, oven_diagnosed, page, write

from twinbench.common.documents import to_json
from twinbench.mismatch import Verdict
from twinbench.mismatch.began import Onset
from twinbench.mismatch.report.figure_rank import evidence, labels
from twinbench.mismatch.report.figure_where import equally_full, regime_bounds
from twinbench.mismatch.report.figures import draw
from twinbench.mismatch.report.hypotheses import CHOSEN, REFUSED, hypotheses
from twinbench.mismatch.report.replays import Replay, level, most_telling, replays, window
from twinbench.mismatch.tracks import Track
from twinbench.mismatch.verdict import conclude

FIGURES = {
    "fit_held_out",
    "fit_learnt",
    "where_in_time",
    "where_in_regime",
    "where_by_port",
    "sizes_over_time",
    "hypotheses",
}


@pytest.fixture(scope="module")
def named() -> Verdict:
    verdict = loss_found()
    assert [m.name for m in verdict.mechanisms] == [LOSS.name]
    # As an onset would be: the figures and the page have to show it.
    onsets = (Onset("monday", "from", 60.0, 60.0), Onset("tuesday", "throughout", None, None))
    regime = "heater_C > 120 and probe_C <= 250.5"
    late = dataclasses.replace(verdict.findings[0], since_s=60.0, onsets=onsets, regime=regime)
    return dataclasses.replace(verdict, findings=(late,))


@pytest.fixture(scope="module")
def abstaining(named: Verdict) -> Verdict:
    d = named.diagnosis
    unsaid = tuple(dataclasses.replace(c, names=()) for c in d.claims)
    says = "it makes the held-out errors of probe_C grow"
    return conclude(dataclasses.replace(d, mended=None, held_after=None, claims=unsaid, refused=says))


@pytest.fixture(scope="module")
def consistent() -> Verdict:
    return oven_diagnosed(OVEN)


@pytest.fixture(scope="module")
def folders(
    named: Verdict, abstaining: Verdict, consistent: Verdict, tmp_path_factory: pytest.TempPathFactory
) -> dict[str, Path]:
    out = {}
    for name, verdict in (("named", named), ("abstaining", abstaining), ("consistent", consistent)):
        out[name] = tmp_path_factory.mktemp(name)
        write(verdict, out[name])
    return out


def test_bars_of_hypotheses_say_how_far_behind_the_likeliest_they_are(named: Verdict) -> None:
    first, *others = [text.get_text() for text in evidence(named.diagnosis).axes[0].texts]
    assert float(first.replace(",", "")) > 0.0
    assert others
    assert all(text.endswith(" behind") for text in others)


@pytest.mark.parametrize("which", ["named", "abstaining", "consistent"])
def test_the_json_follows_its_schema(folders: dict[str, Path], which: str) -> None:
    check_file(folders[which] / "verdict.json")
    found = json.loads((folders[which] / "verdict.json").read_text())
    assert found["verdict"] == {"named": "missing physics", "abstaining": "unexplained"}.get(which, "consistent")
    assert {fit["held_out"] for fit in found["fit"]} == {True, False}


def test_the_json_has_null_for_what_is_no_number(named: Verdict) -> None:
    fit = named.fit[0]._replace(rmse_before=math.nan, rmse_after=np.float64(np.inf))
    written = to_json(dataclasses.replace(named, fit=(fit,)).to_dict())
    found = json.loads(written, parse_constant=pytest.fail)["fit"][0]
    assert found["rmse_before"] is None
    assert found["rmse_after"] is None


@pytest.mark.parametrize("which", ["named", "abstaining", "consistent"])
def test_the_page_needs_nothing_but_itself(folders: dict[str, Path], which: str) -> None:
    text = page(folders[which])
    assert not re.search(r"<(script|link|img|iframe|object|embed)\b|@import|\bsrc=", text)
    for target in re.findall(r"""(?:href|url)\s*[=(]\s*["']?([^"')>]+)""", text):
        assert target.startswith("#"), target
    assert not re.findall(r"https?://(?!www\.w3\.org/)", text)
    ids = re.findall(r'\bid="([^"]+)"', text)
    assert len(ids) == len(set(ids))
    assert set(re.findall(r"""(?:href="|url\()#([^")]+)""", text)) <= set(ids)
    assert "nan" not in re.sub(r"<[^>]*>", " ", text).lower().split()


def test_every_figure_in_both_formats(folders: dict[str, Path]) -> None:
    drawn = {p.name for p in (folders["named"] / "figures").iterdir()}
    assert drawn == {f"{name}.{suffix}" for name in FIGURES for suffix in ("png", "svg")}
    for path in (folders["named"] / "figures").glob("*.png"):
        assert matplotlib.image.imread(path)[..., :3].std() > 0.01, f"{path} is blank"


def test_the_page_says_what_was_found(folders: dict[str, Path], named: Verdict) -> None:
    text = page(folders["named"])
    assert "wall_loss&lt;1&gt;" in text
    assert "heat goes through the wall &amp; out" in re.sub("H", "h", text.split("<h1")[1].split("</h1>")[0])
    for said in ("heater_C &gt; 120", "tau_s", "sunday (360 samples", "sensor_bias@probe_C"):
        assert said in text, said
    assert "Not drawn" not in text


def test_nothing_is_drawn_of_what_is_not_there(folders: dict[str, Path]) -> None:
    text = page(folders["consistent"])
    assert "Not drawn: nothing was found, so there is nothing to locate" in text
    assert not (folders["consistent"] / "figures" / "where_by_port.svg").exists()
    assert "Nothing was named." in text
    assert "None: no effect had to be added." in text
    assert list(json.loads((folders["consistent"] / "verdict.json").read_text())["findings"]) == []


def test_what_was_refused_is_marked_so(folders: dict[str, Path], abstaining: Verdict, named: Verdict) -> None:
    assert hypotheses(named.diagnosis)[0].standing == CHOSEN
    best = hypotheses(abstaining.diagnosis)[0]
    assert (best.names, best.standing) == ((LOSS.name,), REFUSED)
    assert best.gain > 0.0
    text = page(folders["abstaining"])
    assert "it makes the held-out errors of probe_C grow" in text
    assert "simulator after" not in text
    assert all(r.after is None for r in replays(abstaining.diagnosis))


def test_sets_of_many_names_are_told_by_what_differs() -> None:
    many = tuple(f"quadratic_leak@level_{k}_cm" for k in range(6))
    other = "overflow@level_0_cm"
    told = labels([many, many[1:], (other, *many[1:]), (*many, other), (other,), ("nothing",)])
    assert told[0] == "A: quadratic_leak@level_0_cm + 5 more"
    assert told[1] == "A less quadratic_leak@level_0_cm"
    assert told[2] == "A less quadratic_leak@level_0_cm, with overflow@level_0_cm"
    assert told[3] == "A with overflow@level_0_cm"
    assert told[4:] == [other, "nothing"]
    few = tuple(f"sensor_saturation@level_{k}_cm" for k in range(4))
    told = labels([many, (*many[2:], *few), (*many[3:], *few), (*many[:1], *few), (*many[1:2], *few)])
    assert len(set(told)) == len(told)
    assert max(map(len, told)) < 90
    assert labels([many[:2], many[:1]]) == [" + ".join(many[:2]), many[0]]


def test_a_recording_without_readings_is_said_to_be_so(named: Verdict) -> None:
    d = named.diagnosis
    assert d.held_before is not None
    empty = d.held_before._replace(residuals=[np.full_like(r, np.nan) for r in d.held_before.residuals])
    first = next(draw(dataclasses.replace(named, diagnosis=dataclasses.replace(d, held_before=empty))))
    assert (first.name, first.figure, first.missing) == ("fit_held_out", None, "no output was measured in it")


def test_writing_again_gives_the_same(folders: dict[str, Path], named: Verdict, tmp_path: Path) -> None:
    write(named, tmp_path)
    assert page(tmp_path) == page(folders["named"])


def test_what_is_added_brings_the_error_down_to_the_noise(named: Verdict) -> None:
    shown = replays(named.diagnosis)
    assert [(r.track.name, r.held_out) for r in shown] == [("sunday", True), ("monday", False), ("tuesday", False)]
    for r in shown:
        assert r.after is not None
        assert level(r.before, np.array([0.3])) > 2.0
        assert level(r.after, np.array([0.3])) == pytest.approx(1.0, abs=0.15)


def test_the_most_telling_recording_outputs_and_window() -> None:
    """By hand: two outputs, the second in units ten times as fine, the third never measured."""
    time_s = np.arange(50.0)
    track = Track("t", time_s, np.zeros((50, 1)), np.zeros((50, 3)), np.arange(50), np.zeros((50, 3)))
    before = np.ones((50, 3)) * [1.0, 20.0, np.nan]
    before[30:35, 0] = 4.0
    quiet, loud = Replay(track, True, before / 2.0, None), Replay(track, True, before, None)
    replay, channels = most_telling([quiet, loud], np.array([1.0, 10.0, 1.0]))
    assert replay is loud
    assert channels == [1, 0]
    assert window(loud, 0, 5) == slice(30, 35)
    assert window(loud, 0, 80) == slice(0, 50)
    added = loud._replace(after=before * [1.0, 0.5, 1.0])
    assert most_telling([quiet, added], np.array([1.0, 10.0, 1.0]))[1][0] == 1
    assert level(before, np.array([1.0, 20.0, 1.0])) == pytest.approx(np.sqrt((1.0 + (45 + 5 * 16) / 50) / 2))


def test_bins_hold_equal_shares_and_keep_equal_values_together() -> None:
    values = np.random.default_rng(0).normal(size=803)
    values[:3] = np.nan
    groups = equally_full(values, 8)
    assert [len(g) for g in groups] == [100] * 8
    assert all(values[a].max() <= values[b].min() for a, b in itertools.pairwise(groups))
    assert [len(g) for g in equally_full(np.array([2.0, 1.0, 2.0]))] == [1, 2]
    assert sum(len(g) for g in equally_full(np.repeat([0.0, *range(1, 20)], [500, *[1] * 19]))) == 519


def test_bounds_are_read_from_the_words_of_a_regime() -> None:
    names = ["p", "N_rpm", "oil p"]
    assert regime_bounds("N_rpm > 1400 and p <= -3.5e-2", names) == [("N_rpm", 1400.0), ("p", -0.035)]
    assert regime_bounds("oil p > 3", names) == [("oil p", 3.0)]
    assert regime_bounds("", names) == []
