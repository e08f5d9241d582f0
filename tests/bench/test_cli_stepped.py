"""An FMU that can only be stepped, on the command line: the verdict says why so little was asked; what is refused."""

from __future__ import annotations

import json
from pathlib import Path

import pandas as pd
import pytest
from helpers import stepped_tanks
from helpers.documents import check_file
from helpers.refusals import refused
from helpers.small_fmu import needs_gcc
from helpers.tiny_run import twinbench

pytestmark = needs_gcc
HOLE = """
from twinbench.physics.simulator import Term, Variable

HOLE = Term("hole", "", "balance:h1", (Variable("c", "1", 0.0, 1.0, 0.1),), term=lambda x, u, theta: -theta[-1])
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The FMU and three days on which the sensor of l2 is slow."""
    there = tmp_path_factory.mktemp("tanks")
    stepped_tanks.STEPPED.build(there).rename(there / "tanks.fmu")
    for day in stepped_tanks.days(lag_l2_s=2.0):
        table = pd.DataFrame(day.values, columns=list(day.channels))
        table.insert(0, "time_s", day.time_s)
        table.to_csv(there / f"{day.name}.csv", index=False)
    return there


def test_a_verdict_says_in_all_its_forms_why_so_little_was_asked(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    days = [folder / f"day{k}.csv" for k in range(3)]
    out = tmp_path / "found"
    status = twinbench("mismatch", folder / "tanks.fmu", *days[:2], "--hold-out", days[2], "--out", out)
    said = capsys.readouterr().out
    check_file(out / "verdict.json")
    verdict = json.loads((out / "verdict.json").read_text())
    (finding,) = verdict["findings"]
    assert (status, finding["mechanism"]) == (10, "sensor_lag@l2")
    assert finding["parameters"]["lag_s_l2"]["value"] == pytest.approx(2.0, abs=0.2)
    why = "This simulator can only be stepped; it does not tell the rates of its states."
    assert verdict["not_asked"].startswith(why)
    assert why in " ".join(said.split())
    assert why in " ".join((out / "report.html").read_text().split())
    assert (out / "report.pdf").stat().st_size > 0
    # What was found goes on: the mended model replays the slow sensor.
    asked = ("--simulator", out / "model.toml", "--trust", "--inputs", days[2], "--out", tmp_path / "replayed")
    assert twinbench("simulate", *asked) == 0
    (file,) = (tmp_path / "replayed").glob("*.csv")
    apart = pd.read_csv(file)["l2"] - pd.read_csv(days[2])["l2"]
    assert apart.iloc[100:].std() < 2.0 * stepped_tanks.NOISE


def test_a_list_shows_what_cannot_be_asked(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert twinbench("list", "simulators", "--simulator", folder / "tanks.fmu", "--json") == 0
    *variables, last = json.loads(capsys.readouterr().out)
    assert [row["name"] for row in variables] == ["h1", "h2", "q", "l1", "l2", "A", "k1", "k2"]
    assert (last["kind"], last["name"]) == ("not told", "rates of the states")
    assert "nothing can be added to its balances" in last["says"]
    assert twinbench("list", "mechanisms", "--simulator", folder / "tanks.fmu", "--json") == 0
    assert {row["port"] for row in json.loads(capsys.readouterr().out)} == {"output:l1", "output:l2", "input:q"}


def test_what_needs_rates_is_refused_in_a_line_that_says_why(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "hole.py").write_text(HOLE)
    listed = (
        f'base = "{folder / "tanks.fmu"}"\n\n[[mechanisms]]\nname = "hole"\nfrom = "hole.py"\n\n[values]\nc = 0.1\n'
    )
    (tmp_path / "holed.toml").write_text(listed)
    fmu, day = folder / "tanks.fmu", folder / "day0.csv"
    for arguments in (
        ("fmu", fmu, "--out", tmp_path / "again.fmu"),
        ("simulate", "--simulator", tmp_path / "holed.toml", "--trust", "--inputs", day, "--out", tmp_path / "out"),
    ):
        said = refused(tmp_path, capsys, *arguments)
        assert "can only be stepped: it does not tell the rates of its states" in said
