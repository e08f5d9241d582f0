"""A user's file of an estimator that misbehaves when it is imported."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from helpers.refusals import refused
from helpers.tiny_run import run_arguments, twinbench, write_estimator, write_profile

from twinbench.common import trial


@pytest.mark.parametrize(
    ("line", "says"),
    [
        ("while True: pass", "importing it has not ended after 1 s"),
        ("raise KeyboardInterrupt", "importing it raises KeyboardInterrupt"),
        ("raise SystemExit(0)", "fails to import: SystemExit"),
        ("import os; os._exit(0)", "ends Python itself"),
    ],
)
def test_what_never_ends_or_ends_python_is_one_line(tmp_path, monkeypatch, capsys, line, says):
    monkeypatch.setattr(trial, "CALL_S", 1.0)
    path = Path(write_estimator(tmp_path, "mine"))
    path.write_text(f"{path.read_text()}\n{line}\n")
    said = refused(tmp_path, capsys, "check", path)
    assert says in said
    assert "mine.py" in said


def test_what_it_prints_stays_out_of_the_json(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr("twinbench.bench.contract.run_battery", lambda *_: [])
    path = Path(write_estimator(tmp_path, "mine"))
    path.write_text(f"print('hello')\n{path.read_text()}")
    assert twinbench("check", path, "--json") == 0
    out, err = capsys.readouterr()
    assert json.loads(out) == []
    assert "hello" in err


def test_a_method_that_ends_python_fails_its_promises_and_its_cell(tmp_path, capsys):
    path = write_estimator(tmp_path, "mine", fit="raise SystemExit(0)")
    assert twinbench("check", path, "--json") == 1
    details = [row["detail"] for row in json.loads(capsys.readouterr().out) if row["status"] == "fail"]
    assert "SystemExit: 0" in details
    arguments = run_arguments(write_profile(tmp_path), tmp_path / "out", [path])
    assert twinbench(*arguments) == 1
    assert "SystemExit: 0" in capsys.readouterr().out


def test_a_state_of_another_shape_is_told_at_once(tmp_path, capsys):
    path = Path(write_estimator(tmp_path, "mine"))
    path.write_text(path.read_text().replace("truth.mean(axis=0)", "truth"))
    assert twinbench("check", path, "--json") == 1
    details = [row["detail"] for row in json.loads(capsys.readouterr().out) if row["status"] == "fail"]
    assert any("must be (2, 10)" in detail for detail in details)
