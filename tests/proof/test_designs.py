"""The proof of designs: what is drawn, how narrowly it is recorded, and what its tables count."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

from twinbench.proof.concealed.generate import Item
from twinbench.proof.designs import plan
from twinbench.proof.designs.__main__ import main
from twinbench.proof.designs.concealed import concealed
from twinbench.proof.designs.tables import as_markdown, summary


def test_items_visit_every_machine_and_each_goes_through_its_effects(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(plan, "RANDOM_MACHINES", 1)
    items = plan.drawn_items(10, 5)
    assert len({(item.machine, item.effects) for item in items}) == 10
    assert len({item.machine for item in items}) == 5


def test_narrow_recordings_stay_within_the_limits_and_leave_most_of_them_unseen():
    machine = concealed(Item("0", "mechanism", "two_tanks", ("overflow@h1_cm",), 2.0), 3)
    at_hand = machine.at_hand()
    u = np.concatenate([r.values[:, 0] for r in at_hand])
    low, high, slack = machine.limits.low[0], machine.limits.high[0], 0.02
    assert low - slack <= u.min()
    assert u.max() <= high + slack
    assert np.ptp(u) < 0.7 * (high - low)
    assert at_hand[-1].name == "held"
    again = machine.recorded("further", machine.later(at_hand), machine.narrow[0])
    assert again.time_s[0] > max(r.time_s[-1] for r in at_hand)
    assert again.channels == ("pump_V", "level1_cm", "level2_cm")


def test_tables_count_right_and_wrong_names_of_sets_alone():
    rows = pd.DataFrame(
        {
            "status": ["set", "set", "set", "no set"],
            "proposed": ["name", "class", "wrong", ""],
            "random": ["set", "name", "located", ""],
            "repeated": ["set", "set", "set", ""],
            "experiments": [1, 1, 0, ""],
        }
    )
    table = summary(rows).set_index("experiment")
    assert table.loc["proposed", "right"] == pytest.approx(2 / 3)
    assert table.loc["proposed", "wrong"] == pytest.approx(1 / 3)
    assert table.loc["repeated", "right"] == 0.0
    told = as_markdown(summary(rows), rows)
    assert "in cases: 1: 2, 2: 0, 3: 0." in told
    assert "Of 4 machines drawn: set 3, no set 1." in told


def test_no_draws_are_refused(capsys: pytest.CaptureFixture[str]):
    assert main(["--draws", "0"]) == 2
    assert "--draws is 0, must be at least 1" in capsys.readouterr().err
