"""The proof of fleets: what is drawn, what anybody could tell of it, the tables, what is kept, and bad input."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pandas as pd
import pytest

from twinbench.proof.fleets import trial
from twinbench.proof.fleets.__main__ import main
from twinbench.proof.fleets.drawn import EFFECTS, SEVERITY, Drawn, draw, write
from twinbench.proof.fleets.observer import observed
from twinbench.proof.fleets.tables import as_markdown, rows_of, summary

KEPT: Mapping[str, Any] = {
    "fleet": 0,
    "shared": "leak@h1_cm",
    "class": ["leak@h1_cm", "linear_leak@h1_cm"],
    "own": "offset@h2_cm",
    "odd": ["a", "b"],
    "machines": list("abcdefgh"),
    "seconds": 1.0,
    "alike": {"linear_leak@h1_cm": ["sensor_gain@level2_cm"]},
    "said": {
        "fleet": {"named": ["linear_leak@h1_cm"], "accused": {"a": "offset@h2_cm", "c": "leak@h2_cm"}},
        "verdicts side by side": {"named": ["leak@h1_cm", "offset@h2_cm"], "accused": {"b": ""}},
        "nobody is accused": {"named": [], "accused": {}},
        "ideal observer": {"named": ["leak@h1_cm"], "accused": {"a": "offset@h2_cm", "b": "offset@h2_cm"}},
    },
}
"""A fleet as it is kept."""


@pytest.fixture(scope="module")
def drawn() -> Drawn:
    return draw(0, 5, 3, 1)


def test_a_fleet_is_drawn_again_with_a_folder_for_each_machine(drawn: Drawn, tmp_path: Path) -> None:
    again = draw(0, 5, 3, 1)
    for name, fleet in (("once", drawn), ("again", again)):
        write(fleet, tmp_path / name)
    assert again[:5] == drawn[:5]
    assert drawn.shared != drawn.own
    assert {drawn.shared, drawn.own} <= set(EFFECTS)
    (odd,) = drawn.odd
    folders = sorted((tmp_path / "once").iterdir())
    assert [f.name for f in folders] == ["machine_01", "machine_02", "machine_03"] == list(drawn.machines)
    files = [sorted(p.name for p in f.iterdir()) for f in folders]
    assert files[0] == files[1] == ["1_train_1.csv", "2_train_2.csv", "3_held_1.csv"]
    for path in (tmp_path / "once").rglob("*.csv"):
        assert path.read_bytes() == (tmp_path / "again" / path.relative_to(tmp_path / "once")).read_bytes()
    assert {name: set(one.sizes) for name, one in drawn.machines.items()} == {
        name: {drawn.shared, drawn.own} if name == odd else {drawn.shared} for name in drawn.machines
    }


def test_an_odd_machine_has_its_own_effect_at_the_severity(drawn: Drawn) -> None:
    one = drawn.machines[drawn.odd[0]]
    yardstick = one.yardstick
    moved = yardstick.p.copy()
    moved[yardstick.machine.at(yardstick.machine.effect(drawn.own).slot)] = one.sizes[drawn.own]
    assert min(yardstick.measure(yardstick.with_parameters(moved))) == pytest.approx(SEVERITY, rel=0.05)


def test_the_observer_tells_what_is_there_and_needs_a_size_for_it(drawn: Drawn) -> None:
    seen = observed(drawn)
    assert seen.names
    assert seen.found == drawn.odd
    assert drawn.shared in seen.same
    tiny = {
        name: one._replace(sizes={effect: 1e-3 * size for effect, size in one.sizes.items()})
        for name, one in drawn.machines.items()
    }
    faint = observed(drawn._replace(machines=tiny))
    assert not faint.names
    assert faint.found == ()


def test_fleets_are_summed_up_for_everybody_who_said_something() -> None:
    table = summary(pd.DataFrame(list(rows_of(KEPT)))).set_index("who")
    by_fleet, side = table.loc["fleet"], table.loc["verdicts side by side"]
    assert (by_fleet["shared_named"], by_fleet["wrongly_named"]) == (1.0, 0.0)
    assert (side["shared_named"], side["wrongly_named"]) == (1.0, 1.0)
    assert by_fleet["odd_found"] == by_fleet["odd_named"] == side["odd_found"] == 0.5
    assert side["odd_named"] == 0.0
    assert by_fleet["sound_accused"] == pytest.approx(1 / 6)
    assert table.loc["nobody is accused", ["shared_named", "odd_found", "sound_accused"]].tolist() == [0.0, 0.0, 0.0]
    assert table.loc["ideal observer", ["shared_named", "odd_found", "sound_accused"]].tolist() == [1.0, 1.0, 0.0]
    page = as_markdown(table.reset_index(), [KEPT])
    assert "| fleet | 100 [" in page
    assert "Of 1 fleets with 8 machines, 2 of them odd" in page


def test_a_name_that_is_told_beside_is_no_wrong_name_and_not_the_right_one() -> None:
    beside = {"named": ["sensor_gain@level2_cm"], "accused": {}}
    kept = {**KEPT, "alike": {"sensor_gain@level2_cm": ["leak@h1_cm"]}, "said": {**KEPT["said"], "fleet": beside}}
    first = next(rows_of(kept))
    assert (first["shared_named"], first["shared_told"], first["wrongly_named"]) == (0, 1, 0)
    first = next(rows_of({**kept, "alike": {"sensor_gain@level2_cm": []}}))
    assert (first["shared_named"], first["shared_told"], first["wrongly_named"]) == (0, 0, 1)


def test_a_fleet_that_was_judged_is_not_asked_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[int] = []

    def said(fleet: int, plan: trial.Plan) -> dict[str, Any]:
        asked.append(fleet)
        return {key: value for key, value in KEPT.items() if key != "seconds"}

    monkeypatch.setattr(trial, "_judged", said)
    few = ["--machines", "8", "--odd", "2", "--out", str(tmp_path)]
    assert main(["--fleets", "1", *few]) == 0
    assert main(["--fleets", "2", *few]) == 0
    assert asked == [0, 1]
    assert main(["--fleets", "2", "--seed", "9", *few]) == 0
    assert asked == [0, 1, 0, 1]
    assert len(pd.read_csv(tmp_path / "fleets.csv")) == 2 * len(trial.WAYS)
    assert json.loads((tmp_path / "manifest.json").read_text())["seed"] == 9


def test_a_fleet_of_odd_machines_alone_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--machines", "3", "--odd", "3"]) == 2
    assert capsys.readouterr().err.startswith("twinbench.proof.fleets: --fleets must be 1 or more")
