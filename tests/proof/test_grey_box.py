"""The grey box by hand: scipy's integrator where nothing overflows, a form found again, and bad input in one line."""

from __future__ import annotations

import json

import numpy as np
import pandas as pd
import pytest
from scipy.integrate import solve_ivp

from twinbench.proof.grey_box import FORMS, PARAMETERS, fitted, levels, main

PERIOD_S = 4.0
TRUE = {"k1": 0.06, "k2": 0.05, "k3": 0.055, "k4": 0.045}
RIM_V = 4.8


def _values(**changed):
    return np.array([{**{k: v[0] for k, v in PARAMETERS.items()}, **TRUE, **changed}[name] for name in PARAMETERS])


def _recording(seed, values):
    u = np.repeat(np.random.default_rng(seed).uniform(2.0, 5.0, 15), 12)
    read = levels(values, (4.0, 4.0), u, PERIOD_S, 8)
    return pd.DataFrame({"time_s": PERIOD_S * np.arange(u.size), "u_V": u, "level2_V": read})


def test_levels_are_those_of_a_fine_integration():
    values, table = _values(), _recording(1, _values())

    def rates(t, x):
        u = table["u_V"].iloc[min(int(t // PERIOD_S), len(table) - 1)]
        upper, lower = np.sqrt(np.maximum(x, 0.0))
        return [TRUE["k4"] * u - TRUE["k1"] * upper, TRUE["k2"] * upper - TRUE["k3"] * lower]

    time_s = table["time_s"].to_numpy()
    fine = solve_ivp(rates, (0.0, time_s[-1]), [4.0, 4.0], t_eval=time_s, max_step=0.5, rtol=1e-8).y[1]
    np.testing.assert_allclose(levels(values, (4.0, 4.0), table["u_V"].to_numpy(), PERIOD_S, 64), fine, atol=5e-3)


def test_a_level_stops_at_its_rim_and_what_spills_is_kept():
    u = np.full(400, 5.0)
    assert levels(_values(rim2_V=RIM_V), (4.0, 4.0), u, PERIOD_S, 8).max() == RIM_V
    dry, wet = (levels(_values(rim1_V=7.0, spill=s), (4.0, 4.0), u, PERIOD_S, 8) for s in (0.0, 1.0))
    assert wet[-1] > dry[-1] + 0.5


def test_the_form_that_made_a_recording_fits_it_and_predicts_another():
    learnt, held = (_recording(seed, _values(rim2_V=RIM_V)) for seed in (2, 3))
    assert learnt["level2_V"].max() == held["level2_V"].max() == RIM_V
    textbook, overflow = (
        fitted(FORMS[name], learnt, held, 6, 0) for name in ("as the textbook", "the lower tank overflows")
    )
    assert overflow["learnt_V"] < 0.02 < textbook["learnt_V"]
    assert overflow["held_out_V"] < 0.02 < textbook["held_out_V"]
    assert overflow["rim2_V"] == pytest.approx(RIM_V, abs=0.02)
    assert np.isnan(textbook["rim2_V"])


def test_the_command_writes_a_row_for_each_form(tmp_path):
    folder = tmp_path / "recordings" / "cascaded_tanks"
    folder.mkdir(parents=True)
    for seed, name in ((2, "train"), (3, "test")):
        _recording(seed, _values(rim2_V=RIM_V)).to_csv(folder / f"{name}.csv", index=False)
    out = tmp_path / "out"
    assert main(["--recordings", str(folder.parent), "--starts", "1", "--out", str(out)]) == 0
    assert list(pd.read_csv(out / "grey_box.csv")["form"]) == list(FORMS)
    assert json.loads((out / "manifest.json").read_text())["command"].endswith("--starts 1 --seed 0")


@pytest.mark.parametrize("spoilt", ["folder", "column", "starts"])
def test_what_cannot_be_used_is_told_in_one_line(tmp_path, capsys, spoilt):
    folder = tmp_path / "recordings" / "cascaded_tanks"
    folder.mkdir(parents=True)
    if spoilt != "folder":
        pd.DataFrame({"time_s": [0.0], "u_V": [1.0]}).to_csv(folder / "train.csv", index=False)
    asked = ["--recordings", str(folder.parent), "--out", str(tmp_path / "out")]
    assert main([*asked, "--starts", "0" if spoilt == "starts" else "1"]) == 2
    said = capsys.readouterr().err.strip().splitlines()
    assert len(said) == 1
    assert {"folder": "no such recording", "column": "level2_V", "starts": "--starts is 0"}[spoilt] in said[0]
    assert not (tmp_path / "out" / "grey_box.csv").exists()
