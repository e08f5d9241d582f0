"""The timing of verdicts: the same recordings at three rates, each asked blindly."""

from __future__ import annotations

import json
from pathlib import Path

import pandas as pd
import pytest
from short_machines import SHORT

from twinbench.proof import speed

SHORTER = {"train": (0.6,) * 3, "held": (0.6,)}


def test_each_rate_is_asked_on_the_same_recordings(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    rows: dict[str, list[int]] = {}

    def answered(folder: Path, engine: str) -> dict[str, object]:
        case = json.loads((folder / "case.json").read_text())
        tables = {name: pd.read_csv(folder / f"{name}.csv") for name in (*case["train"], *case["held_out"])}
        for name, table in tables.items():
            rows.setdefault(name, []).append(len(table))
        assert engine == "twinbench.mismatch:diagnose"
        return {"verdict": "missing physics", "findings": [{"mechanism": "friction"}, {"mechanism": None}]}

    monkeypatch.setattr(speed, "answer", answered)
    found = speed.measured(SHORT["motor"], "coulomb_friction@omega_rad_s", SHORTER, 7)
    assert [row["rate_Hz"] for row in found] == pytest.approx([20.0, 5.0, 1.0])
    assert {row["named"] for row in found} == {"friction"}
    assert all(row["seconds"] >= 0.0 for row in found)
    assert len(rows) == 4
    for seen in rows.values():
        assert seen == [36, 720, 180, 36], "the first is not timed"


@pytest.mark.slow
def test_the_command_writes_a_table_and_where_it_is_from(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(speed, "MINUTES", SHORTER)
    monkeypatch.setattr(speed, "EFFECTS", {"motor": "coulomb_friction@omega_rad_s"})
    monkeypatch.setattr(speed, "MACHINES", SHORT)
    assert speed.main(["--out", str(tmp_path)]) == 0
    table = pd.read_csv(tmp_path / "speed.csv")
    assert list(table.columns) == list(speed.COLUMNS)
    assert (table["seconds"] > 0.0).all()
    assert json.loads((tmp_path / "manifest.json").read_text())["command"] == "python -m twinbench.proof.speed --seed 7"
    assert "motor" in capsys.readouterr().out


def test_a_folder_that_cannot_be_written_to_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "taken").write_text("")
    assert speed.main(["--out", str(tmp_path / "taken")]) == 2
    assert "twinbench.proof.speed: " in capsys.readouterr().err
