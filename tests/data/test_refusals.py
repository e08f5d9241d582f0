"""What cannot be used is refused in one line that says what, where and how to mend it."""

from __future__ import annotations

import gzip

import numpy as np
import pandas as pd
import pytest
from recording_files import refusal, table, write

from twinbench.common.errors import BadInput
from twinbench.data.recording import Recording, check_overlap, read_recording
from twinbench.machines.compressor import COMPRESSOR


def spoilt(column: str, row: int, value: object) -> pd.DataFrame:
    frame = table().astype({column: object})
    frame.loc[row, column] = value
    return frame


def test_a_missing_file(tmp_path):
    assert "no such file" in refusal(tmp_path / "run.csv")
    assert "no such file" in refusal(tmp_path / f"{'a' * 300}.csv")


def test_a_folder(tmp_path):
    assert "folder" in refusal(tmp_path)


def test_another_kind_of_file(tmp_path):
    path = tmp_path / "run.xlsx"
    path.write_bytes(b"PK")
    assert "unknown kind" in refusal(path)


@pytest.mark.parametrize("name", ["run.csv", "run.csv.gz", "run.parquet"])
def test_an_empty_file(tmp_path, name):
    (tmp_path / name).write_bytes(b"")
    assert "is empty" in refusal(tmp_path / name)


def test_an_empty_file_inside_gzip(tmp_path):
    (tmp_path / "run.csv.gz").write_bytes(gzip.compress(b""))
    assert "is empty" in refusal(tmp_path / "run.csv.gz")


@pytest.mark.parametrize("name", ["run.csv", "run.parquet"])
def test_a_header_without_rows(tmp_path, name):
    assert "no rows" in refusal(write(table(0), tmp_path, name))


def test_a_single_row(tmp_path):
    assert "at least two" in refusal(write(table(1), tmp_path))


@pytest.mark.parametrize("name", ["run.parquet", "run.csv.gz"])
@pytest.mark.parametrize("share", [0.1, 0.5, 0.95])
def test_a_file_cut_short(tmp_path, name, share):
    path = write(table(500), tmp_path, name)
    whole = path.read_bytes()
    path.write_bytes(whole[: int(share * len(whole))])
    assert "cut short" in refusal(path)


