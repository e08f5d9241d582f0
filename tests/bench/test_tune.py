"""Tuning: the best of so many trials on the validation sequences, begun from the defaults, and resumable."""

from __future__ import annotations

import json
import tomllib
from pathlib import Path

import pandas as pd
import pytest
from helpers.tiny_run import parts, twinbench, write_estimator, write_profile

from twinbench.bench.profile import load_profile
from twinbench.bench.registry import find
from twinbench.bench.roster import LABELS
from twinbench.bench.statistics.subject import PAPERS
from twinbench.bench.tune import FAILED, coverages_of, errors_of, merit, rates_of_trials

RESULTS = Path(__file__).parents[2] / "results/tuning"


def tunable(folder, space: str = "(0.6, 1.7)", **lines: str) -> str:
    """The tiny estimator with its scale to be searched for; 1 is right."""
    spec = write_estimator(folder, "steady", scale=1.7, **lines)
    text = Path(spec).read_text()
    space = f'    search_space = {{"scale": {space}}}\n    implementations'
    (folder / "steady.py").write_text(text.replace("    implementations", space))
    return spec


def test_merit_is_the_geometric_mean_of_three_errors():
    health, states, forecasts = errors_of(PAPERS)
    means = dict.fromkeys(health, 8.0)
    means |= dict(zip(states, (0.5, 1.0, 1.5), strict=True)) | dict(zip(forecasts, (1.0, 2.0, 3.0), strict=True))
    assert merit(PAPERS, means) == pytest.approx((8.0 * 1.0 * 2.0) ** (1 / 3))
    assert merit(PAPERS, {**means, coverages_of(PAPERS)[0]: 10.0}) == merit(PAPERS, means), (
        "intervals are calibrated afterwards"
    )


def test_trials_begin_with_the_defaults_go_on_where_they_stopped_and_leave_a_profiles_section(tmp_path, capsys):
    profile, out, spec = write_profile(tmp_path), tmp_path / "tuning", tunable(tmp_path)
    arguments = ("tune", spec, "--profile", profile, "--out", out, "--trials")
    assert twinbench(*arguments, 2) == 0
    assert (
        f"to do: 2 trials; the cost is not known: nothing of the kind is in {out / 'steady.csv'}"
        in capsys.readouterr().err
    )
    first = pd.read_csv(out / "steady.csv")
    assert first["scale"][0] == 1.7
    kept = parts(out)
    first.assign(seconds=240.0).to_csv(out / "steady.csv", index=False)
    assert twinbench(*arguments, 7) == 0
    said = capsys.readouterr()
    assert f"to do: 5 trials, about 20 core-minutes by {out / 'steady.csv'}" in said.err
    table = pd.read_csv(out / "steady.csv")
    assert len(table) == 7
    pd.testing.assert_frame_equal(table[:2], first)
    assert kept.items() <= parts(out).items()
    best = tomllib.loads((out / "steady.toml").read_text())["settings"]["steady"]
    assert best["scale"] == pytest.approx(table["scale"][table["merit"].argmin()], rel=1e-3)
    assert table["merit"].min() < table["merit"][0]
    assert f"scale = {best['scale']!r}" in said.out
    about = json.loads((out / "steady.json").read_text())
    assert about["trials"] == 7
    assert "commit" in about
    more = write_profile(tmp_path, more=(out / "steady.toml").read_text())
    assert load_profile(str(more)).settings["steady"] == best


@pytest.mark.parametrize(
    ("profile", "online", "rounds"),
    [
        ("paper", True, {"third", "fourth", "seventh"}),
        ("tuning", False, {"first", "second"}),
        ("motor", True, {"motor"}),
    ],
)
def test_earlier_rounds_of_the_same_profile_and_kind_say_what_a_trial_costs(
    tmp_path, monkeypatch, profile, online, rounds
):
    monkeypatch.chdir(RESULTS.parents[1])
    names = ["gru_kf", "nominal_imm"] if profile == "paper" else ["gru_kf"]
    rates = rates_of_trials(names, load_profile(profile), tmp_path, online)
    assert rounds <= {table.parent.name for table, known in rates.items() if known}
    ours = pd.read_csv(next(table for table, known in rates.items() if known))["seconds"].mean()
    assert next(known for known in rates.values() if known) == {("gru_kf",): pytest.approx(ours)}


def test_of_choices_each_is_trained_once(tmp_path):
    profile, out, spec = write_profile(tmp_path), tmp_path / "tuning", tunable(tmp_path, "[0.6, 1.0, 1.7]")
    assert twinbench("tune", spec, "--profile", profile, "--out", out, "--trials", 8) == 0
    table = pd.read_csv(out / "steady.csv")
    assert set(table["scale"]) <= {0.6, 1.0, 1.7}
    assert sum("/fit/" in name for name in parts(out)) == table["scale"].nunique() < 8
    assert tomllib.loads((out / "steady.toml").read_text())["settings"]["steady"]["scale"] == 1.0


