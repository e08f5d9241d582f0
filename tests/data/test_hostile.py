"""Files that mean harm, or come from a machine that means nothing by it: one line, soon, and nothing of theirs raw."""

from __future__ import annotations

import gzip
import zipfile

import numpy as np
import pandas as pd
import pytest
from recording_files import TYPICAL, refusal, table, write

from twinbench.common.shown import LONGEST_MESSAGE, as_map, printable, shown
from twinbench.common.toml_file import MOST_TOML_BYTES
from twinbench.data.clock import LONGEST_GAP, SHORT_GAP
from twinbench.data.formats import holdings
from twinbench.data.formats import text as reader
from twinbench.data.recording import read_recording
from twinbench.machines.compressor import COMPRESSOR

YEAR_S = 365.25 * 86400.0


def as_text(frame: pd.DataFrame) -> str:
    return frame.to_csv(index=False)


def spoilt(tmp_path, old: str, new: str) -> object:
    """The file of the small recording with one piece of its text changed."""
    text = as_text(table())
    assert old in text
    path = tmp_path / "run.csv"
    path.write_bytes(text.replace(old, new, 1).encode("utf-8", "surrogateescape"))
    return path


def test_a_gap_of_a_year(tmp_path):
    frame = table(40)
    frame.loc[20:, "time_s"] += YEAR_S
    assert "row 22: 3.156e+07 s have passed since the row before" in refusal(write(frame, tmp_path))


def test_a_gap_of_minutes_is_none(tmp_path):
    frame = table(40)
    frame.loc[20:, "time_s"] += 0.05 * SHORT_GAP * 0.99
    assert len(read_recording(write(frame, tmp_path)).time_s) == 40
    many = table(4000)
    many.loc[2000:, "time_s"] += 0.05 * LONGEST_GAP * 4000 * 0.99
    assert len(read_recording(write(many, tmp_path, "many.csv")).time_s) == 4000


@pytest.mark.parametrize("number", ["1e308", "-1e308", "1" + 400 * "0", "1e400", "3.4028235e38"])
@pytest.mark.parametrize("column", ["p_dis_bar", "time_s"])
def test_a_number_that_no_sensor_shows(tmp_path, number, column):
    frame = table().astype({column: object})
    frame.loc[5, column] = number
    line = refusal(write(frame, tmp_path))
    assert f"row 7, column {column}: " in line
    assert "is no number that a sensor shows" in line


def test_a_number_that_a_unit_makes_too_large(tmp_path):
    frame = table()
    frame["p_dis_bar"] *= 1e29
    assert "check its unit" in refusal(write(frame, tmp_path), "p_dis_bar[GPa]=p_dis_bar")


def test_two_columns_of_one_name(tmp_path):
    frame = table().assign(spare=1.0, other=2.0)
    twice = frame.rename(columns={"other": "p_dis_bar"})
    assert "column p_dis_bar: two columns have that name; rename one" in refusal(write(twice, tmp_path))
    unread = frame.rename(columns={"other": "spare"})
    assert read_recording(write(unread, tmp_path, "spare.csv")).unread == ("spare", "spare")


def test_one_column_for_two_channels(tmp_path):
    path = write(table(), tmp_path)
    line = refusal(path, "p_dis_bar=p_suc_bar")
    assert "column 'p_dis_bar' is read for p_suc_bar and for p_dis_bar" in line
    swapped = read_recording(path, ["p_dis_bar=p_suc_bar", "p_suc_bar=p_dis_bar"])
    assert np.array_equal(swapped.values[:, 4], table()["p_suc_bar"])


def test_one_channel_from_two_columns(tmp_path):
    line = refusal(write(table().assign(a=1.0), tmp_path), "p_suc_bar=p_dis_bar", "a=p_dis_bar")
    assert "channel p_dis_bar is mapped twice" in line
    assert "'p_suc_bar=p_dis_bar'" in line


def test_the_last_bracket_holds_the_unit(tmp_path):
    frame = table().rename(columns={"p_dis_bar": "P[2]", "p_suc_bar": "q [bar]"})
    frame["P[2]"] *= 100.0
    values = read_recording(write(frame, tmp_path), ["P[2][kPa]=p_dis_bar", "q [bar]=p_suc_bar"]).values
    assert np.allclose(values, table()[list(COMPRESSOR.channels)])


def test_a_column_that_is_named_in_whole_is_taken_and_its_unit_asked_about(tmp_path):
    frame = table().rename(columns={"p_dis_bar": "P [psi]"})
    path = write(frame, tmp_path)
    line = refusal(path, "P [psi]=p_dis_bar")
    assert "--map 'P [psi][psi]=p_dis_bar'" in line
    assert "--map 'P [psi][bar]=p_dis_bar'" in line
    assert np.allclose(read_recording(path, ["P [psi][bar]=p_dis_bar"]).values[:, 4], table()["p_dis_bar"])
    assert np.allclose(read_recording(path, ["P [psi][psi]=p_dis_bar"]).values[:, 4], table()["p_dis_bar"] * 0.0689476)


