"""A user's file of an estimator that misbehaves when it is imported."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from refusals import refused
from tiny_run import twinbench, write_estimator

from physics import trial


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
    monkeypatch.setattr("bench.contract.run_battery", lambda kind: [])
    path = Path(write_estimator(tmp_path, "mine"))
    path.write_text(f"print('hello')\n{path.read_text()}")
    assert twinbench("check", path, "--json") == 0
    out, err = capsys.readouterr()
    assert json.loads(out) == []
    assert "hello" in err
