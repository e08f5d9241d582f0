"""Every kind of file gives the numbers of the same table as CSV; one that cannot be read is refused in one line."""

from __future__ import annotations

import sys
import tomllib
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from helpers.recording_kinds import ROS, WRITERS, as_read, maps_of, write_mdf_groups, write_tdms
from helpers.refusals import refused
from recording_files import refusal, table, write

from twinbench.data.recording import read_recording
from twinbench.data.units import units_of
from twinbench.machines.compressor import COMPRESSOR

CHANNELS, UNITS = list(COMPRESSOR.channels), units_of(COMPRESSOR)


def uneven() -> pd.DataFrame:
    """Forty samples with digits down to the last, at uneven times, two cells of them missing."""
    rng = np.random.default_rng(5)
    frame = table(40)
    frame[CHANNELS] *= 1.0 + 0.01 * rng.standard_normal((40, len(CHANNELS)))
    frame["time_s"] = np.cumsum(rng.uniform(0.04, 0.06, 40))
    frame.loc[[7, 8], "p_dis_bar"] = np.nan
    return frame


@pytest.mark.parametrize("kind", WRITERS)
def test_each_kind_holds_what_csv_holds_to_the_last_digit(tmp_path, kind):
    frame = uneven()
    WRITERS[kind](frame, tmp_path / f"run{kind}", UNITS)
    found = read_recording(tmp_path / f"run{kind}", maps_of(kind, CHANNELS))
    csv = read_recording(write(frame, tmp_path))
    assert found.name == csv.name == "run"
    np.testing.assert_array_equal(found.values, csv.values)
    np.testing.assert_array_equal(found.time_s, as_read(frame, kind))
    assert csv.zero is None
    assert found.zero is None if kind in (".mat", ".tdms") else found.zero.utc


def test_single_precision_and_whole_numbers_come_as_they_are(tmp_path):
    frame = uneven().fillna(3.0).astype({"p_dis_bar": np.float32, "N_rpm": np.int16})
    for kind in (".mat", ".mf4", ".tdms"):
        WRITERS[kind](frame, tmp_path / f"run{kind}")
        assert np.array_equal(read_recording(tmp_path / f"run{kind}").values, frame[CHANNELS].to_numpy(float)), kind


@pytest.mark.parametrize("kind", [".mf4", ".tdms"])
def test_a_unit_that_the_file_states_is_used_and_a_mapped_one_wins(tmp_path, kind):
    frame = table().assign(N_rpm=table()["N_rpm"] / 60.0)
    path = tmp_path / f"run{kind}"
    WRITERS[kind](frame, path, {**UNITS, "N_rpm": "Hz"})
    assert np.allclose(read_recording(path).values, table()[CHANNELS])
    assert "its median is" in refusal(path, "N_rpm[rpm]=N_rpm")
    WRITERS[kind](frame, path, {"N_rpm": "furlong"})
    assert "the file states that unit, and --map 'N_rpm[rpm]=N_rpm' says another" in refusal(path)
    assert np.allclose(read_recording(path, ["N_rpm[Hz]=N_rpm"]).values, table()[CHANNELS])


def test_channels_of_other_rates_share_one_clock(tmp_path):
    """Two groups of 20 Hz and 4 Hz: the times are united, and a time that is reckoned otherwise stays one row."""
    fast = table(41)
    slow = fast.iloc[::5][["time_s", "p_dis_bar"]].assign(time_s=np.arange(9) * 0.25)
    write_mdf_groups([fast.drop(columns="p_dis_bar"), slow], tmp_path / "run.mf4")
    found = read_recording(tmp_path / "run.mf4")
    assert np.array_equal(found.time_s, fast["time_s"])
    expected = fast[CHANNELS].to_numpy(copy=True)
    expected[np.arange(41) % 5 != 0, CHANNELS.index("p_dis_bar")] = np.nan
    assert np.array_equal(found.values, expected, equal_nan=True)


def test_waveforms_begin_when_they_say(tmp_path):
    noon = np.datetime64("2026-03-01T12:00:00")
    frame = table().drop(columns="time_s")
    write_tdms(frame, tmp_path / "run.tdms", wf_increment=0.05, wf_start_time=noon, wf_start_offset=0.0)
    found = read_recording(tmp_path / "run.tdms")
    assert np.allclose(found.time_s, table()["time_s"], rtol=0.0, atol=1e-15)
    assert np.array_equal(found.values, table()[CHANNELS])
    assert np.datetime64(found.zero.ns, "ns") == noon