def test_blanks_around_names_are_left_out_and_told(tmp_path, caplog):
    path = spoilt(tmp_path, "p_suc_bar,T_suc_K", " p_suc_bar ,T_suc_K")
    assert np.allclose(read_recording(path).values, table()[list(COMPRESSOR.channels)])
    assert "blanks around column names are left out (' p_suc_bar ')" in caplog.text
    assert "two columns have that name" in refusal(spoilt(tmp_path, "p_suc_bar,T_suc_K", "p_suc_bar, p_suc_bar"))
    blanks = spoilt(tmp_path, "p_suc_bar", " true_p_suc_bar")
    assert "true_" not in refusal(blanks), "truth stays behind the door"


@pytest.mark.parametrize(
    ("coding", "says"),
    [
        ("latin-1", "no UTF-8 text (byte 0xb0"),
        ("utf-16", "is UTF-16 text"),
        ("utf-16-le", "line 1: holds a NUL byte"),
    ],
)
def test_text_in_another_coding(tmp_path, coding, says):
    text = as_text(table().assign(**{"room °C": 20.0}))
    (tmp_path / "run.csv").write_bytes(text.encode(coding))
    assert says in refusal(tmp_path / "run.csv")


def test_a_mark_of_utf_8_is_no_part_of_the_first_name(tmp_path):
    (tmp_path / "run.csv").write_bytes(as_text(table()).encode("utf-8-sig"))
    assert read_recording(tmp_path / "run.csv").unread == ()


def test_a_cell_of_megabytes(tmp_path):
    path = spoilt(tmp_path, "0.05,", "0.05" + "x" * (1 << 21) + ",")
    assert "line 3: is longer than 1,048,576 bytes" in refusal(path)


def test_a_cell_of_megabytes_over_many_lines(tmp_path):
    cell = '"' + "x\n" * (1 << 20) + '"'
    line = refusal(spoilt(tmp_path, "0.05,", f"{cell},"))
    assert "row 3, column time_s: 'x\\nx" in line
    assert len(line) < 400


def test_a_million_columns(tmp_path):
    (tmp_path / "run.csv").write_text("time_s" + "".join(f",c{k}" for k in range(1_000_000)) + "\n")
    assert "line 1: is longer" in refusal(tmp_path / "run.csv")


def test_a_nul_byte_and_its_line(tmp_path):
    assert "line 6: holds a NUL byte" in refusal(spoilt(tmp_path, "\n0.2,", "\n0.1\0,"))


@pytest.mark.parametrize("name", ["run.csv", "run.csv.gz"])
def test_a_file_of_gigabytes(tmp_path, monkeypatch, name):
    monkeypatch.setattr(reader, "MOST_TABLE_BYTES", 1000)
    monkeypatch.setattr(reader, "_CHUNK_BYTES", 400)
    text = as_text(table(100)).encode()
    (tmp_path / name).write_bytes(gzip.compress(text) if name.endswith("gz") else text)
    assert "split it, keep every tenth row" in refusal(tmp_path / name)


@pytest.mark.parametrize("name", ["run.csv", "run.csv.gz", "run.parquet"])
def test_more_cells_than_can_be_read(tmp_path, monkeypatch, name):
    monkeypatch.setattr(holdings, "MOST_CELLS", 700)
    line = refusal(write(table(100), tmp_path, name))
    assert "rows of 8 columns, at most 700 cells can be read; split it" in line


def test_lines_are_measured_across_blocks(tmp_path, monkeypatch):
    """Blocks end anywhere; every block size gives the same verdict."""
    monkeypatch.setattr(reader, "LONGEST_LINE_BYTES", 200)
    fine, wrong = as_text(table(20)), as_text(table(20)).replace("\n0.5,", "\n0.5" + "0" * 200 + ",")
    assert max(map(len, fine.splitlines())) < 200
    for block in (1, 7, 100, 151, 1 << 22):
        monkeypatch.setattr(reader, "_CHUNK_BYTES", block)
        (tmp_path / "run.csv").write_text(fine)
        assert len(read_recording(tmp_path / "run.csv").time_s) == 20
        (tmp_path / "run.csv").write_text(wrong)
        assert "run.csv, line 12: is longer" in refusal(tmp_path / "run.csv")


@pytest.mark.parametrize(
    ("name", "what"),
    [
        ("run.zip", "zip or Excel"),
        ("run.parquet", "Parquet"),
        ("run.csv.gz", "gzip"),
    ],
)
def test_a_csv_that_is_something_else(tmp_path, name, what):
    if name == "run.zip":
        with zipfile.ZipFile(tmp_path / name, "w") as archive:
            archive.writestr("run.csv", as_text(table()))
    else:
        write(table(), tmp_path, name)
    (tmp_path / name).rename(tmp_path / "other.csv")
    assert f"is a {what}" in refusal(tmp_path / "other.csv")


