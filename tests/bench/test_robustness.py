"""Harder conditions in the runner: who is tried under what, and what is kept."""

from __future__ import annotations

from collections import Counter

import pandas as pd
import pytest
from helpers.tiny_run import parts, twinbench, write_estimator, write_profile

from twinbench.bench import robustness
from twinbench.bench.cells import make_cell
from twinbench.bench.profile import load_profile
from twinbench.data.disturb import CONDITIONS, FAULTS, Condition


def trials(out):
    """Finished trials and when they were written."""
    return {name: when for name, when in parts(out).items() if name.startswith("store/trial/")}


def test_everyone_is_tried_under_everything_with_every_seed_that_draws(tmp_path):
    profile = load_profile(str(write_profile(tmp_path)))
    names = ("oracle", "deeponet_kalman", "deeponet_kalman:no_gate")
    done = [make_cell(name, seed, profile) for name in names for seed in (0, 1)]
    planned = robustness.trials(done, profile)
    tried = Counter(t.cell.estimator for t in planned)
    assert tried["deeponet_kalman"] == 2 * (len(CONDITIONS) + 1)
    assert tried["oracle"] == len(CONDITIONS) + 1  # it draws nothing: its seeds are one
    assert tried["deeponet_kalman:no_gate"] == 0
    treated = {t.cell.estimator for t in planned} - set(names)
    assert treated == {f"deeponet_kalman:{name}" for name in robustness.TREATMENTS}
    assert len({t.key for t in planned}) == len(planned)


def test_a_run_under_harder_conditions_keeps_its_trials(tmp_path, monkeypatch):
    few = (Condition("fault", "loss", fault=FAULTS[-1]), Condition("pace", "fast", pace=2.0))
    monkeypatch.setattr(robustness, "conditions", lambda machine: few)
    out, profile = tmp_path / "out", write_profile(tmp_path, updates=3)
    arguments = ("run", "--profile", profile, "--out", out, "--robustness", "--only")
    arguments = (*arguments, write_estimator(tmp_path, "steady"))
    assert twinbench(*arguments) == 0
    table = pd.read_csv(out / "robustness.csv")
    assert list(table.columns) == robustness.COLUMNS
    assert set(table["condition"]) == {"none", "loss", "fast"}
    assert set(robustness.METRICS) <= set(table["metric"])
    assert table.groupby("condition")["sequence"].nunique().eq(3).all()
    before = trials(out)
    assert len(before) == 3
    assert twinbench(*arguments) == 0
    assert trials(out) == before


def test_a_trial_that_fails_is_reported_and_the_others_go_on(tmp_path, monkeypatch, capsys):
    all_lost = Condition("fault", "all lost", fault=FAULTS[-1])
    few = (Condition("pace", "fast", pace=2.0), all_lost)
    monkeypatch.setattr(robustness, "conditions", lambda machine: few)
    out, profile = tmp_path / "out", write_profile(tmp_path)
    breaks = "if np.isnan(sample.measured).all(): raise FloatingPointError('lost')"
    spec = write_estimator(tmp_path, "fragile", step=breaks)
    assert twinbench("run", "--profile", profile, "--out", out, "--robustness", "--only", spec) == 1
    assert "robustness: all lost: FloatingPointError: lost" in capsys.readouterr().out
    assert set(pd.read_csv(out / "robustness.csv")["condition"]) == {"none", "fast"}


@pytest.mark.parametrize("condition", CONDITIONS[::9], ids=lambda c: c.name)
def test_every_condition_has_a_key_of_its_own(condition, tmp_path):
    profile = load_profile(str(write_profile(tmp_path)))
    cell = make_cell("oracle", 0, profile)
    other = CONDITIONS[0] if condition is not CONDITIONS[0] else CONDITIONS[1]
    assert robustness._trial(cell, condition, profile).key != robustness._trial(cell, other, profile).key
