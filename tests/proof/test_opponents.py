"""Opponents, ablations and how the suite holds engines against each other."""

from __future__ import annotations

import dataclasses
import importlib
import importlib.util
import json
from collections.abc import Callable
from io import StringIO
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
import pytest
from rich.console import Console
from statsmodels.stats.contingency_tables import mcnemar
from statsmodels.stats.multitest import multipletests

from twinbench.bench.cli.main import main
from twinbench.common.errors import BadInput
from twinbench.data.recording import Recording
from twinbench.mismatch.model import load_simulator, whole_catalogue
from twinbench.mismatch.naming import decision, marginal, settle
from twinbench.mismatch.naming.decision import features, probability
from twinbench.mismatch.recordings import read_recordings
from twinbench.physics.simulator import Mechanism, Simulator
from twinbench.proof.concealed.case import missing
from twinbench.proof.concealed.engines import ENGINES, MAIN, chosen
from twinbench.proof.concealed.gates import COMPARED, engine_table, engines_as_markdown, wilson
from twinbench.proof.concealed.generate import Item, draw, write
from twinbench.proof.concealed.judge import COLUMNS, score
from twinbench.proof.concealed.machines import MACHINES
from twinbench.proof.concealed.paired import paired_as_markdown, paired_table
from twinbench.proof.concealed.plan import cases
from twinbench.proof.concealed.seal import Sealed, seal
from twinbench.proof.concealed.suite import Study, planned, run
from twinbench.proof.opponents import ablations
from twinbench.proof.opponents.library import Path as Along
from twinbench.proof.opponents.sindy import System, project, select, strong, weak

ROOT = Path(__file__).parents[2]
OPPONENTS = (
    "calibrate_only", "sindy", "sindy_projected", "weak_sindy", "weak_sindy_projected", "black_box", "bic_picker",
)  # fmt: skip
LEAK = "leak@h1_cm"
EVIDENCE = (
    "against_nothing", "against_unnamed", "beside", "wandering", "sds", "one_size", "one_form", "misfit",
    "held_gain",
)  # fmt: skip
"""What a finding's evidence holds."""


def engine(name: str) -> Callable[..., Any]:
    module, _, function = ENGINES[name].partition(":")
    return getattr(importlib.import_module(module), function)


class Given(NamedTuple):
    """A case as an engine gets it, and its truth."""

    truth: dict[str, Any]
    simulator: Simulator
    recordings: list[Recording]
    hold_out: list[Recording]
    catalogue: tuple[Mechanism, ...]

    def asked(self, name: str) -> dict[str, Any]:
        return engine(name)(self.simulator, self.recordings, hold_out=self.hold_out, catalogue=self.catalogue)

    def scored(self, verdict: dict[str, Any]) -> dict[str, Any]:
        sealed = seal(self.truth)
        return score(sealed, sealed.digest, verdict)


TANKS = dataclasses.replace(
    load_simulator(str(ROOT / "examples" / "two_tanks.py:TANKS")),
    calibrate=("pump_cm3_s_V", "hole1_cm2", "hole2_cm2"),
)


SHORT = {
    name: dataclasses.replace(m, seconds={part: tuple(0.4 * s for s in lengths) for part, lengths in m.seconds.items()})
    for name, m in MACHINES.items()
}


def given(folder: Path, cell: str, *effects: str, severity: float = 1.5) -> Given:
    case = draw(Item("0007", cell, "two_tanks", effects, severity), 3, SHORT)
    write(case, folder)
    names = (*case.public["train"], *case.public["held_out"])
    recordings = read_recordings([folder / f"{n}.csv" for n in names], TANKS)
    # A vessel that is slower than its simulator looks to a regression like one that leaks.
    listed = tuple(m for m in whole_catalogue(TANKS, (), 0.5) if not m.name.startswith("time_constant"))
    return Given(case.truth, TANKS, recordings[:3], recordings[3:], listed)


@pytest.fixture(scope="module")
def leaking(tmp_path_factory: pytest.TempPathFactory) -> Given:
    return given(tmp_path_factory.mktemp("leak"), "mechanism", LEAK)


@pytest.fixture(scope="module")
def answers(leaking: Given) -> dict[str, dict[str, Any]]:
    return {name: leaking.asked(name) for name in OPPONENTS if name != "bic_picker"}


