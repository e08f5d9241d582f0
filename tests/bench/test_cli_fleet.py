"""``twinbench fleet``: what all ovens lack and which one is unlike the others, the files, and what is refused."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from helpers.refusals import refused
from helpers.tiny_run import twinbench

OVEN = """
import numpy as np
from twinbench import Simulator, Variable

def rhs(x, u, theta):
    return np.array([(u[0] - x[0]) / theta[0]])

def output(x, u, theta):
    return np.array([x[0], u[0] - x[0]])

def initial(u0, y0, theta):
    return np.array([y0[0]])

OVEN = Simulator(
    name="oven", says="an oven",
    states=(Variable("T_C", "degC", 0.0, 400.0, 150.0, 20.0),),
    inputs=(Variable("heater_C", "degC", 0.0, 400.0, 150.0, 40.0),),
    outputs=(
        Variable("probe_C", "degC", 0.0, 400.0, 150.0, 20.0),
        Variable("gap_K", "K", -400.0, 400.0, 0.0, 20.0),
    ),
    parameters=(Variable("tau_s", "s", 5.0, 100.0, 20.0, 2.0),),
    rhs=rhs, output=output, initial=initial,
)
"""
DRAUGHT, LOSS, PERIOD_S = 1.0, 0.01, 0.5
TRIED = ("sensor*", "input*", "periodic*", "radiation*", "backlash*", "dead*", "time_constant*", "second*")
"""What is left out, so that it takes a moment."""


def table(seed: int, draught: float, loss: float, gap: bool = False, samples: int = 240) -> pd.DataFrame:
    """A recording of an oven by fine Euler steps."""
    rng = np.random.default_rng(seed)
    heater = np.repeat(rng.uniform(60.0, 300.0, samples // 15), 15)
    x, read, parts = 150.0, np.empty(samples), 10
    for k in range(samples):
        read[k] = x
        for _ in range(parts):
            x += PERIOD_S / parts * ((heater[k] - x) / 20.0 - draught + loss * (20.0 - x))
    probe = read + rng.normal(0.0, 0.3, samples)
    columns = {"time_s": PERIOD_S * np.arange(samples), "heater_C": heater, "probe_C": probe}
    return pd.DataFrame(columns | ({"gap_K": heater - probe} if gap else {}))


@pytest.fixture
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with a simulator and three ovens, the last with a loss of its own, as the current one."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("LOKY_MAX_CPU_COUNT", "1")
    Path("oven.py").write_text(OVEN)
    for k, loss in enumerate((0.0, 0.0, LOSS)):
        Path(f"oven{k}").mkdir()
        for day in range(3):
            recording = table(10 * k + day, DRAUGHT * (1.0 + 0.03 * k), loss)
            recording.to_csv(f"oven{k}/day{day}.csv", index=False, float_format="%.6g")
    return tmp_path


def test_what_all_lack_and_what_one_has(place: Path, capsys: pytest.CaptureFixture[str]) -> None:
    left_out = [part for name in TRIED for part in ("--leave-out", name)]
    assert twinbench("fleet", "oven.py", "oven0", "oven1", "oven2", "--out", "found", "--json", *left_out) == 10
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
