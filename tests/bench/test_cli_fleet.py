"""``twinbench fleet``: what all ovens lack and which one is unlike the others, the files, and what is refused."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from helpers.oven_fleet import DRAUGHT, LEFT_OUT, LOSS, table, write_ovens
from helpers.refusals import refused
from helpers.tiny_run import twinbench


@pytest.fixture
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with a simulator and three ovens, the last with a loss of its own, as the current one."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("LOKY_MAX_CPU_COUNT", "1")
    write_ovens(tmp_path, (0.0, 0.0, LOSS))
    return tmp_path


def test_what_all_lack_and_what_one_has(place: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert twinbench("fleet", "oven.py", "oven0", "oven1", "oven2", "--out", "found", "--json", *LEFT_OUT) == 10
    told = json.loads(capsys.readouterr().out)
    assert told == json.loads((place / "found" / "fleet.json").read_text())
    (shared,) = told["shared"]
    assert shared["mechanism"] == "offset@T_C"
    assert shared["mean"]["low"] < -DRAUGHT < shared["mean"]["high"]
    (odd,) = told["odd"]
    assert odd["machine"] == "oven2"
    assert odd["effects"][0]["mechanism"] == "loss_to_ambient@T_C"
    assert [told["machines"][name]["odd"] > 0.5 for name in ("oven0", "oven1", "oven2")] == [False, False, True]
    assert "offset@T_C" in told["says"]
    assert "oven2" in told["says"]
    files = {file["path"] for file in told["provenance"]["files"]}
    assert {"oven.py", *(f"oven{k}/day{day}.csv" for k in range(3) for day in range(3))} == files
    assert {"report.html", "fleet.json", "figures", "machines"} == {p.name for p in (place / "found").iterdir()}
    assert (place / "found" / "machines" / "oven1" / "verdict.json").is_file()
    page = (place / "found" / "report.html").read_text()
    assert page.count("<figure") == 2
    assert "Not drawn" not in page


def test_bad_fleets_are_refused_in_one_line(place: Path, capsys: pytest.CaptureFixture[str]) -> None:
    Path("empty").mkdir()
    Path("other").mkdir()
    table(5, DRAUGHT, 0.0, gap=True).to_csv("other/day0.csv", index=False)
    for machines, says in (
        (("oven0",), "1 machine is no fleet"),
        (("oven0", "empty"), "empty: holds no recording"),
        (("oven0", "gone"), "gone: no such folder"),
        (("oven0", "oven1", "oven1"), "two machines are named 'oven1'"),
        (("oven0", "other"), "machine oven0 has no readings of gap_K, machine other has"),
    ):
        assert says in refused(place, capsys, "fleet", "oven.py", *machines, "--out", "found")