def check_readable(case: Given, said: dict[str, Any]) -> None:
    """Does it hold what a judge reads, in the catalogue's own names?"""
    said = json.loads(json.dumps(said))
    assert said["says"].endswith(".")
    assert case.scored(said)["verdict"] in ("consistent", "missing physics", "sensor fault", "unexplained")
    held_out = {f["channel"] for f in said["fit"] if f["held_out"]}
    assert held_out == {v.name for v in case.simulator.outputs}
    catalogue = {m.name: m for m in case.catalogue}
    for f in said["findings"]:
        if f["mechanism"]:
            assert f["port"] == str(catalogue[f["mechanism"]].port)
            ((name, fitted),) = f["parameters"].items()
            assert name == catalogue[f["mechanism"]].parameters[0].name
            assert fitted["low"] <= fitted["value"] <= fitted["high"]


# What they say.


def test_a_judge_can_read_what_opponents_say(leaking: Given, answers: dict[str, dict[str, Any]]) -> None:
    for said in answers.values():
        check_readable(leaking, said)


def test_calibration_alone_names_nothing_and_gains_nothing(answers: dict[str, dict[str, Any]]) -> None:
    said = answers["calibrate_only"]
    assert (said["verdict"], said["findings"]) == ("consistent", [])
    assert all(f["rmse_before"] == f["rmse_after"] for f in said["fit"])


def test_the_black_box_predicts_and_names_nothing(leaking: Given, answers: dict[str, dict[str, Any]]) -> None:
    row = leaking.scored(answers["black_box"])
    assert (row["named"], row["set"]) == ("", "")
    assert row["gain"] > 0.3


def test_the_weak_form_names_a_plain_effect_once_the_parameters_are_projected_out(
    leaking: Given, answers: dict[str, dict[str, Any]]
) -> None:
    row = leaking.scored(answers["weak_sindy_projected"])
    assert row["named"] == LEAK
    assert row["gain"] > 0.5
    # Otherwise what the parameters took of it is blamed on something.
    assert leaking.scored(answers["weak_sindy"])["named"] != LEAK


def test_bic_names_something_even_where_nothing_is_missing(tmp_path: Path) -> None:
    clean = given(tmp_path, "clean", severity=0.0)
    said = clean.asked("bic_picker")
    check_readable(clean, said)
    assert clean.scored(said)["named"]
    assert not clean.asked("weak_sindy_projected")["findings"]


def test_sindy_cannot_name_a_sensor(tmp_path: Path) -> None:
    biased = given(tmp_path, "sensor", "sensor_bias@level2_cm")
    named = biased.scored(biased.asked("weak_sindy_projected"))["named"]
    assert named
    assert "sensor_" not in named


# SINDy's parts.


def along(n: int = 4000) -> Along:
    """x' = cos t, x = sin t."""
    time_s = np.linspace(0.0, 40.0, n)
    x, rate = np.sin(time_s)[:, None], np.cos(time_s)[:, None]
    none = np.zeros((n, 1, 0))
    return Along(time_s, x, rate, none, none, none)


@pytest.mark.parametrize("form", [strong, weak])
def test_both_forms_hold_for_a_path_that_obeys_its_equation(form: Callable[..., Any]) -> None:
    path = along()
    of_state, of_rate = form(path)
    expected = of_rate(path.rate)
    assert np.abs(expected).max() > 0.1
    np.testing.assert_allclose(of_state(path.x), expected, atol=1e-3 * np.abs(expected).max())


def systems(noise: float, seed: int = 0) -> list[System]:
    rng = np.random.default_rng(seed)
    found = []
    for _ in range(3):
        X, N = rng.normal(size=(300, 15)), rng.normal(size=(300, 2))
        y = 2.0 * X[:, 3] - 0.5 * X[:, 8] + noise * rng.normal(size=300)
        found.append(System(y, X, N))
    return found


def test_thresholding_keeps_the_terms_there_are() -> None:
    kept = select(systems(0.3))
    assert set(kept) == {3, 8}
    for j, true in ((3, 2.0), (8, -0.5)):
        size, _, sd = kept[j]
        assert abs(size - true) < 4.0 * sd < 0.2
    for seed in range(5):
        assert select([s._replace(y=s.N[:, 0]) for s in systems(0.0, seed)]) == {}


def test_projection_takes_out_what_the_calibration_can_change() -> None:
    raw = systems(0.0)
    clean = project([s._replace(y=s.y + 5.0 * s.N[:, 1]) for s in raw])
    N, y, X = (np.concatenate([getattr(s, name) for s in clean]) for name in "NyX")
    assert np.abs(N.T @ y).max() < 1e-8 * np.abs(y).sum()
    assert np.abs(N.T @ X).max() < 1e-8 * np.abs(X).sum()
    assert {j: round(size, 6) for j, (size, _, _) in select(clean).items()} == {3: 2.0, 8: -0.5}


