"""Verdicts by Python and by FMU: both twins are told the same, and what differs is told."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from helpers.small_fmu import needs_gcc
from short_machines import SHORT

from twinbench.data.recording import Recording
from twinbench.physics.simulator import Simulator
from twinbench.proof import fmu_verdicts

pytestmark = needs_gcc
EFFECT = "leak@h1_cm"


class Verdict(dict[str, object]):
    def to_dict(self) -> dict[str, object]:
        return dict(self)


def test_both_twins_are_told_the_same_and_a_difference_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[Simulator] = []

    def diagnosed(twin: Simulator, learnt: Sequence[Recording], hold_out: Sequence[Recording]) -> Verdict:
        assert len(learnt) == 3
        assert len(hold_out) == 1
        asked.append(twin)
        by_fmu = len(asked) > 2
        finding = {"mechanism": "leak@h2_cm" if by_fmu else EFFECT, "port": "balance:h1_cm"}
        parameters = {"hole1_cm2": {"after": 0.51 if by_fmu else 0.5}}
        return Verdict(verdict="missing physics", findings=[finding], parameters=parameters)

    monkeypatch.setattr(fmu_verdicts, "MACHINES", SHORT)
    monkeypatch.setattr(fmu_verdicts, "diagnose", diagnosed)
    row = fmu_verdicts.compared("two_tanks", (EFFECT,), 7)
    assert row["same_verdict"] is False
    assert row["named"] == EFFECT
    assert row["furthest_size_pct"] == pytest.approx(100.0 * 0.01 / 0.51)
    plain, warm, fmu, _ = asked
    assert plain is warm
    assert plain.calibrate == fmu.calibrate
    assert [v.name for v in plain.outputs] == [v.name for v in fmu.outputs]
    x, u, theta = np.array([12.0, 7.0]), np.array([4.0]), plain.theta()
    assert plain.rhs is not None
    assert fmu.rhs is not None
    np.testing.assert_array_equal(fmu.rhs(x, u, fmu.theta()), plain.rhs(x, u, theta))


def test_the_page_shows_what_the_table_has() -> None:
    results = Path(fmu_verdicts.ROOT) / "results" / "fmu"
    table = pd.read_csv(results / "verdicts.csv")
    assert (results / "verdicts.md").read_text() == fmu_verdicts.summary(table)
    assert set(table["machine"]) == set(fmu_verdicts.AS_BOTH)
    assert fmu_verdicts.summary(table.assign(same_verdict=False)).count("| 0 |") == 2


@pytest.mark.slow
def test_the_command_writes_a_table_and_where_it_is_from(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(fmu_verdicts, "AS_BOTH", ("two_tanks",))
    monkeypatch.setattr(fmu_verdicts, "MACHINES", SHORT)
    assert fmu_verdicts.main(["--out", str(tmp_path)]) == 0
    table = pd.read_csv(tmp_path / "verdicts.csv")
    assert list(table.columns) == list(fmu_verdicts.COLUMNS)
    assert table["same_verdict"].all()
    assert json.loads((tmp_path / "manifest.json").read_text())["seed"] == 7


def test_a_folder_that_cannot_be_written_to_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "taken").write_text("")
    assert fmu_verdicts.main(["--out", str(tmp_path / "taken")]) == 2
    assert "twinbench.proof.fmu_verdicts: " in capsys.readouterr().err
