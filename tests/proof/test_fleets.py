"""The proof of fleets: what is drawn, how fleets are summed up, and bad input in one line."""

from __future__ import annotations

from pathlib import Path

import pandas as pd
import pytest

from twinbench.proof.fleets.__main__ import main, summary
from twinbench.proof.fleets.drawn import EFFECTS, draw


def test_a_fleet_is_drawn_again_with_a_folder_for_each_machine(tmp_path: Path) -> None:
    once, again = (draw(0, 5, 2, 1, tmp_path / name) for name in ("once", "again"))
    assert once == again
    assert once.shared != once.own
    assert {once.shared, once.own} <= set(EFFECTS)
    (odd,) = once.odd
    folders = sorted((tmp_path / "once").iterdir())
    assert [f.name for f in folders] == ["machine_01", "machine_02"]
    assert odd in {f.name for f in folders}
    files = [sorted(p.name for p in f.iterdir()) for f in folders]
    assert files[0] == files[1] == ["1_train_1.csv", "2_train_2.csv", "3_held_1.csv"]
    for path in (tmp_path / "once").rglob("*.csv"):
        assert path.read_bytes() == (tmp_path / "again" / path.relative_to(tmp_path / "once")).read_bytes()


def test_fleets_are_summed_up_by_machines() -> None:
    rows = pd.DataFrame(
        {
            "shared named": [1.0, 0.0],
            "wrongly named": [0.0, 1.0],
            "odd machines": [3, 3],
            "odd found": [3, 1],
            "odd named right": [2, 1],
            "sound machines": [17, 17],
            "sound accused": [0, 1],
        }
    )
    (told,) = summary(rows).to_dict("records")
    assert (told["shared named"], told["wrongly named"]) == (0.5, 0.5)
    assert told["odd found"] == pytest.approx(4 / 6)
    assert told["odd named right"] == 0.5
    assert told["sound accused"] == pytest.approx(1 / 34)


def test_a_fleet_of_odd_machines_alone_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--machines", "3", "--odd", "3"]) == 2
    assert capsys.readouterr().err.startswith("twinbench.proof.fleets: --fleets must be 1 or more")
