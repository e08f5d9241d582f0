"""Recordings come in whole: every format, every unit, uneven time, missing cells, and no truth."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st
from recording_files import table, write

from twinbench.data.benchmark import DesignConfig, design, run
from twinbench.data.recording import Recording, check_overlap, read_recording, truth_table
from twinbench.data.units import convert
from twinbench.machines.compressor import COMPRESSOR

CHANNELS, SAMPLE_PERIOD_S = COMPRESSOR.channels, COMPRESSOR.sample_period_s


@pytest.mark.parametrize("name", ["run.csv", "run.csv.gz", "run.parquet"])
def test_each_format_gives_the_same_numbers(tmp_path, name):
    frame = table()
    recording = read_recording(write(frame, tmp_path, name))
    assert recording.name == "run"
    assert recording.channels == CHANNELS
    assert np.array_equal(recording.time_s, frame["time_s"])
    assert np.array_equal(recording.values, frame[list(CHANNELS)])


def test_dots_in_a_name_stay_so_that_two_recordings_never_share_one(tmp_path):
    names = [read_recording(write(table(), tmp_path, f"run.{k}.csv")).name for k in (1, 2)]
    assert names == ["run.1", "run.2"]


def test_empty_cells_and_nan_mean_missing(tmp_path):
    frame = table()
    frame.loc[2, "p_dis_bar"] = np.nan
    frame["m_flow_kg_s"] = np.nan
    values = read_recording(write(frame, tmp_path)).values
    assert np.isnan(values[2, 4])
    assert np.isnan(values[:, 6]).all()
    assert np.isnan(values).sum() == 1 + len(frame)


def test_map_renames_and_converts(tmp_path):
    frame = table()
    raw = frame.rename(columns={"p_dis_bar": "PT101", "T_dis_K": "Discharge T", "N_rpm": "S1", "time_s": "stamp"})
    raw["PT101"] = frame["p_dis_bar"] * 1e5 / 6894.757293168
    raw["Discharge T"] = (frame["T_dis_K"] - 273.15) * 1.8 + 32.0
    raw["S1"] = frame["N_rpm"] / 60.0
    raw["stamp"] = 1e3 * frame["time_s"]
    mapping = ["PT101[psi]=p_dis_bar", "Discharge T[degF]=T_dis_K", "S1[Hz]=N_rpm", "stamp[ms]=time_s"]
    recording = read_recording(write(raw, tmp_path), mapping)
    assert np.allclose(recording.values, frame[list(CHANNELS)], rtol=1e-9)
    assert np.allclose(recording.time_s, frame["time_s"], rtol=1e-12)


def test_sidecar_renames_and_converts_and_the_command_line_has_the_last_word(tmp_path):
    frame = table().rename(columns={"p_dis_bar": "PT101", "T_suc_K": "TT1"})
    frame["PT101"] *= 100.0
    frame["better"] = table()["p_dis_bar"] + 1.0
    (tmp_path / "run.toml").write_text(
        '[channels]\np_dis_bar = { column = "PT101", unit = "kPa" }\nT_suc_K = "TT1"\nvalve = { unit = "1" }\n'
    )
    path = write(frame, tmp_path)
    assert np.allclose(read_recording(path).values, table()[list(CHANNELS)])
    assert np.allclose(read_recording(path, ["better=p_dis_bar"]).values[:, 4], frame["better"])


@pytest.mark.parametrize(
    ("value", "given", "wanted", "expected"),
    [
        (25.0, "Hz", "rpm", 1500.0),
        (25.0, "1/s", "rpm", 1500.0),
        (1500.0, "1/min", "rpm", 1500.0),
        (50.0 * np.pi, "rad/s", "rpm", 1500.0),
        (95.0, "kPa", "bar", 0.95),
        (20.0, "degC", "K", 293.15),
        (432.0, "kg/h", "kg/s", 0.12),
        (60.0, "percent", "1", 0.6),
    ],
)
def test_conversions_an_engineer_can_do_by_hand(value, given, wanted, expected):
    assert np.allclose(convert(np.array([value]), given, wanted, "here"), expected, rtol=1e-12)


@given(
    st.sampled_from([("bar", "psi"), ("K", "degF"), ("rpm", "Hz"), ("rpm", "rad/s"), ("kg/s", "lb/h")]),
    st.floats(0.01, 1e4),
)
def test_there_and_back_is_the_same_and_order_is_kept(units, value):
    ours, theirs = units
    there = convert(np.array([value, 2.0 * value]), ours, theirs, "here")
    back = convert(there, theirs, ours, "here")
    assert np.allclose(back, [value, 2.0 * value], rtol=1e-9)
    assert there[1] > there[0]


def recorded(time_s: np.ndarray, values: np.ndarray) -> Recording:
    return Recording("run", time_s, ("a", "b"), values)


@given(st.floats(-1e5, 1e5), st.lists(st.floats(-0.02, 0.02), min_size=2, max_size=60), st.randoms())
def test_jittered_stamps_of_a_uniform_recording_lose_and_move_nothing(start, jitter, random):
    jitter[0] = 0.0
    values = np.array([[random.gauss(0.0, 1.0), float(k)] for k in range(len(jitter))])
    values[len(jitter) // 2, 0] = np.nan
    time_s = start + np.arange(len(jitter)) * SAMPLE_PERIOD_S + np.array(jitter)
    batch = recorded(time_s, values).to_batch()
    assert np.array_equal(batch.measured[0], values, equal_nan=True)
    assert np.allclose(batch.time_s, start + np.arange(len(jitter)) * SAMPLE_PERIOD_S)
    assert batch.truth is None


def test_gaps_are_missing_and_of_several_readings_the_nearest_counts():
    time_s = np.array([10.0, 10.05, 10.18, 10.19, 10.21])
    values = np.array([[1.0, 1.0], [2.0, 2.0], [3.0, 3.0], [4.0, np.nan], [5.0, 5.0]])
    batch = recorded(time_s, values).to_batch()
    assert np.allclose(batch.time_s, [10.0, 10.05, 10.1, 10.15, 10.2])
    expected = [[1.0, 1.0], [2.0, 2.0], [np.nan, np.nan], [np.nan, np.nan], [4.0, 5.0]]
    assert np.array_equal(batch.measured[0, :, 0], np.array(expected)[:, 0], equal_nan=True)
    assert np.array_equal(batch.measured[0, :, 1], np.array(expected)[:, 1], equal_nan=True)


def test_channels_that_report_in_turn_all_arrive():
    time_s = np.array([0.0, 0.01, 0.05, 0.06])
    values = np.array([[1.0, np.nan], [np.nan, 2.0], [3.0, np.nan], [np.nan, 4.0]])
    assert recorded(time_s, values).to_batch().measured[0].tolist() == [[1.0, 2.0], [3.0, 4.0]]


@pytest.fixture(scope="module")
def simulated():
    scenario = design(DesignConfig(minutes=1.5, warmup_minutes=0.5))["test"][0]
    return run((scenario,), 0.5)


@pytest.mark.parametrize("name", ["run.csv", "run.csv.gz", "run.parquet"])
def test_a_simulated_recording_comes_back_as_it_was_measured(simulated, tmp_path, name):
    batch = read_recording(write(truth_table(simulated, 0), tmp_path, name)).to_batch()
    assert np.isnan(simulated.measured).any()
    exact = 0.0 if name == "run.parquet" else 1e-15  # pandas 2 reads the last bit of a decimal number at its own risk
    np.testing.assert_allclose(batch.measured, simulated.measured, rtol=exact, equal_nan=True)
    assert np.allclose(batch.time_s, simulated.time_s, atol=1e-12)


def test_truth_is_stripped_at_the_door(simulated, tmp_path):
    frame = truth_table(simulated, 0)
    truth = [c for c in frame.columns if c.startswith("true_")]
    assert len(truth) == 13
    recording = read_recording(write(frame, tmp_path, "with.csv"))
    blind = read_recording(write(truth_table(simulated.without_truth(), 0), tmp_path, "without.csv"))
    assert recording.channels == CHANNELS
    assert recording.to_batch().truth is None
    assert np.array_equal(recording.values, blind.values, equal_nan=True)
    told = json.dumps([recording.name, *recording.channels])
    assert "true_" not in told


def test_recordings_overlap_where_a_measured_channel_is_shared():
    both = recorded(np.array([0.0, 1.0]), np.ones((2, 2)))
    only_b = recorded(np.array([0.0, 1.0]), np.array([[np.nan, 1.0], [np.nan, 2.0]]))
    check_overlap([both, only_b])
    check_overlap([])


def test_other_machines_bring_their_own_channels(tmp_path):
    path = write(pd.DataFrame({"time_s": [0.0, 1.0], "h_m": [1.0, 2.0]}), tmp_path)
    recording = read_recording(Path(path), ["h_m[cm]=h_m"], units={"h_m": "metre"})
    assert recording.values[:, 0].tolist() == [0.01, 0.02]