def test_online_settings_alone_need_one_training(tmp_path):
    spec = Path(tunable(tmp_path))
    text = spec.read_text().replace("settings = {", 'online = frozenset({"level"})\n    settings = {"level": 1.0, ')
    spec.write_text(text.replace("search_space = {", 'search_space = {"level": (0.5, 2.0), '))
    out = tmp_path / "tuning"
    arguments = ("tune", spec, "--profile", write_profile(tmp_path), "--out", out, "--trials", 4, "--online")
    assert twinbench(*arguments) == 0
    table = pd.read_csv(out / "steady.csv")
    assert "scale" not in table
    assert table["level"].nunique() == 4
    assert sum("/fit/" in name for name in parts(out)) == 1


def test_settings_that_fail_are_a_bad_trial_and_no_end(tmp_path):
    spec = tunable(tmp_path, fit="assert self.config['scale'] > 1.5, 'too small'")
    out = tmp_path / "tuning"
    assert twinbench("tune", spec, "--profile", write_profile(tmp_path), "--out", out, "--trials", 5) == 0
    table = pd.read_csv(out / "steady.csv")
    assert table["merit"].max() == FAILED
    assert table["failed"].dropna().str.contains("too small").all()
    assert table["merit"].min() < FAILED


ROUNDS = {
    **dict.fromkeys(("first", "second", "third", "fourth", "fifth"), 20),
    **dict.fromkeys(("sixth", "seventh", "modes/compressor"), 12),
}
"""The rounds of tuning, in their order, and how many trials each estimator had in them."""


@pytest.mark.parametrize("name", sorted(set(LABELS) - {"twin"}))
def test_the_settings_are_those_that_the_last_round_of_trials_chose(name):
    best = {}
    for part, trials in ROUNDS.items():
        path = RESULTS / part / f"{name}.toml"
        if path.is_file():
            best |= tomllib.loads(path.read_text())["settings"][name]
            assert len(pd.read_csv(path.with_suffix(".csv"))) == trials
    own = find(name).settings if best else {}  # some of earlier rounds are no settings any more
    assert {setting: own[setting] for setting in best if setting in own} == {s: v for s, v in best.items() if s in own}


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (("nominal_ekf_mended", "--trials", 0), "--trials is 0, must lie in [1, 10000]"),
        (("nominal_ekf_mended", "--trials", 10**400), "--trials is 1000"),
        (("untunable",), "untunable has no search space"),
        (("nominal_ekf_mended", "nobody"), "no estimator 'nobody'"),
    ],
)
def test_what_cannot_be_tuned_is_said_in_one_line(tmp_path, capsys, arguments, says):
    name, *rest = arguments
    spec = write_estimator(tmp_path, "untunable") if name == "untunable" else name
    assert twinbench("tune", spec, *rest, "--profile", write_profile(tmp_path), "--out", tmp_path / "t") == 2
    assert says in capsys.readouterr().err
    assert not (tmp_path / "t").exists()


@pytest.mark.parametrize(
    ("space", "settings", "says"),
    [
        ("(0, 1.7)", "", "the search space of scale is (0, 1.7), must be (low, high) with 0 < low < high"),
        ("(1.7, float('inf'))", "", "the search space of scale is (1.7, inf), must be"),
        ("'ab'", "", "the search space of scale is 'ab', must be"),
        ("(0.1, 0.2)", "", "the search space of scale is 0.1 to 0.2, and the profile's 1.7 is outside"),
        ("[1.0, 2.0]", "", "the search space of scale is [1.0, 2.0], and the profile's 1.7 is none of it"),
        ("(0.6, 1.7)", "[settings.steady]\nscale = nan\n", "the profile's nan is outside"),
        ("(0.6, 1.7)", "[settings.steady]\nscale = 'x'\n", "scale is 'x', must be a number"),
        ("(0.6, 1.7)", "[settings.steady]\ncolour = 1\n", "colour"),
        ("(0.6, 1.7)", "[settings.nobody]\nx = 1\n", "settings for 'nobody', which is no estimator"),
    ],
)
def test_a_search_that_cannot_begin_is_said_in_one_line(tmp_path, capsys, space, settings, says):
    spec, profile = tunable(tmp_path, space), write_profile(tmp_path, more=settings)
    assert twinbench("tune", spec, "--profile", profile, "--out", tmp_path / "t", "--trials", 1) == 2
    assert says in capsys.readouterr().err
    assert not (tmp_path / "t").exists()
