"""``twinbench look`` on signals whose noise, gaps and stretches that stand still are known."""

from __future__ import annotations

import json
import re
import runpy
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from helpers.recording_kinds import write_mdf_groups
from helpers.refusals import refused
from helpers.tiny_run import twinbench

from twinbench.data.look.channel import noise_of
from twinbench.data.look.figure import MOST_CHANNELS, look_figure
from twinbench.data.look.stretches import still
from twinbench.data.look.whole import look

NOISE, PERIOD_S = 0.03, 0.5


@pytest.fixture(scope="module")
def day(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A level with noise that stands still from 500 to 600 s, a pressure that is clipped at 4.5, and a pump in steps.

    Nothing was read between 1000 and 1050 s, and no pressure between 1500 and 1510 s.
    """
    rng = np.random.default_rng(3)
    time_s = PERIOD_S * np.arange(4000)
    level = 5.0 + 2.0 * np.sin(time_s / 60.0) + NOISE * rng.standard_normal(4000)
    level[1001:1201] = level[1000]
    pressure = np.minimum(3.0 + 2.0 * np.sin(time_s / 50.0) + 2 * NOISE * rng.standard_normal(4000), 4.5)
    pressure[3001:3020] = np.nan
    pump = np.repeat(rng.uniform(1.0, 6.0, 100), 40)
    rounded, what = np.round(10.0 * np.sin(time_s / 200.0), 1), np.repeat("ok", 4000)
    columns = {"time_s": time_s, "level": level, "pressure": pressure, "pump": pump, "rounded": rounded, "what": what}
    frame = pd.DataFrame({**columns, "room": 20.0, "valve": (np.sin(time_s / 90.0) > 0.0).astype(int)})
    path = tmp_path_factory.mktemp("look") / "day.csv"
    frame.drop(index=range(2001, 2100)).to_csv(path, index=False)
    return path


def test_a_known_signal_is_seen_as_it_is(day, tmp_path, capsys):
    out = tmp_path / "looked"
    assert twinbench("look", day, "--map", "level[cm]=h_cm", "--out", out, "--json") == 0
    seen = json.loads(capsys.readouterr().out)
    channels = seen["channels"]
    assert (seen["recording"], seen["samples"], seen["period_s"]) == ("day", 3901, PERIOD_S)
    assert seen["gaps"] == [{"begin_s": 1000.0, "end_s": 1050.0}]
    assert seen["no_numbers"] == ["what"]
    assert set(channels) == {"h_cm", "pressure", "pump", "rounded", "room", "valve"}
    assert (channels["h_cm"]["column"], channels["h_cm"]["unit"], channels["pump"]["unit"]) == ("level", "cm", "")
    assert channels["h_cm"]["noise"] == pytest.approx(NOISE, rel=0.05)
    assert channels["pressure"]["noise"] == pytest.approx(2 * NOISE, rel=0.05)
    assert channels["h_cm"]["moves"] == pytest.approx(np.sqrt(2.0), rel=0.05)
    assert channels["h_cm"]["swings"] == pytest.approx(2 * 2000.0 / (60.0 * 2.0 * np.pi), abs=1.5)
    assert channels["room"]["distinct"] == 1
    assert {name: len(c["stuck"]) for name, c in channels.items() if c["stuck"]} == {"h_cm": 1}
    (stuck,) = channels["h_cm"]["stuck"]
    assert (stuck["begin_s"], stuck["end_s"]) == (500.0, 600.0)
    assert {name for name, c in channels.items() if c["clipped"]} == {"pressure"}
    assert all(s["value"] == 4.5 and s["end_s"] - s["begin_s"] > 50.0 for s in channels["pressure"]["clipped"])
    own = {"begin_s": 1500.0, "end_s": 1510.0}
    assert own in channels["pressure"]["gaps"]
    assert own not in channels["h_cm"]["gaps"]
    assert channels["h_cm"]["lost"] == pytest.approx(99 / 4000)
    assert seen["files"] == [str(out / "day.look.png")]
    assert (out / "day.look.png").read_bytes().startswith(b"\x89PNG")


def test_the_page_shows_what_is_said_of_its_example(tmp_path, monkeypatch, capsys):
    page = (Path(__file__).parents[2] / "docs" / "recordings.md").read_text()
    code, line, shown = (re.findall(rf"```{kind}\n(.*?)```", page, re.DOTALL)[0] for kind in ("python", "sh", "text"))
    monkeypatch.chdir(tmp_path)
    (tmp_path / "example.py").write_text(code)
    runpy.run_path("example.py")
    assert twinbench(*line.split()[1:]) == 0
    assert capsys.readouterr().out == shown
    assert (tmp_path / "looked" / "day.look.png").is_file()


def test_people_get_lines(day, capsys):
    assert twinbench("look", day) == 0
    out = capsys.readouterr().out
    assert out.startswith("day: 3,901 rows over 1999.5 s, usually every 0.5 s\n")
    assert "gaps in all channels at once: 1000 to 1050 s (50 s in all)" in out
    assert "pressure has gaps of its own: 1500 to 1510 s (10 s in all)" in out
    assert "level stands still: 500 to 600 s at " in out
    assert "room is 20 throughout" in out
    assert "no numbers: what" in out


def test_rates_units_and_dates_come_from_the_file_and_means_from_its_sidecar(tmp_path, capsys, caplog):
    time_s = 0.01 * np.arange(1000)
    fast = pd.DataFrame({"time_s": time_s, "speed": np.sin(time_s)})
    slow = pd.DataFrame({"time_s": 0.1 * np.arange(100), "T": 20.0 + 0.1 * np.arange(100)})
    write_mdf_groups([fast, slow], tmp_path / "run.mf4", {"speed": "rpm", "T": "degC"})
    assert twinbench("look", tmp_path / "run.mf4", "--json") == 0
    seen = json.loads(capsys.readouterr().out)
    assert seen["begins"] == "2026-03-01T12:00:00.000Z"
    assert [(c["unit"], round(c["period_s"], 9)) for c in seen["channels"].values()] == [("rpm", 0.01), ("degC", 0.1)]
    assert [c["lost"] for c in seen["channels"].values()] == [0.0, 0.0]
    assert seen["gaps"] == []
    (tmp_path / "run.toml").write_text("rate_Hz = 10\n[constants]\nroom = 21.5\n")
    assert twinbench("look", tmp_path / "run.mf4", "--json") == 0
    seen = json.loads(capsys.readouterr().out)
    assert (seen["samples"], seen["channels"]["speed"]["readings"]) == (100, 100)
    assert seen["channels"]["room"]["median"] == 21.5
    assert seen["notes"] == ["means over 0.1 s (rate_Hz = 10) stand for 1,000 samples"]
    assert "means over 0.1 s (rate_Hz = 10) stand for 1,000 samples" in caplog.text


def test_a_gap_beside_a_slow_channel_is_none_of_all_channels(tmp_path, capsys):
    """Read every 10 s, a temperature bridges a gap of 50 s of the others; one of 100 s it shares."""
    time_s = np.delete(0.5 * np.arange(4000), [*range(401, 500), *range(2001, 2200)])
    fast = pd.DataFrame({"time_s": time_s, "a": np.sin(time_s), "b": np.cos(time_s)})
    every_s = np.delete(10.0 * np.arange(200), range(101, 110))
    slow = pd.DataFrame({"time_s": every_s, "T": 20.0 + 0.01 * every_s})
    write_mdf_groups([fast, slow], tmp_path / "run.mf4")
    assert twinbench("look", tmp_path / "run.mf4") == 0
    out = capsys.readouterr().out
    assert "gaps in all channels at once: 1000 to 1100 s (100 s in all)" in out
    assert "a has gaps of its own: 200 to 250 s (50 s in all)" in out
    assert "T has gaps" not in out


def test_the_figure_breaks_lines_at_gaps_and_says_what_it_leaves_out(day):
    seen = look(day)
    figure = look_figure(seen)
    assert [axes.get_title(loc="left") for axes in figure.axes] == list(seen.channels)
    x, y = figure.axes[1].lines[0].get_data()
    at = np.searchsorted(x[np.isfinite(x)], 1025.0)
    assert np.isnan(x[at])
    assert np.nanmax(y) == 4.5
    many = replace(seen, channels=dict.fromkeys(map(str, range(MOST_CHANNELS + 3)), seen.channels["level"]))
    figure = look_figure(replace(many, values=np.repeat(seen.values[:, :1], MOST_CHANNELS + 3, axis=1)))
    assert len(figure.axes) == MOST_CHANNELS
    assert figure.get_suptitle() == f"day, {MOST_CHANNELS} of {MOST_CHANNELS + 3} channels"


def test_a_recording_without_numbers_is_drawn_all_the_same(tmp_path, capsys):
    rows = pd.DataFrame({"time_s": [0.0, 1.0, 2.0], "what": "ok", "never": np.nan})
    for columns in ("what", "never"):
        rows[["time_s", columns]].to_csv(tmp_path / f"{columns}.csv", index=False)
        assert twinbench("look", tmp_path / f"{columns}.csv", "--out", tmp_path) == 0
        assert (tmp_path / f"{columns}.look.png").stat().st_size > 1000
    assert capsys.readouterr().out.count("gaps in all channels at once: none") == 2


def test_what_other_commands_refuse_is_told(tmp_path, capsys):
    pd.DataFrame({"time_s": [0.0, 1.0, 2.0, 1e6], "x": [1.0, 2.0, 3.0, 4.0]}).to_csv(tmp_path / "run.csv", index=False)
    assert twinbench("look", tmp_path / "run.csv") == 0
    assert "other commands refuse it: " in capsys.readouterr().out


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("t,x\n0,1\n1,2\n", "has no column 'time_s'"),
        ("time_s,x\n0,1\n2,2\n1,2\n", "row 4: time_s does not increase"),
        ("time_s,x\n0,1\n", "needs at least two"),
        ("", "is empty"),
    ],
)
def test_what_cannot_be_looked_at_is_one_line(tmp_path, capsys, text, says):
    (tmp_path / "run.csv").write_text(text)
    assert says in refused(tmp_path, capsys, "look", tmp_path / "run.csv", "--out", tmp_path / "out")


def test_noise_is_that_of_white_noise_whatever_moves_beneath_it():
    rng = np.random.default_rng(1)
    time_s = np.arange(20_000.0)
    steps = np.repeat(rng.uniform(-50.0, 50.0, 100), 200)
    values = 0.2 * rng.standard_normal(20_000) + 5.0 * np.sin(time_s / 300.0) + steps
    assert noise_of(time_s, values) == pytest.approx(0.2, rel=0.03)
    assert noise_of(time_s[:2], values[:2]) is None


@pytest.mark.parametrize("seed", range(5))
def test_what_moves_as_it_always_does_does_not_stand_still(seed):
    """Set points in steps, rounded waves and slow rounded drifts repeat themselves, and are no fault."""
    rng = np.random.default_rng(seed)
    time_s = np.arange(5000.0)
    wave = np.round(np.sin(time_s / rng.uniform(50, 500)) * rng.uniform(1, 20), 1)
    steps = np.repeat(rng.uniform(0, 5, 500), rng.integers(1, 20, 500))[:5000]
    drift = np.round(np.cumsum(rng.standard_normal(5000)) * 0.02, 1)
    noisy = np.round(20.0 + 0.05 * rng.standard_normal(5000), 1)
    for values in (wave, steps, drift, noisy):
        assert still(time_s[: len(values)], values) == []