def test_structs_and_matrices_of_matlab_are_gone_into(tmp_path):
    from scipy.io import savemat

    frame = table()
    inside = {name: frame[name].to_numpy() for name in CHANNELS[2:]}
    pressure = frame[CHANNELS[:2]].to_numpy()
    content = {"time_s": frame["time_s"].to_numpy(), "run": inside, "P": pressure, "title": "x", "k": np.arange(3.0)}
    savemat(tmp_path / "run.mat", content)
    maps = [f"run.{name}={name}" for name in CHANNELS[2:]]
    found = read_recording(tmp_path / "run.mat", ["P[1]=p_suc_bar", "P[2]=T_suc_K", *maps])
    assert np.array_equal(found.values, frame[CHANNELS])
    assert "vectors that have not 8 samples as most have (k)" in found.notes[0]


@pytest.mark.parametrize(
    ("kind", "module", "package", "extra"),
    [
        (".mf4", "asammdf", "asammdf", "mdf"),
        (".tdms", "nptdms", "npTDMS", "tdms"),
        *((kind, "rosbags.highlevel", "rosbags", "ros") for kind in ROS),
    ],
)
def test_a_library_that_is_not_there_is_named_with_the_extra_that_brings_it(
    tmp_path, monkeypatch, capsys, kind, module, package, extra
):
    WRITERS[kind](table(), tmp_path / f"run{kind}")
    monkeypatch.setitem(sys.modules, module, None)
    says = f"needs {package}; install it with: pip install 'twinbench[{extra}]'"
    assert says in refusal(tmp_path / f"run{kind}")
    assert says in refused(tmp_path, capsys, "look", tmp_path / f"run{kind}")
    extras = tomllib.loads((Path(__file__).parents[2] / "pyproject.toml").read_text())["project"][
        "optional-dependencies"
    ]
    assert [line.split(">=")[0] for line in extras[extra]] == [package]
    assert extra in extras["recordings"][0]


@pytest.mark.parametrize("kind", WRITERS)
def test_damaged_files_are_refused_in_one_line(tmp_path, kind, capfd):
    path = tmp_path / f"run{kind}"
    WRITERS[kind](uneven(), path)
    whole = path.read_bytes()
    for data in (np.random.default_rng(1).bytes(3000), b"\0" * 500, b"x", whole[: len(whole) // 3]):
        path.write_bytes(data)
        assert str(path) in refusal(path)
    assert capfd.readouterr().err == "", "the library's own complaints are not for the user"


def test_what_has_another_kind_of_file_in_it_is_told(tmp_path):
    for kind, what in ((".mat", "MATLAB"), (".mf4", "MDF"), (".tdms", "TDMS"), (".mcap", "MCAP"), (".bag", "ROS")):
        WRITERS[kind](table(), tmp_path / f"other{kind}")
        (tmp_path / f"other{kind}").rename(tmp_path / "run.csv")
        assert f"is a{'n' if what in ('MDF', 'MCAP') else ''} {what}" in refusal(tmp_path / "run.csv")


def test_matlab_7_3_and_older_mdf_are_told_what_to_save_as(tmp_path):
    (tmp_path / "run.mat").write_bytes(b"MATLAB 7.3 MAT-file, written by somebody".ljust(512) + b"\x89HDF\r\n\x1a\n")
    assert "save('run.mat', '-v7')" in refusal(tmp_path / "run.mat")
    (tmp_path / "run.mf4").write_bytes(b"MDF     3.30    asammdf".ljust(200, b"\0"))
    assert "is MDF 3.30; save it as MDF 4" in refusal(tmp_path / "run.mf4")


def test_a_bag_without_the_topic(tmp_path):
    for kind in ROS:
        WRITERS[kind](table()[["time_s", "p_suc_bar"]], tmp_path / f"run{kind}")
        line = refusal(tmp_path / f"run{kind}", "/tank/data=p_suc_bar")
        assert "no column '/tank/data' for channel p_suc_bar; it has: /p_suc_bar/data" in line


@pytest.mark.parametrize("kind", [".mat", ".mf4", ".tdms"])
def test_time_that_goes_backwards(tmp_path, kind):
    frame = table()
    frame["time_s"] = frame["time_s"].to_numpy()[[0, 1, 2, 4, 3, 5, 6, 7]]
    WRITERS[kind](frame, tmp_path / f"run{kind}")
    line = refusal(tmp_path / f"run{kind}")
    assert "does not increase at sample 5" in line if kind == ".mf4" else "row 6: time_s does not increase" in line


def test_no_formula_of_a_file_is_run(tmp_path):
    """The library hands a conversion's formula to Python; what is converted by one is left out unread."""
    hostile = {"formula": f"__import__('pathlib').Path({str(tmp_path / 'owned')!r}).touch()"}
    write_mdf_groups([table()], tmp_path / "run.mf4", conversion=hostile)
    line = refusal(tmp_path / "run.mf4")
    assert "holds no channel with numbers over time" in line
    assert not (tmp_path / "owned").exists()
