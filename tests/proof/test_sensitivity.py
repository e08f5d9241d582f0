"""Constants of the engine at other values: they are put back, and what they decide is counted by hand."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from short_machines import SHORT

from twinbench.mismatch.naming import decision, name, selfcheck, settle
from twinbench.proof import sensitivity
from twinbench.proof.concealed.findings import read_cases
from twinbench.proof.concealed.generate import Item
from twinbench.proof.concealed.judge import COLUMNS
from twinbench.proof.sensitivity import AS_IT_IS, CONSTANTS, FACTORS, as_markdown, rows_of, scaled, table, tried


@pytest.mark.parametrize("constant", CONSTANTS)
def test_a_constant_is_scaled_wherever_it_is_used_and_put_back(constant: str) -> None:
    module, _, of = constant.rpartition(".")
    home = __import__(f"twinbench.mismatch.{module}", fromlist=[of])
    before = getattr(home, of)
    with scaled(constant, 2.0):
        assert getattr(home, of) == pytest.approx(2 * before)
        assert type(getattr(home, of)) is type(before)
    assert getattr(home, of) == before


def test_modules_that_import_a_constant_get_it_too() -> None:
    with scaled("naming.settle.HOPELESS", 0.5):
        assert name.HOPELESS == settle.HOPELESS == 15.0
    with scaled("naming.name.SINGLES", 0.5):
        assert selfcheck.SINGLES == name.SINGLES == 4
    assert decision.CREDIBLE == 0.95


def rows(**named: list[str]) -> pd.DataFrame:
    """Rows of trials that say one name per case; the truth is always a leak."""
    texts = dict.fromkeys(("verdict", "set", "probability", "ports", "inexact", "port_truth"), "")
    blank = dict.fromkeys(COLUMNS, np.nan) | texts | {"cell": "mechanism", "truth": "leak", "class": "leak"}
    made = []
    for trial, names in named.items():
        of = AS_IT_IS if trial == "base" else (trial, 2.0)
        for i, said in enumerate(names):
            outcome = {"leak": "name", "": "abstained"}.get(said, "wrong")
            each = {"case": str(i), "named": said, "outcome": outcome, "detectable": True}
            made.append(blank | each | {"constant": of[0], "factor": of[1]})
    return pd.DataFrame(made)


def test_what_a_constant_decides_is_counted_case_by_case() -> None:
    found = table(rows(base=["leak", "leak", "", ""], other=["leak", "", "leak", "lag"])).set_index("constant")
    assert found.loc["other", ["differ", "gained", "lost", "right", "wrong"]].tolist() == [3, 1, 1, 2, 1]
    assert found.loc["as it is", ["differ", "right", "wrong"]].tolist() == [0, 2, 0]
    assert "4 cases each." in as_markdown(found.reset_index())


def test_trials_that_are_there_are_not_made_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[float] = []

    def answer(folder: Path, engine: str) -> dict[str, Any]:
        asked.append(settle.HOPELESS)
        if len(asked) == 5:
            raise KeyboardInterrupt
        return {"verdict": "consistent", "findings": []}

    monkeypatch.setattr(sensitivity.blind, "answer", answer)
    monkeypatch.setattr("twinbench.proof.concealed.generate.machine_of", lambda name, seed: SHORT[name])
    item = Item("0000", "clean", "two_tanks", (), 0.0)
    with pytest.raises(KeyboardInterrupt):
        tried(item, 1, tmp_path)
    trials = 1 + len(CONSTANTS) * len(FACTORS)
    tried(item, 1, tmp_path)
    assert len(asked) == trials + 1
    assert {0.5 * settle.HOPELESS, 2.0 * settle.HOPELESS} < set(asked)
    assert {row["outcome"] for row in rows_of(item, 1, tmp_path)} == {"abstained"}
    tried(item, 1, tmp_path)
    assert len(asked) == trials + 1


def test_the_command_writes_rows_and_tables(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sensitivity.blind, "answer", lambda folder, engine: {"verdict": "consistent", "findings": []})
    monkeypatch.setattr("twinbench.proof.concealed.generate.machine_of", lambda name, seed: SHORT["two_tanks"])
    monkeypatch.setattr(sensitivity, "cases", lambda n, seed: [Item("0000", "clean", "two_tanks", (), 0.0)] * n)
    assert sensitivity.main(["--cases", "1", "--jobs", "1", "--out", str(tmp_path)]) == 0
    assert "| SETTLED | nats that end settling | 0.5 | 0 | 0 | 0 | 0 | 0 |" in capsys.readouterr().out
    assert len(read_cases(tmp_path / "cases.csv")) == 1 + len(CONSTANTS) * len(FACTORS)
    assert json.loads((tmp_path / "manifest.json").read_text())["command"].endswith("--cases 1 --seed 7")


def test_no_case_at_all_is_refused_in_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert sensitivity.main(["--cases", "0", "--out", str(tmp_path / "out")]) == 2
    assert capsys.readouterr().err == "twinbench.proof.sensitivity: --cases is 0, must be at least 1\n"
    assert not (tmp_path / "out").exists()