def test_a_damaged_gzip(tmp_path):
    path = write(table(500), tmp_path, "run.csv.gz")
    whole = bytearray(path.read_bytes())
    whole[len(whole) // 2 : len(whole) // 2 + 200] = bytes(200)
    path.write_bytes(whole)
    assert "cut short" in refusal(path)


def test_bytes_that_are_no_text(tmp_path):
    (tmp_path / "run.csv").write_bytes(bytes(range(128, 256)) * 4)
    assert "no UTF-8 text" in refusal(tmp_path / "run.csv")


def test_rows_longer_than_the_header(tmp_path):
    path = write(table(), tmp_path)
    header, *rows = path.read_text().splitlines()
    path.write_text("\n".join([header, *(row + "," for row in rows)]))
    assert "more cells" in refusal(path)


@pytest.mark.parametrize("channel", COMPRESSOR.channels)
def test_a_missing_channel_and_what_there_is_instead(tmp_path, channel):
    line = refusal(write(table().rename(columns={channel: "PT101"}), tmp_path))
    assert f"channel {channel}" in line
    assert "PT101" in line
    assert f"--map COLUMN={channel}" in line


def test_no_time(tmp_path):
    assert "'time_s'" in refusal(write(table().drop(columns="time_s"), tmp_path))


def test_truth_can_be_neither_mapped_nor_named_in_a_complaint(tmp_path):
    frame = table().rename(columns={"p_dis_bar": "true_p_dis_bar"})
    path = write(frame, tmp_path)
    assert "no column 'true_p_dis_bar'" in refusal(path, "true_p_dis_bar=p_dis_bar")
    assert "true_" not in refusal(path)


def test_an_unknown_channel_on_the_command_line(tmp_path):
    line = refusal(write(table(), tmp_path), "p_dis_bar=p_discharge")
    assert "unknown channel 'p_discharge'" in line
    assert "p_dis_bar" in line


@pytest.mark.parametrize("item", ["p_dis_bar", "=p_dis_bar", "PT101=", "="])
def test_a_mapping_that_maps_nothing(tmp_path, item):
    assert "COLUMN=channel" in refusal(write(table(), tmp_path), item)


@pytest.mark.parametrize(
    ("content", "says"),
    [
        ('[channels]\np_discharge = "PT101"\n', "unknown channel 'p_discharge'"),
        ("[channels\n", "not TOML"),
        ("channels = 3\n", "[channels]"),
        ('[chanels]\np_dis_bar = "PT101"\n', "[channels]"),
        ("[channels]\np_dis_bar = 7\n", "column and unit only"),
        ('[channels]\np_dis_bar = { colum = "PT101" }\n', "column and unit only"),
        ("[channels]\np_dis_bar = { unit = 7 }\n", "column and unit only"),
    ],
)
def test_a_sidecar_that_says_nothing_useful(tmp_path, content, says):
    (tmp_path / "run.toml").write_text(content)
    line = refusal(write(table(), tmp_path))
    assert says in line
    assert "run.toml" in line


@pytest.mark.parametrize("unit", ["flurb", "bargg", "kg/", "(", "5 psi", "kg/h)"])
def test_an_unknown_unit(tmp_path, unit):
    line = refusal(write(table(), tmp_path), f"p_dis_bar[{unit}]=p_dis_bar")
    assert f"unknown unit {unit!r}" in line
    assert "column p_dis_bar" in line


@pytest.mark.parametrize(("channel", "unit"), [("p_dis_bar", "K"), ("N_rpm", "kg"), ("m_flow_kg_s", "m^3/h")])
def test_a_unit_of_another_kind(tmp_path, channel, unit):
    assert "cannot be turned into" in refusal(write(table(), tmp_path), f"{channel}[{unit}]={channel}")


@pytest.mark.parametrize(
    ("channel", "factor", "shift", "hint"),
    [
        ("p_suc_bar", 100.0, 0.0, "kPa"),
        ("p_dis_bar", 100.0, 0.0, "kPa"),
        ("T_suc_K", 1.0, -273.15, "degC"),
        ("N_rpm", 1 / 60.0, 0.0, "Hz"),
        ("valve", 100.0, 0.0, "percent"),
        ("m_flow_kg_s", 3600.0, 0.0, "kg/h"),
        ("m_flow_kg_s", -1.0, 0.0, "kg/h"),
    ],
)
def test_numbers_that_betray_another_unit(tmp_path, channel, factor, shift, hint):
    frame = table()
    frame[channel] = factor * frame[channel] + shift
    frame = frame.rename(columns={channel: "TAG 1"})
    line = refusal(write(frame, tmp_path), f"TAG 1={channel}")
    assert hint in line
    assert f"--map 'TAG 1[UNIT]={channel}'" in line


@pytest.mark.parametrize("stamp", [0.1, 0.05])
def test_time_that_goes_back_or_stands(tmp_path, stamp):
    line = refusal(write(spoilt("time_s", 3, stamp), tmp_path))
    assert "row 5: time_s does not increase" in line


def test_time_that_is_missing(tmp_path):
    assert "row 5: time_s is missing" in refusal(write(spoilt("time_s", 3, np.nan), tmp_path))


@pytest.mark.parametrize(("unit", "factor"), [("ms", 1e3), ("us", 1e6), ("ns", 1e9)])
@pytest.mark.parametrize("since_s", [0.0, 1.7e9])
def test_time_in_parts_of_a_second(tmp_path, unit, factor, since_s):
    frame = table(40)
    frame["time_s"] = ((frame["time_s"] + since_s) * factor).astype("int64")
    path = write(frame.rename(columns={"time_s": "-stamp"}), tmp_path)
    assert f"looks like {unit}" in refusal(path, "-stamp=time_s")
    assert f"--map='-stamp[{unit}]=time_s'" in refusal(path, "-stamp=time_s")
    told = read_recording(path, [f"-stamp[{unit}]=time_s"])
    assert np.allclose(told.time_s - told.time_s[0], table(40)["time_s"], atol=1e-6)


@pytest.mark.parametrize("text", ["Bad", "3,1", "1.2.3", "inf", "-inf"])
@pytest.mark.parametrize("column", ["p_dis_bar", "time_s"])
def test_text_in_a_number_column(tmp_path, column, text):
    line = refusal(write(spoilt(column, 4, text), tmp_path))
    assert f"row 6, column {column}: '{text}' is no number" in line


def test_text_in_a_number_column_of_parquet(tmp_path):
    frame = table()
    frame["p_dis_bar"] = frame["p_dis_bar"].astype(str)
    frame.loc[4, "p_dis_bar"] = "Bad"
    assert "row 6, column p_dis_bar: 'Bad'" in refusal(write(frame, tmp_path, "run.parquet"))


@pytest.mark.parametrize("value", [1350.0, np.nan])
def test_a_channel_that_is_constant_or_empty_is_read(tmp_path, value):
    frame = table()
    frame["N_rpm"] = value
    assert read_recording(write(frame, tmp_path)).values.shape == (len(frame), 7)


def test_recordings_that_share_no_measured_channel():
    time_s = np.array([0.0, 1.0])
    first = Recording("monday", time_s, ("a", "b"), np.array([[1.0, np.nan], [2.0, np.nan]]))
    second = Recording("tuesday", time_s, ("a", "b"), np.array([[np.nan, 1.0], [np.nan, 2.0]]))
    with pytest.raises(BadInput, match="monday and tuesday share no measured channel; estimate them one by one"):
        check_overlap([first, second])
