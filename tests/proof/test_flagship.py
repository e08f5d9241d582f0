"""The flagship study: asked blindly, judged rightly, resumable."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import replace
from io import StringIO
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from flagship_short import recorded
from rich.console import Console

from twinbench.common.errors import BadInput
from twinbench.data.batch import Batch
from twinbench.machines.compressor import CHANNELS, HEALTH
from twinbench.mismatch.model import model_toml
from twinbench.physics.mechanisms import CATALOGUE
from twinbench.physics.nominal import NOMINAL
from twinbench.proof.concealed.seal import BrokenSeal
from twinbench.proof.flagship import suite
from twinbench.proof.flagship.gates import gate_table
from twinbench.proof.flagship.judge import COLUMNS, names
from twinbench.proof.flagship.measure import Errors
from twinbench.proof.flagship.plant import EFFECTS, UNKNOWN, Item, Plant, draw
from twinbench.proof.flagship.record import HELD_OUT, PROOF, TRAINING

# Judging.


def said(*findings: tuple[str, tuple[str, ...], float, float, float]) -> dict[str, Any]:
    """A verdict: name, what it cannot be told from, value, low and high of its K."""
    listed = [
        {
            "kind": "missing physics",
            "mechanism": name,
            "indistinguishable_from": list(others),
            "port": "flux:W_W",
            "parameters": {"K": {"value": value, "low": low, "high": high}},
        }
        for name, others, value, low, high in findings
    ]
    return {"verdict": "missing physics", "seconds": 9.0, "findings": listed}


TRUTH = {"effects": [{"name": n, "sizes": {"K": [0.05, 0.01]}} for n in ("a", "b", "c", "d")]}


def test_names_are_right_alone_or_in_a_set_of_three_and_the_rest_is_missed() -> None:
    verdict = said(
        ("a", (), 0.06, 0.04, 0.07),
        ("x", (), 1.0, 0.9, 1.1),
        ("y", ("b",), 1.0, 0.9, 1.1),
        ("c", ("u", "v", "w"), 1.0, 0.9, 1.1),
        ("p", ("q",), 1.0, 0.9, 1.1),
    )
    assert names(TRUTH, verdict) == {
        "named_right": "a",
        "named_wrong": "x",
        "sets": "y|b+c|u|v|w+p|q",
        "sets_right": "y|b",
        "missed": "c+d",
        "amplitude_error_pct": "25.0",
        "amplitude_covered": "1",
    }


def test_a_verdict_without_findings_misses_everything() -> None:
    found = names(TRUTH, {"verdict": "failed", "findings": []})
    assert found["missed"] == "a+b+c+d"
    assert found["named_right"] == found["named_wrong"] == found["amplitude_error_pct"] == ""


def table(*rows: dict[str, Any]) -> pd.DataFrame:
    blank = dict.fromkeys(COLUMNS, "") | {c: np.nan for c in COLUMNS if c.endswith(("_share", "seconds"))}
    return pd.DataFrame([blank | row for row in rows], columns=list(COLUMNS))


def gates(*rows: dict[str, Any]) -> dict[str, tuple[float, int, Any]]:
    return {g["gate"]: (g["measured"], g["cases"], g["met"]) for _, g in gate_table(table(*rows)).iterrows()}


def test_gates_count_what_they_say() -> None:
    plain = {"cell": "plain", "truth": "a+b", "verdict": "missing physics"}
    found = gates(
        plain
        | {
            "parameter_share": 1.3,
            "open60_share": 0.95,
            "named_right": "a",
            "sets": "b|x",
            "seconds": 10.0,
            "amplitude_error_pct": "4.0",
            "amplitude_covered": "1",
        },
        plain
        | {
            "parameter_share": 0.7,
            "open60_share": 0.85,
            "named_right": "a+b",
            "named_wrong": "x",
            "amplitude_error_pct": "8.0+6.0",
            "amplitude_covered": "0+1",
            "seconds": 30.0,
        },
        {"cell": "nominal", "verdict": "consistent"},
        {"cell": "nominal", "named_wrong": "x"},
        {"cell": "left_out", "verdict": "incomplete"},
        {"cell": "left_out", "verdict": "unexplained"},
        {"cell": "left_out", "verdict": "missing physics", "named_wrong": "x"},
    )
    assert found["gap closed, parameter error, mean"] == (pytest.approx(0.85), 2, True)
    assert found["gap closed, parameter error, worst"] == (0.7, 2, True)
    assert found["gap closed, 60 s open loop, worst"] == (0.85, 2, True)
    assert found["wrong single names, of all"] == (0.25, 4, False)
    assert found["effects named alone or in a set of at most three"] == (1.0, 4, True)
    assert found["nominal model's own recordings: single names"] == (0.5, 2, False)
    assert found["effects taken out of the catalogue: says incomplete"] == (pytest.approx(2 / 3), 3, False)
    assert found["error of the amplitude of single names, median, %"][:2] == (6.0, 3)
    assert found["90 % interval covers the amplitude"][0] == pytest.approx(2 / 3)


def test_an_engine_that_failed_has_mended_nothing() -> None:
    found = gates({"cell": "plain", "truth": "a", "missed": "a", "verdict": "failed"})
    assert found["gap closed, parameter error, worst"] == (0.0, 1, False)
    assert found["effects named alone or in a set of at most three"] == (0.0, 1, False)


# The whole study.


@pytest.fixture
def stub(monkeypatch: pytest.MonkeyPatch) -> list[tuple[Sequence[str], str]]:
    """The same short recordings of every plant, and an engine that finds the isothermal manifold; what it was asked."""
    asked: list[tuple[Sequence[str], str]] = []

    def answer(folder: Path, train: Batch, held_out: Batch, plant: Plant, engine: str, keep_out: Path) -> Any:
        assert (train.names, held_out.names, keep_out.is_dir()) == (("train_1", "train_2"), ("proof_1",), True)
        asked.append((plant.without, engine))
        found = [m for m in CATALOGUE if m.name == "isothermal_manifold"]
        for name, mechanisms, values in (("model.toml", found, {"iso": 0.1}), ("calibrated.toml", [], {})):
            (folder / name).write_text(model_toml("nominal", NOMINAL, mechanisms, {"V_d_m3": 6e-3} | values, folder))
        return said(("isothermal_manifold", (), 0.1, 0.0, 0.2))

    monkeypatch.setattr(suite, "ask", answer)
    monkeypatch.setattr(suite, "record", lambda _, part, *__: recorded()[(TRAINING, PROOF, HELD_OUT).index(part)])
    monkeypatch.setattr(suite, "at_known_health", lambda _: NOMINAL)
    monkeypatch.setattr(suite, "errors", lambda m, *_: Errors(*[5.0 + abs(m.theta()[m.index("iso")])] * 4))
    return asked


def test_a_study_is_resumed_where_it_stopped(stub: list[Any], tmp_path: Path) -> None:
    quiet = Console(quiet=True)
    first = suite.run(1, 3, tmp_path, quiet, jobs=1)
    assert len(stub) == 3
    rows = pd.read_csv(tmp_path / "draws.csv")
    assert list(rows.columns) == list(COLUMNS)
    assert rows["cell"].tolist() == ["plain", "left_out", "nominal"]
    assert rows["named_right"].tolist()[:2] == ["isothermal_manifold"] * 2
    assert rows["named_wrong"].tolist()[2] == "isothermal_manifold"
    assert rows["parameter_share"].iloc[0] == pytest.approx(0.9)
    assert "| 00-plain |" in (tmp_path / "draws.md").read_text()
    manifest = json.loads((tmp_path / "manifest.json").read_text())
    assert manifest["seed"] == 3
    assert set(manifest["seals"]) == {"00-plain-known_health", "00-left_out-known_health", "00-nominal-known_health"}
    (tmp_path / "cases" / "00-nominal-known_health" / "row.json").unlink()
    said = StringIO()
    second = suite.run(1, 3, tmp_path, Console(file=said), jobs=1)
    assert f"to do: 1 case, about a core-minute at most by {tmp_path}/draws.csv" in said.getvalue()
    assert len(stub) == 4
    pd.testing.assert_frame_equal(first, second)
    suite.run(1, 4, tmp_path, quiet, jobs=1)
    assert len(stub) == 7, "another seed is another study"


def test_every_engine_is_asked_about_plants_as_they_are_and_one_about_all(stub: list[Any], tmp_path: Path) -> None:
    suite.run(1, 3, tmp_path, Console(quiet=True), engines=suite.ENGINES, jobs=1)
    poorer = draw(Item("left_out", 0), 3).without
    assert stub == [*(((), e) for e in suite.ENGINES), (poorer, "known_health"), ((), "known_health")]
    for engine in suite.ENGINES:
        assert (tmp_path / f"gates_{engine}.md").is_file()


def test_the_truth_is_on_no_disk_until_the_engine_has_answered(
    stub: list[Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    answer = suite.ask

    def looks(folder: Path, *arguments: Any) -> Any:
        written = [p for p in (*folder.rglob("*"), *tmp_path.rglob("*")) if p.is_file()]
        assert [p.name for p in written] == ["seal.json"]
        return answer(folder, *arguments)

    monkeypatch.setattr(suite, "ask", looks)
    suite.run_case(Item("plain", 0), 3, tmp_path, "known_health")
    truth = json.loads((tmp_path / "cases" / "00-plain-known_health" / "truth.json").read_text())["truth"]
    assert [e["name"] for e in truth["effects"]] == [m.name for m in EFFECTS]


def test_a_seal_that_was_changed_meanwhile_is_noticed(
    stub: list[Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def forges(*_: Any) -> Any:
        seal = tmp_path / "cases" / "00-nominal-known_health" / "seal.json"
        seal.write_text(json.dumps({"case": "00-nominal", "sha256": "0" * 64}))
        return said()

    monkeypatch.setattr(suite, "ask", forges)
    with pytest.raises(BrokenSeal):
        suite.run_case(Item("nominal", 0), 3, tmp_path, "known_health")


@pytest.mark.parametrize(
    "engine", [pytest.param(e, marks=[pytest.mark.slow] * (e != "sensors_alone")) for e in suite.ENGINES]
)
def test_the_engine_gets_what_it_may_read_alone(engine: str, tmp_path: Path) -> None:
    train, held_out, _ = recorded()
    plant = draw(Item("loose", 0), 3)
    answered = suite.ask(tmp_path, train, held_out, plant, engine, tmp_path / "out")
    case = json.loads((tmp_path / "case.json").read_text())
    assert set(case) == {"train", "held_out", "health", "without", "only", "constants", "tolerance"}
    assert case["constants"] == list(UNKNOWN)
    assert case["only"] == ([e.name for e in plant.effects] if engine == "told" else [])
    health = () if engine == "sensors_alone" else HEALTH
    for path in tmp_path.glob("*.csv"):
        assert tuple(pd.read_csv(path, nrows=1).columns) == ("time_s", *CHANNELS, *health)
    assert len(list(tmp_path.glob("*.csv"))) == 3
    assert answered["verdict"] != "failed", answered["says"]
    assert answered["seconds"] > 0.0
    assert not [f for f in answered["findings"] if str(f["mechanism"]).endswith(tuple(f"@{n}" for n in HEALTH))]
    assert {p.name for p in tmp_path.glob("*.toml")} == {"model.toml", "calibrated.toml"}


def test_an_engine_that_fails_has_answered(tmp_path: Path) -> None:
    train, held_out, _ = recorded()
    blank = replace(train, measured=np.full_like(train.measured, np.nan))
    refused = suite.ask(tmp_path, blank, held_out, draw(Item("plain", 0), 3), "known_health", tmp_path / "out")
    assert refused["verdict"] == "failed"
    assert "is empty" in refused["says"]


def test_no_plant_at_all_is_bad_input(tmp_path: Path) -> None:
    with pytest.raises(BadInput, match="--draws is 0"):
        suite.run(0, 1, tmp_path, Console(quiet=True))


def test_an_unknown_engine_is_bad_input(tmp_path: Path) -> None:
    with pytest.raises(BadInput, match="engine 'twinbench' is not known; choose from known_health, "):
        suite.run(1, 1, tmp_path, Console(quiet=True), engines=["twinbench"])
