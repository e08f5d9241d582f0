"""What a sidecar says of a run: means and where they are stamped, a lower rate, further files, constants."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from helpers.recording_kinds import write_mdf
from recording_files import refusal, table, write

from twinbench.data.recording import files_of, read_recording
from twinbench.machines.compressor import COMPRESSOR

CHANNELS = list(COMPRESSOR.channels)


@pytest.mark.parametrize(("stamp", "later_s"), [("start", 0.02), ("middle", 0.0), ("end", -0.02)])
def test_stamps_of_means_are_moved_to_their_middle(tmp_path, caplog, stamp, later_s):
    (tmp_path / "run.toml").write_text(f"stamp = '{stamp}'\naverage_s = 0.04\n")
    found = read_recording(write(table(), tmp_path))
    assert np.allclose(found.time_s, table()["time_s"] + later_s, rtol=0.0, atol=1e-15)
    assert f"means over 0.04 s, stamped at their {stamp}" in found.notes[0]
    assert found.notes[0] in caplog.text
    assert ("added" in found.notes[0], "taken off" in found.notes[0]) == (later_s > 0.0, later_s < 0.0)


def test_means_take_the_place_of_samples_and_say_so(tmp_path, caplog):
    """At 20 Hz from 1.0 s on, with a gap; a mean goes from one whole multiple of its period to the next."""
    frame = table(40)
    frame["time_s"] += 1.0
    frame.loc[4:7, "p_dis_bar"] = np.nan
    frame.loc[9, "T_dis_K"] = np.nan
    frame = frame.drop(index=range(20, 28))
    (tmp_path / "run.toml").write_text("rate_Hz = 5\n")
    found = read_recording(write(frame, tmp_path))
    parts = frame[CHANNELS].groupby(np.arange(len(frame)) // 4).mean()
    np.testing.assert_allclose(found.values, parts, rtol=1e-13)
    assert np.isnan(found.values).sum() == 1
    assert np.allclose(found.time_s, np.delete(1.1 + 0.2 * np.arange(10), [5, 6]))
    assert "means over 0.2 s (rate_Hz = 5) stand for 32 samples" in caplog.text
    assert found.notes == ("means over 0.2 s (rate_Hz = 5) stand for 32 samples",)


def test_means_keep_a_straight_line_where_it_is(tmp_path):
    frame = table(64).assign(p_dis_bar=3.0 + 0.01 * table(64)["time_s"])
    (tmp_path / "run.toml").write_text("rate_Hz = 2.5\nstamp = 'end'\naverage_s = 0.05\n")
    found = read_recording(write(frame, tmp_path))
    whole = found.time_s[1:-1]
    assert np.allclose(found.values[1:-1, CHANNELS.index("p_dis_bar")], 3.0 + 0.01 * whole, atol=1e-3)


@pytest.mark.parametrize("kind", [".csv", ".mf4"])
def test_files_of_one_run_are_joined(tmp_path, kind):
    whole = table(60)
    parts = {f"part{k}{kind}": whole.iloc[20 * k : 20 * k + 20] for k in range(3)}
    for name, part in parts.items():
        write(part, tmp_path, name) if kind == ".csv" else write_mdf(part, tmp_path / name)
    (tmp_path / "part0.toml").write_text(f"join = {list(parts)[1:]}\n")
    found = read_recording(tmp_path / f"part0{kind}")
    assert np.array_equal(found.time_s, whole["time_s"])
    assert np.array_equal(found.values, whole[CHANNELS])
    assert found.notes == (f"joined of {', '.join(parts)}",)
    told = [(file["role"], Path(file["path"]).name, file["bytes"]) for file in files_of(tmp_path / f"part0{kind}")]
    expected = [*(("recording", name) for name in parts), ("sidecar", "part0.toml")]
    assert told == [(role, name, (tmp_path / name).stat().st_size) for role, name in expected]


def test_dated_files_are_joined_by_their_dates_and_others_on_one_clock(tmp_path):
    frame = table(20)
    stamps = {"a": "2026-03-01T12:00:00", "b": "2026-03-01T12:00:30"}
    for name, begin in stamps.items():
        clock = [str(np.datetime64(begin) + np.timedelta64(50 * k, "ms")) + "Z" for k in range(20)]
        write(frame.assign(time_s=clock), tmp_path, f"{name}.csv")
    (tmp_path / "a.toml").write_text("join = ['b.csv']\n")
    found = read_recording(tmp_path / "a.csv")
    assert np.allclose(found.time_s, np.concatenate([frame["time_s"], 30.0 + frame["time_s"]]))
    write(frame, tmp_path, "b.csv")
    assert "b.csv: its clock is not that of" in refusal(tmp_path / "a.csv")
    write(frame, tmp_path, "a.csv")
    assert "b.csv: begins at 0 s, when the file before it has not ended (0.95 s)" in refusal(tmp_path / "a.csv")
    (tmp_path / "a.toml").write_text("join = ['gone.csv']\n")
    assert "no such file" in refusal(tmp_path / "a.csv")


def test_a_constant_holds_throughout_and_map_has_the_last_word(tmp_path):
    frame = table().assign(TT1=300.0)
    (tmp_path / "run.toml").write_text("[constants]\nT_suc_K = 293.15\n")
    path = write(frame, tmp_path)
    column = CHANNELS.index("T_suc_K")
    assert (read_recording(path).values[:, column] == 293.15).all()
    assert (read_recording(write(frame.drop(columns="T_suc_K"), tmp_path)).values[:, column] == 293.15).all()
    assert (read_recording(path, ["TT1=T_suc_K"]).values[:, column] == 300.0).all()


@pytest.mark.parametrize(
    ("content", "says"),
    [
        ("[constants]\nT_room_K = 293.15\n", "unknown channel 'T_room_K'; choose from p_suc_bar"),
        ("[constants]\nT_suc_K = '20 degC'\n", "constant T_suc_K is '20 degC', must be a number"),
        ("[constants]\nT_suc_K = true\n", "must be a number"),
        ("[constants]\nT_suc_K = nan\n", "must be a number"),
        ("[constants]\nT_suc_K = 20.0\n", "T_suc_K = 20 K, which no such machine shows; give it in that unit"),
        ("[channels]\nT_suc_K = 'x'\n[constants]\nT_suc_K = 293.0\n", "must be a column or a constant, not both"),
        ("[constants]\ntime_s = 0\n", "time_s must be a column or a constant"),
        ("constants = 3\n", "constants must be a table"),
        ("stamp = 'left'\naverage_s = 1\n", "stamp is 'left'; choose from start, middle, end"),
        ("stamp = ['end']\naverage_s = 1\n", "choose from start"),
        ("stamp = 'end'\n", "stamp and average_s must stand together"),
        ("average_s = 3.0\n", "stamp and average_s must stand together"),
        ("stamp = 'end'\naverage_s = 0\n", "average_s is 0, must be above 0"),
        ("rate_Hz = -1\n", "rate_Hz is -1, must be above 0"),
        ("rate_Hz = inf\n", "rate_Hz is 'inf', must be a number"),
        ("rate_Hz = 50\n", "rate_Hz = 50 is above its own rate, 20 Hz"),
        ("rate_Hz = 0.001\n", "leaves one mean; a recording needs at least two"),
        ("join = 'b.csv'\n", "join must be a list of file names"),
        ("join = ['']\n", "join must be a list"),
        ("joined = ['b.csv']\n", "unknown entry 'joined'; choose from [channels]"),
        ("time_zone = '../../etc/passwd'\n", "unknown time_zone"),
    ],
)
def test_what_a_sidecar_cannot_mean(tmp_path, content, says):
    (tmp_path / "run.toml").write_text(content)
    assert says in refusal(write(table(), tmp_path))
