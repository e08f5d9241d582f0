"""Dates as ISO 8601 writes them: zones, daylight saving time, and one clock for several recordings."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest
from helpers.recording_kinds import BEGAN_NS, write_tdms
from recording_files import refusal, table, write

from twinbench.data.recording import read_recording

NOON = "2026-03-01T12:00:00"


def dated(stamps, name: str = "time_s") -> pd.DataFrame:
    """The small recording with these times."""
    frame = table(len(stamps)).drop(columns="time_s")
    frame.insert(0, name, list(stamps))
    return frame


@pytest.mark.parametrize(
    ("stamps", "ns"),
    [
        ([f"{NOON}Z", "2026-03-01T13:00:00.25+01:00", "2026-03-01 12:00:01,5-00:00".replace(",", ".")], BEGAN_NS),
        (["2026-03-01T07:00:00.000000001-0500", "2026-03-01T07:00:00.250000001-0500", f"{NOON[:-2]}01.500000001Z"],
         BEGAN_NS + 1),
    ],
)  # fmt: skip
def test_dates_of_any_zone_are_seconds_since_the_first_to_the_nanosecond(tmp_path, stamps, ns):
    found = read_recording(write(dated(stamps), tmp_path))
    assert found.time_s.tolist() == [0.0, 0.25, 1.5]
    assert found.zero == (ns, True)


@pytest.mark.parametrize("name", ["run.csv", "run.parquet", "run.tdms"])
def test_dates_come_from_columns_of_every_kind_and_may_be_mapped(tmp_path, name):
    stamps = pd.Timestamp(NOON) + pd.to_timedelta(table(40)["time_s"], unit="s")
    frame = dated(stamps, "stamp")
    if name == "run.tdms":
        write_tdms(frame.astype({"stamp": "datetime64[us]"}), tmp_path / name)
    else:
        write(frame, tmp_path, name)
    found = read_recording(tmp_path / name, ["stamp=time_s"])
    assert found.time_s.tolist() == table(40)["time_s"].round(9).tolist()
    assert found.zero == (BEGAN_NS, name == "run.tdms"), "TDMS counts in UTC; the others do not say"


def test_naive_dates_are_taken_as_they_are_unless_a_zone_is_told(tmp_path):
    """In Berlin the clock was set from 2 to 3 o'clock on 2026-03-29, and on 2026-10-25 from 3 to 2."""
    spring = ["2026-03-29T01:59:00", "2026-03-29T01:59:59", "2026-03-29T03:00:00"]
    path = write(dated(spring), tmp_path)
    assert read_recording(path, period_s=np.inf).time_s.tolist() == [0.0, 59.0, 3660.0]
    (tmp_path / "run.toml").write_text("time_zone = 'Europe/Berlin'\n")
    found = read_recording(path, period_s=np.inf)
    assert found.time_s.tolist() == [0.0, 59.0, 60.0]
    assert np.datetime64(found.zero.ns, "ns") == np.datetime64("2026-03-29T00:59")


def test_the_hour_that_comes_twice(tmp_path):
    autumn = ["2026-10-25T02:30:00", "2026-10-25T02:59:59", "2026-10-25T02:00:00", "2026-10-25T02:30:00"]
    path = write(dated(autumn), tmp_path)
    line = refusal(path)
    assert "row 4: time_s does not increase; was the clock set back?" in line
    (tmp_path / "run.toml").write_text("time_zone = 'Europe/Berlin'\n")
    assert read_recording(path, period_s=np.inf).time_s.tolist() == [0.0, 1799.0, 1800.0, 3600.0]
    never = write(dated(["2026-03-29T02:30:00", "2026-03-29T03:30:00"]), tmp_path, "run.csv")
    assert "clocks in Europe/Berlin do not show '2026-03-29 02:30:00" in refusal(never)
    (tmp_path / "run.toml").write_text("time_zone = 'Mars/Olympus'\n")
    assert "unknown time_zone 'Mars/Olympus'; name one of the tz database" in refusal(never)


@pytest.mark.parametrize(
    ("stamps", "says"),
    [
        ([f"{NOON}Z", "2026-03-01T12:00:01"], "row 3: some dates name a zone and some do not"),
        ([f"{NOON}Z", "2026-03-01T12:00:61Z"], "row 3: time_s '2026-03-01T12:00:61Z' is no date as ISO 8601 writes it"),
        ([f"{NOON}Z", "17.3"], "row 3"),
        (["17.3", f"{NOON}Z"], "is a date or a time of day, no number"),
        ([f"{NOON}Z", f"{NOON}Z"], "row 3: time_s does not increase; sort the rows by time"),
        ([f"{NOON}Z", None], "row 3: time_s is missing"),
        (["0001-01-01T00:00:00Z", f"{NOON}Z"], "too far from ours"),
    ],
)
def test_dates_that_are_none(tmp_path, stamps, says):
    assert says in refusal(write(dated(stamps), tmp_path))