# The registry.


def test_every_engine_of_the_registry_is_there() -> None:
    assert all(callable(engine(name)) for name in ENGINES)
    assert set(chosen("all")) == set(ENGINES)
    assert list(chosen("oracle, twinbench")) == ["oracle", "twinbench"]
    assert set(OPPONENTS) < set(ENGINES)


def test_every_engine_is_asked_by_the_name_that_is_installed() -> None:
    assert all(where.startswith("twinbench.") for where in ENGINES.values())


def test_without_the_learnt_decision_the_evidence_alone_decides() -> None:
    rule = ablations.EVIDENCE_ALONE
    assert probability(rule.weights, features(dict.fromkeys(EVIDENCE, 1.0))) == pytest.approx(1.0)
    assert rule.say_name == pytest.approx(0.95)
    assert rule.say_set == 0.0


@pytest.mark.parametrize(
    ("name", "left_out"),
    [
        ("no_learnt_decision", (marginal.DISCREPANCY_PCT, settle.TURNS, ablations.EVIDENCE_ALONE)),
        ("no_discrepancy", (ablations.EXACT_PCT, settle.TURNS, decision.learnt_rule())),
        ("no_relinearisation", (marginal.DISCREPANCY_PCT, 1, decision.learnt_rule())),
    ],
)
def test_an_ablation_leaves_one_thing_out_and_puts_it_back(
    name: str, left_out: tuple[object, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    def now(*asked: object) -> tuple[object, ...]:
        return marginal.DISCREPANCY_PCT, settle.TURNS, decision.learnt_rule()

    monkeypatch.setattr(ablations, "diagnose", now)
    before = now()
    assert engine(name)(None, []) == left_out
    assert before == now()


def test_every_engine_is_ours_an_opponent_or_an_ablation() -> None:
    ablated = {name for name, where in ENGINES.items() if ".ablations:" in where}
    assert set(ENGINES) == {*MAIN, *OPPONENTS, *ablated}
    assert len(ablated) == 3


def test_an_unknown_engine_is_refused_in_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["prove", "--engines", "twinbench,magic", "--out", str(tmp_path / "out")]) == 2
    said = capsys.readouterr().err.strip()
    assert said.count("\n") == 0
    assert "engine 'magic' is not known" in said
    assert "weak_sindy_projected" in said
    assert not (tmp_path / "out").exists()


def test_sindy_without_its_library_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    with pytest.raises(BadInput, match=r"pip install 'twinbench\[opponents\]'"):
        chosen("sindy")
    assert chosen("black_box")


# Side by side.


def rows(named: dict[str, list[str]]) -> pd.DataFrame:
    """Rows of engines that say one name per case; the truth is always a leak."""
    texts = dict.fromkeys(("verdict", "set", "probability", "ports", "inexact"), "")
    blank = dict.fromkeys(COLUMNS, np.nan) | texts | {"machine": "two_tanks", "kind": "tuned", "detectable": True}
    return pd.DataFrame(
        [
            blank
            | {
                "case": f"{i:04d}",
                "cell": "mechanism",
                "severity": 1.0,
                "background_pct": 0.0,
                "truth": LEAK,
                "class": LEAK,
                "outcome": {LEAK: "name", "": "abstained"}.get(name, "wrong"),
                "port_truth": "balance:h1_cm",
                "named": name,
                "engine": e,
                "gain": 0.9 if name else np.nan,
            }
            for e, names in named.items()
            for i, name in enumerate(names)
        ]
    )


def test_engines_are_compared_on_the_cases_that_all_answered() -> None:
    table = engine_table(rows({"ours": [LEAK, LEAK, LEAK, "x"], "theirs": [LEAK, "x", ""]})).set_index("engine")
    assert table["cases"].tolist() == [3, 3]
    assert table["by_name"].tolist() == [1.0, pytest.approx(1 / 3)]
    assert (table.loc["theirs", "by_name_low"], table.loc["theirs", "by_name_high"]) == wilson(1, 3)
    assert table["confidently_wrong"].tolist() == [0.0, pytest.approx(1 / 3)]
    assert table["gain"].tolist() == [0.9, 0.9]
    silent = engine_table(rows({"ours": [LEAK], "silent": [""]})).set_index("engine")
    assert silent["gain"].tolist() == [0.9, 0.0]
    said = engines_as_markdown(table.reset_index())
    assert "The 3 cases that every engine answered" in said
    assert "| theirs | 0.33 (0.06 to 0.79) |" in said
    assert "false name" in said.splitlines()[2]
    assert all(f"{column}_cases" in table for column in COMPARED)


def test_engines_are_told_apart_case_by_case() -> None:
    """By McNemar's test with Holm's correction, as statsmodels has them."""
    ours = [LEAK] * 12 + [""] * 6 + [LEAK]
    others = {"silent": [""] * 18, "rash": [LEAK] * 10 + ["x"] * 8}
    table = paired_table(rows({"ours": ours} | others), "ours").set_index("engine")
    assert table.loc["rash", ["told_alone", "told_first", "wrong_alone", "wrong_first"]].tolist() == [0, 2, 8, 0]
    counts = [(0, 12), (0, 0), (0, 2), (8, 0)]
    plain = [mcnemar([[0, a], [b, 0]], exact=True).pvalue for a, b in counts]
    held = multipletests(plain, method="holm")[1]
    assert table[["told_p", "wrong_p"]].to_numpy().ravel() == pytest.approx(held)
    said = paired_as_markdown(table.reset_index(), "ours")
    assert "told by it alone | by ours alone" in said
    assert f"| silent | 0 | 12 | {held[0]:.2g} | 0 | 0 | 1 |" in said


def test_what_nothing_can_tell_is_not_told_by_anybody() -> None:
    hidden = rows({"ours": [LEAK], "rash": ["x"]}).assign(detectable=False)
    found = paired_table(hidden, "ours").iloc[0]
    assert (found["told_first"], found["wrong_alone"]) == (0, 1)


# The run.


@pytest.fixture
def counting(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Engines that write their names down."""
    (tmp_path / "engines").mkdir()
    (tmp_path / "engines" / "counting.py").write_text("""
import os
def answer(name):
    with open(os.environ["COUNTED"], "a") as log:
        log.write(name + "\\n")
    return {"verdict": "consistent", "findings": [], "fit": []}
def one(simulator, recordings, hold_out=(), catalogue=None):
    return answer("one")
def two(simulator, recordings, hold_out=(), catalogue=None):
    return answer("two")
""")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path / "engines"))
    monkeypatch.setenv("COUNTED", str(tmp_path / "counted"))
    return tmp_path / "counted"


def test_an_engine_that_joins_later_is_asked_alone_under_the_same_seal(counting: Path, tmp_path: Path) -> None:
    out, console = tmp_path / "proof", Console(file=StringIO())
    one, two = {"twinbench": "counting:one"}, {"other": "counting:two"}
    run(Study(1, 1, one), out, console, jobs=1)
    sealed = json.loads((out / "seals.json").read_text())
    run(Study(1, 1, one | two), out, console, jobs=1)
    assert "answers: done in" in console.file.getvalue()
    assert counting.read_text().split() == ["one", "two"]
    assert json.loads((out / "seals.json").read_text()) == sealed
    opened = json.loads((out / "cases" / "0000" / "truth.json").read_text())
    assert Sealed(**opened).digest == sealed["0000"]
    assert pd.read_csv(out / "cases.csv")["engine"].tolist() == ["twinbench", "other"]
    assert pd.read_csv(out / "engines.csv")["engine"].tolist() == ["twinbench", "other"]
    assert pd.read_csv(out / "paired.csv")["engine"].tolist() == ["other"]
    # A case whose truth was off the disk when its run was killed begins anew.
    (item,) = cases(1, 1)
    assert missing(item, 1, out, one | two) == []
    (out / "cases" / "0000" / "truth.json").unlink()
    assert missing(item, 1, out, one | two) == ["twinbench", "other"]


def test_opponents_get_cases_from_all_over_the_plan_and_ours_all() -> None:
    asked = [
        list(engines) for _, engines in planned(Study(5, 1, chosen("twinbench,sindy,oracle,no_learnt_decision"), 3))
    ]
    everyone, ours = ["twinbench", "sindy", "oracle", "no_learnt_decision"], ["twinbench", "oracle"]
    assert asked == [everyone, ours, everyone, ours, everyone]
    assert len(planned(Study(5, 1, chosen("black_box"), 2))) == 2
    assert all("sindy" in engines for _, engines in planned(Study(5, 1, chosen("twinbench,sindy"))))
    for n, few, option in ((5, 0, "--opponent-cases"), (0, None, "--cases")):
        with pytest.raises(BadInput, match=f"{option} is 0, must be at least 1"):
            planned(Study(n, 1, ENGINES, few))
