"""Machines by name and from files, a user's whole one among them, and what is said of a spec that names none."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from helpers.tiny_run import twinbench, write_profile

from twinbench import load_machine
from twinbench.common.errors import BadInput
from twinbench.data.recording import read_recording
from twinbench.data.units import limits_of, units_of
from twinbench.machines.load import machine_at
from twinbench.machines.motor import MOTOR
from twinbench.machines.two_tanks import TWO_TANKS

ROOT = Path(__file__).parents[2]
OWN = ROOT / "examples" / "own_machine.py"


def test_by_name_and_from_a_package():
    assert load_machine("motor") is MOTOR
    assert load_machine("twinbench.machines.motor:MOTOR") is MOTOR


def test_an_own_machine_is_one_short_file_that_imports_public_names_only():
    text = OWN.read_text(encoding="utf-8")
    assert len(text.splitlines()) <= 60
    assert [line for line in text.splitlines() if "import" in line] == [
        "import numpy as np",
        "from twinbench import Health, Lag, Machine, Noise, Reading, Simulator, Variable",
    ]
    page = (ROOT / "docs" / "your_machine.md").read_text(encoding="utf-8")
    assert page.split("```python\n")[1].split("```")[0] == text
    machine = load_machine(str(OWN))
    assert machine.quantities == ("T_tank_K", "heater", "loss_W_K")
    assert machine.label("loss_W_K") == "heat loss to the room"
    assert machine.axis_label("heater") == "share of its power that the heater still gives, –"


def test_one_file_is_one_machine_until_it_changes(tmp_path):
    mine = tmp_path / "mine.py"
    mine.write_text(OWN.read_text(encoding="utf-8"), encoding="utf-8")
    first = load_machine(str(mine))
    assert machine_at(str(mine)) is first
    assert machine_at(f"{mine}:MACHINE").name == first.name
    mine.write_text(mine.read_text(encoding="utf-8").replace("sample_period_s=0.5", "sample_period_s=0.25"))
    assert machine_at(str(mine)).sample_period_s == 0.25


@pytest.mark.parametrize(
    ("spec", "says"),
    [
        ("moter", "no machine 'moter'; did you mean 'motor'? Known by name: compressor, two_tanks, motor"),
        ("boiler", "give path/to/file.py"),
        ("gone.py", "no file gone.py; check the path"),
        ("twinbench.machines.motor:GONE", "has no Machine 'GONE'; it has: MOTOR"),
        ("twinbench.machines.loads:GONE", "has no Machine 'GONE'; it has: none"),
    ],
)
def test_a_spec_that_names_nothing(tmp_path, monkeypatch, spec, says):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(BadInput) as caught:
        load_machine(spec)
    assert says in str(caught.value)
    assert "\n" not in str(caught.value)


SPOILT = [
    ('loss_W_K", (20.0, 60.0)', 'loss", (20.0, 60.0)', "health names 'loss', which is no parameter"),
    ("(20.0, 60.0)", "(20.0, 600.0)", "outside the parameter's bounds 1 to 200"),
    ("2500.0, 6500.0", "2500.0, 16500.0", "loads leave the bounds of power_W"),
    ("plant=PLANT", "plant=PLAN", "fails to import: NameError"),
    ("    loads=loads,\n", "", "missing 1 required positional argument: 'loads'"),
    (
        "gained = theta[0] * u[0]",
        "gained = theta[0] * u[0] * np.sqrt(4.0 - u[0] / 1500.0)",
        "diverges: T_tank_K is no number after",
    ),
]


@pytest.mark.parametrize(("old", "new", "says"), SPOILT, ids=[says for *_, says in SPOILT])
def test_a_machine_that_does_not_hold_together_is_one_line_and_status_2(tmp_path, capfd, old, new, says):
    text = OWN.read_text(encoding="utf-8")
    assert old in text
    mine = tmp_path / "mine.py"
    mine.write_text(text.replace(old, new), encoding="utf-8")
    assert twinbench("simulate", "--machine", mine, "--out", tmp_path / "out") == 2
    line = capfd.readouterr().err
    assert line.count("\n") == 1
    assert says in line
    assert "mine.py" in line
    assert not (tmp_path / "out").exists()


def test_an_estimator_is_checked_on_an_own_machine(capfd):
    assert twinbench("check", "always_prior", "--machine", OWN) == 0
    assert " 0 failed" in capfd.readouterr().out


def test_the_list_tells_machines_in_words(capfd):
    assert twinbench("list", "machines", "--json") == 0
    rows = json.loads(capfd.readouterr().out)
    assert {row["machine"] for row in rows} == {"compressor", "two_tanks", "motor"}
    told = {(row["machine"], row["name"]): (row["kind"], row["unit"], row["says"]) for row in rows}
    assert told["two_tanks", "h1_cm"] == ("state", "cm", "level of the upper tank")
    assert told["motor", "brushes"][0] == "health"
    assert told["motor", "load_Nm"][0] == "input"
    assert told["compressor", "T_dis_K"][0] == "output"


def test_recordings_of_another_machine_are_written_and_read(tmp_path):
    profile = write_profile(tmp_path)
    given = ("--profile", profile, "--machine", "two_tanks", "--out", tmp_path / "out")
    assert twinbench("simulate", *given) == 0
    path = sorted((tmp_path / "out").iterdir())[0]
    recording = read_recording(path, (), units_of(TWO_TANKS), limits_of(TWO_TANKS), period_s=0.2)
    batch = recording.to_batch(TWO_TANKS)
    assert recording.channels == TWO_TANKS.channels
    assert np.diff(batch.time_s) == pytest.approx(np.full(len(batch.time_s) - 1, 0.2))
    columns = path.read_text().partition("\n")[0].split(",")
    assert {f"true_{name}" for name in TWO_TANKS.quantities} <= set(columns)
    assert recording.unread == ()


def test_a_simulator_and_a_machine_do_not_go_together(tmp_path, capfd):
    day = tmp_path / "day.csv"
    given = ("--simulator", "compressor", "--inputs", day, "--machine", "motor")
    assert twinbench("simulate", *given, "--out", tmp_path / "out") == 2
    assert "give one of the two" in capfd.readouterr().err