@pytest.mark.parametrize("name", ["run.csv", "run.parquet"])
def test_dates_in_a_channel_are_named(tmp_path, name):
    frame = table()
    frame["p_dis_bar"] = pd.Timestamp("2024-01-01") + pd.to_timedelta(frame["time_s"], unit="s")
    line = refusal(write(frame, tmp_path, name))
    assert "column p_dis_bar: '2024-01-01 00:00:00" in line
    assert "is a date or a time of day, no number; write seconds since the start" in line


@pytest.mark.parametrize("stamp", ["2024-01-01T00:00:00Z", "01.02.2024 00:00", "12:30:01"])
def test_dates_as_people_write_them(tmp_path, stamp):
    assert "write seconds since the start" in refusal(spoilt(tmp_path, "\n0.2,", f"\n{stamp},"))


def test_decimal_commas(tmp_path):
    assert "write a point for the decimal comma" in refusal(spoilt(tmp_path, "\n0.2,", '\n"0,2",'))
    (tmp_path / "all.csv").write_text(as_text(table())[:70].split("\n")[0] + "\n" + "0,05," * 8 + "1\n")
    assert "write points in numbers" in refusal(tmp_path / "all.csv")


def test_lists_in_cells(tmp_path):
    frame = table().astype({"p_dis_bar": object})
    frame["p_dis_bar"] = [[3.1]] * len(frame)
    assert "row 2, column p_dis_bar: '[3.1]' is no number" in refusal(write(frame, tmp_path, "run.parquet"))


RAW = "\x1b[31mp\u202e\n\x07"


def test_no_control_character_of_a_file_gets_out(tmp_path):
    frame = table().rename(columns={"p_dis_bar": RAW})
    for line in (refusal(write(frame, tmp_path)), refusal(tmp_path / "run.csv", f"{RAW}[K]=p_dis_bar")):
        assert line.isprintable()
        assert r"\x1b[31mp\u202e\n\x07" in line


def test_what_is_shown_is_short_and_obeys_nobody():
    assert printable("a\x1b[2Jb\nc°") == r"a\x1b[2Jb\nc°"
    assert len(printable("x" * 10 * LONGEST_MESSAGE)) < 1.1 * LONGEST_MESSAGE
    assert shown("ab\n") == r"'ab\n'"
    assert len(shown("x" * 10_000)) < 100
    assert as_map("it's $(rm)", "bar", "p") == """--map 'it'"'"'s $(rm)[bar]=p'"""
    assert as_map("-x", "bar", "p") == "--map='-x[bar]=p'"


@pytest.mark.parametrize(
    ("name", "says"),
    [
        ("...csv", "no result can be named after this"),
        (".csv", "no result can be named"),
        (".x.csv", "no result"),
        ("a\x1b[31m.csv", "no result"),
        ("a\nb.csv", "no result"),
        ("CON.csv", "Windows keeps CON for a device"),
        ("nul.1.csv", "Windows keeps nul.1"),
        ("x" * 200 + ".csv", "longer than 150 bytes"),
    ],
)
def test_a_name_that_no_result_can_bear(tmp_path, name, says):
    path = tmp_path / name
    write(table(), tmp_path, name)
    with pytest.raises(ValueError, match="name") as caught:
        read_recording(path)
    assert says in str(caught.value)


def test_names_that_only_look_odd_are_read(tmp_path):
    for name in ("-x", "2024-01-01T12:00:00", "[red] $x$", "ü", "run.1", "console"):
        assert read_recording(write(table(), tmp_path, f"{name}.csv")).name == name


@pytest.mark.parametrize(
    ("content", "says"),
    [
        ("x = " + "[" * 100_000, "nested too deep"),
        ("x = " + "9" * 10_000, "not TOML"),
        ("x = 1\0", "not TOML"),
        ("#" + " " * MOST_TOML_BYTES, "bytes; it cannot be"),
        ("[channels]\np_dis_bar = " + "1" + "0" * 400, "63 bits at most"),
        ("[channels]\n" + "\n".join(f'a{k} = "x"' for k in range(1000)), "unknown channel 'a0'"),
        ('[channels]\np_dis_bar = { column = "p_dis_bar", unit = "10**10**10" }', "unknown unit '10**10**10'"),
    ],
)
def test_a_sidecar_that_means_harm(tmp_path, content, says):
    path = write(table(), tmp_path)
    (tmp_path / "run.toml").write_text(content)
    assert says in refusal(path)


def test_a_sidecar_in_another_coding(tmp_path):
    path = write(table(), tmp_path)
    (tmp_path / "run.toml").write_bytes("# °\n[channels]\n".encode("latin-1"))
    assert "not TOML: it is not UTF-8 text" in refusal(path)
    (tmp_path / "run.toml").write_bytes("# °\n[channels]\n".encode("utf-8-sig"))
    assert np.allclose(read_recording(path).values.mean(axis=0), TYPICAL, rtol=0.02)
