"""``twinbench fmu``, and an FMU in the place of a simulator: what is written, what is read, what is refused."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from helpers.lag import LAG
from helpers.refusals import refused
from helpers.small_fmu import SmallFMU, needs_gcc
from helpers.tiny_run import twinbench

pytestmark = needs_gcc


@pytest.fixture
def lag(tmp_path: Path) -> Path:
    (tmp_path / "lag.py").write_text(LAG)
    return tmp_path / "lag.py"


def test_what_is_written_replays_recorded_inputs_as_the_python_does(lag: Path, tmp_path: Path) -> None:
    time_s = np.arange(0.0, 60.0, 0.5)
    day = {"time_s": time_s, "T_in": 300.0 + 8.0 * np.sin(0.2 * time_s), "T_out": 290.0 + 0.0 * time_s}
    pd.DataFrame(day).to_csv(tmp_path / "day.csv", index=False)
    fmu = tmp_path / "lag.fmu"
    assert twinbench("fmu", lag, "--out", fmu) == 0
    replayed = []
    for simulator, out in ((lag, "by_python"), (fmu, "by_fmu")):
        asked = ("--simulator", simulator, "--inputs", tmp_path / "day.csv", "--out", tmp_path / out)
        assert twinbench("simulate", *asked) == 0
        (file,) = (tmp_path / out).glob("*.csv")
        replayed.append(pd.read_csv(file))
    pd.testing.assert_frame_equal(*replayed, rtol=1e-9, atol=0.0)
    assert np.ptp(replayed[0]["T_out"]) > 5.0


def test_a_list_shows_what_was_understood(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    tank = SmallFMU(
        states={"level": "inflow - k * level"}, inputs={"inflow": 0.2}, outputs={"gauge": "level"},
        parameters={"k": 0.5}, more={"level": 'unit="m" min="0" max="3"'},
    )  # fmt: skip
    assert twinbench("list", "simulators", "--simulator", tank.build(tmp_path), "--json") == 0
    rows = {row["name"]: row for row in json.loads(capsys.readouterr().out)}
    assert set(rows) == {"level", "inflow", "gauge", "k"}
    assert (rows["level"]["unit"], rows["level"]["high"], rows["k"]["nominal"]) == ("m", 3.0, 0.5)


def test_a_name_that_is_no_fmu_s_is_refused(lag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    said = refused(tmp_path, capsys, "fmu", lag, "--out", tmp_path / "mended.txt")
    assert "an FMU's name ends in .fmu; call it mended.fmu" in said


def test_an_fmu_does_not_go_out_again(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = SmallFMU(states={"level": "-k * level"}, parameters={"k": 0.5}).build(tmp_path)
    capsys.readouterr()
    assert twinbench("fmu", file, "--out", tmp_path / "again.fmu") == 2
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    assert not (tmp_path / "again.fmu").exists()


def test_a_recording_without_its_input_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = SmallFMU(states={"level": "inflow - level"}, inputs={"inflow": 0.2}).build(tmp_path)
    (tmp_path / "day.csv").write_text("time_s,level\n0,1\n1,2\n2,3\n")
    twinbench("list", "simulators", "--simulator", file)
    said = refused(tmp_path, capsys, "mismatch", file, tmp_path / "day.csv", "--out", tmp_path / "found")
    assert "inflow" in said
