"""Verdicts with a twin that can only be stepped: it is stepped, and each outcome is judged by its kind."""

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
from twinbench.mismatch.verdict import VERDICTS
from twinbench.physics.simulator import Simulator
from twinbench.proof import stepped_verdicts
from twinbench.proof.concealed.generate import Item

pytestmark = needs_gcc
RIGHT = "right"


class Verdict(dict[str, object]):
    def to_dict(self) -> dict[str, object]:
        return dict(self)


def finding(name: str | None, *others: str) -> dict[str, object]:
    return {"mechanism": name, "indistinguishable_from": others}


@pytest.mark.parametrize(
    ("effect", "kind", "found", "outcome"),
    [
        ("sensor_lag@level2_cm", "sensor or input", [finding("sensor_delay@level2_cm", "sensor_lag@level2_cm")], RIGHT),
        ("leak@h1_cm", "balance", [finding("sensor_gain@level2_cm")], "wrong name"),
    ],
)  # fmt: skip
def test_the_twin_can_only_be_stepped_and_the_verdict_is_judged(
    effect: str, kind: str, found: list[dict[str, object]], outcome: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    def diagnosed(twin: Simulator, learnt: Sequence[Recording], hold_out: Sequence[Recording]) -> Verdict:
        assert twin.rhs is None
        assert twin.stepped is not None
        assert [v.name for v in twin.states] == ["h1_cm", "h2_cm"]
        assert (len(learnt), len(hold_out)) == (3, 1)
        x, u = np.array([s.nominal for s in twin.states]), np.array([v.nominal for v in twin.inputs])
        assert np.isfinite(twin.stepped(np.tile(u, (9, 1)), np.full(9, 0.5), x, twin.theta())).all()
        return Verdict(verdict="unexplained", findings=found)

    monkeypatch.setattr(stepped_verdicts, "MACHINES", SHORT)
    monkeypatch.setattr(stepped_verdicts, "diagnose", diagnosed)
    cell = "sensor" if effect.startswith("sensor") else "mechanism"
    row = stepped_verdicts.told(Item(effect, cell, "two_tanks", (effect,), 1.0), 7)
    assert (row["kind"], row["outcome"]) == (kind, outcome)


def test_outcomes_of_what_nothing_is_said_of() -> None:
    told = {
        kind: {stepped_verdicts.outcome(kind, (), [], verdict) for verdict in VERDICTS}
        for kind in stepped_verdicts.KINDS
    }
    assert told["sound"] == {"right", "no name"}
    assert told["sensor or input"] == {"nothing", "no name"}
    assert told["balance"] == {"nothing", "right"}


def test_the_page_shows_what_the_table_has() -> None:
    results = Path(stepped_verdicts.ROOT) / "results" / "fmu" / "stepped"
    table = pd.read_csv(results / "verdicts.csv", keep_default_na=False)
    assert list(table.columns) == list(stepped_verdicts.COLUMNS)
    assert table["case"].tolist() == [item.case for item in stepped_verdicts.plan()]
    assert (results / "verdicts.md").read_text() == stepped_verdicts.summary(table)


@pytest.mark.slow
def test_the_command_writes_a_table_and_where_it_is_from(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(stepped_verdicts, "MACHINES", SHORT)
    monkeypatch.setattr(stepped_verdicts, "plan", lambda: [Item("clean", "clean", "two_tanks")])
    assert stepped_verdicts.main(["--out", str(tmp_path)]) == 0
    assert pd.read_csv(tmp_path / "verdicts.csv")["outcome"].tolist() == ["right"]
    assert json.loads((tmp_path / "manifest.json").read_text())["seed"] == 7
