"""The proof of designs: what is drawn, how narrowly it is recorded, and what its tables count."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest

from twinbench.proof.concealed.generate import Item
from twinbench.proof.designs import plan
from twinbench.proof.designs.__main__ import main
from twinbench.proof.designs.concealed import concealed, liveliest
from twinbench.proof.designs.ideal import sure
from twinbench.proof.designs.tables import as_markdown, summary
from twinbench.proof.designs.trial import ALIKE, ARMS, judged


def test_items_visit_every_machine_and_each_goes_through_its_effects(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(plan, "RANDOM_MACHINES", 1)
    items = plan.drawn_items(9, 5)
    assert len({(item.machine, item.effects) for item in items}) == 9
    assert len({item.machine for item in items}) == 3
    assert all(item.effects[0].partition("@")[0] in plan.RELATED for item in items)


def test_narrow_recordings_stay_within_the_limits_and_leave_most_of_them_unseen():
    made = concealed(Item("0", "mechanism", "two_tanks", ("linear_leak@h1_cm",), 2.0), 3)
    u = np.concatenate([r.values[:, 0] for r in made.at_hand])
    low, high, slack = made.limits.low[0], made.limits.high[0], 0.02
    assert low - slack <= u.min()
    assert u.max() <= high + slack
    assert np.ptp(u) < 1.1 * (high - low) / made.reach
    assert len(made.ordinary) == len(made.limits.time_s)
    assert low - 1e-9 <= made.ordinary.min() < made.ordinary.max() <= high + 1e-9
    assert [take.held_out for take in made.narrow] == [False, True]
    again = made.recorded(made.later("again", made.narrow[0].u, made.narrow))
    assert again.time_s[0] > max(r.time_s[-1] for r in made.at_hand)
    assert again.channels == ("pump_V", "level1_cm", "level2_cm")


def test_the_ideal_observer_tells_more_with_an_ordinary_recording_within_the_limits_than_without():
    made = concealed(Item("0", "mechanism", "two_tanks", ("linear_leak@h1_cm",), 0.12), 3)
    same, more = [made.truth.effect.name], made.later("ordinary", made.ordinary, made.narrow)
    takes = made.narrow[0], more, made.narrow[1]
    narrow, wider = (sure(made.truth, some, same) for some in (made.narrow, takes))
    assert narrow < 0.2
    assert wider > 0.5


def test_tables_count_right_and_wrong_names_of_sets_alone():
    rows = pd.DataFrame(
        {
            "machine": ["motor", "motor", "two_tanks", "motor"],
            "status": ["set", "set", "set", "no set"],
            "reach": [2.0, 4.0, 8.0, ""],
            "length_share": [0.5, 0.2, 0.1, ""],
            "proposed": ["name", "class", "wrong", ""],
            "random": ["set", "name", "located", ""],
            "repeated": ["set", "set", "set", ""],
            "experiments": [1, 1, 0, ""],
            **{f"ideal_{arm}": [1.0, 1.0, 0.4, np.nan] for arm in ARMS},
        }
    )
    table = summary(rows).set_index("experiment")
    assert table.loc["proposed", "right"] == pytest.approx(2 / 3)
    assert table.loc["proposed", "wrong"] == pytest.approx(1 / 3)
    assert table.loc["proposed", "ideal"] == pytest.approx(0.8)
    assert table.loc["repeated", "right"] == 0.0
    assert table.loc["repeated", ["alone", "other", "p"]].tolist() == [2, 0, 0.5]
    told = as_markdown(summary(rows), rows)
    assert "in cases: 1: 2, 2: 0, 3: 0." in told
    assert "Outcomes after the proposed experiment: name 1, class 1, wrong 1." in told
    assert "| how far it may go: at most 4 times the recordings | 2 | 100 | 50 |" in told
    assert "| how long it may last: more than 0.2 times the recordings | 1 | 100 | 0 |" in told
    assert "Of 4 machines drawn: set 3, no set 1." in told


def test_no_draws_are_refused(capsys: pytest.CaptureFixture[str]):
    assert main(["--draws", "0"]) == 2
    assert "--draws is 0, must be at least 1" in capsys.readouterr().err


def test_a_set_of_what_nobody_tells_apart_is_no_single_name():
    truth = {"cell": "mechanism", "effects": [{"name": "a", "ports": ["p"], "class": ["a", "b"]}]}

    def said(*names: str) -> str:
        finding = {"mechanism": names[0], "indistinguishable_from": list(names[1:]), "port": "p"}
        return judged(truth, SimpleNamespace(to_dict=lambda: {"findings": [finding]}))

    assert [said("a"), said("b"), said("a", "b"), said("a", "c"), said("c")] == ["name", "class", ALIKE, "set", "wrong"]


def test_an_ordinary_recording_is_cut_where_its_inputs_move_most():
    u = np.stack([np.where(np.arange(40) < 30, 0.0, 1.0), np.full(40, 2.0)], axis=1)
    assert np.ptp(liveliest(u, 10, np.array([1.0, 0.0]))[:, 0]) == 1.0
