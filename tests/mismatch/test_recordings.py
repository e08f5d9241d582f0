"""Recordings of any machine: its channels in its units, and the one line that refuses the rest."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from helpers.recording_kinds import BEGAN_NS, write_mdf, write_mdf_groups
from tank_files import TANK, tank_table, write_python, write_recording

from twinbench.common.errors import BadInput
from twinbench.mismatch.model import load_simulator
from twinbench.mismatch.recordings import check_excited, check_measured, read_recordings
from twinbench.mismatch.tracks import prepare

RECORDINGS = Path(__file__).parents[3] / "shared" / "recordings"


@pytest.fixture
def tank(tmp_path: Path):
    return load_simulator(write_python(tmp_path, TANK))


def refused(call, *arguments) -> str:
    with pytest.raises(BadInput) as caught:
        call(*arguments)
    assert "\n" not in str(caught.value)
    return str(caught.value)


def test_inputs_then_outputs_in_the_simulators_units(tmp_path, tank):
    frame = tank_table().assign(extra=1.0, true_level_m=2.0)
    frame["h_m"] *= 100.0
    (recording,) = read_recordings([write_recording(tmp_path, frame)], tank, ["h_m[cm]=h_m"])
    assert recording.channels == ("pump_V", "h_m")
    assert np.allclose(recording.values, tank_table()[["pump_V", "h_m"]])


@pytest.mark.parametrize(
    ("unit", "given", "factor"),
    [
        ("m3/h", "L/min", 0.06),
        ("1", "%", 0.01),
        ("-", "percent", 0.01),
        ("", "1", 1.0),
        ("N*m", "kNm", 1000.0),
        ("m/s2", "cm/s**2", 0.01),
        ("W/K", "kW/K", 1000.0),
        ("mbar", "cmH2O", 0.980665),
        ("mystery", "mystery", 1.0),
    ],
)
def test_units_as_engineers_write_them(tmp_path, unit, given, factor):
    text = TANK.replace('"pump_V", "V", 0.0, 10.0, 3.0', f'"pump_V", "{unit}", 0.0, 1e9, 3.0')
    simulator = load_simulator(write_python(tmp_path, text))
    path = write_recording(tmp_path, tank_table())
    (recording,) = read_recordings([path], simulator, [f"pump_V[{given}]=pump_V"])
    assert np.allclose(recording.values[:, 0], factor * tank_table()["pump_V"], rtol=1e-4)


def test_a_unit_that_pint_does_not_know_is_named(tmp_path):
    simulator = load_simulator(write_python(tmp_path, TANK.replace('"pump_V", "V"', '"pump_V", "mystery"')))
    line = refused(read_recordings, [write_recording(tmp_path, tank_table())], simulator, ["pump_V[V]=pump_V"])
    assert "unknown unit 'mystery'" in line


def test_a_machine_that_lacks_a_sensor(tmp_path):
    simulator = load_simulator(
        write_python(
            tmp_path,
            TANK.replace(
                '(Variable("h_m", "m", 0.0, 2.0, 0.5),)',
                '(Variable("h_m", "m", 0.0, 2.0, 0.5), Variable("h2_m", "m", 0.0, 2.0, 0.5))',
            ).replace("np.array([x[0]])", "np.array([x[0], x[0]])"),
        )
    )
    recordings = read_recordings([write_recording(tmp_path, tank_table())], simulator)
    check_measured(recordings, simulator)
    assert recordings[0].channels == ("pump_V", "h_m", "h2_m")
    assert np.isnan(recordings[0].values[:, 2]).all()
    assert "no column 'LT2'" in refused(read_recordings, [tmp_path / "day.csv"], simulator, ["LT2=h2_m"])


def test_a_slow_machine_may_be_recorded_for_months(tmp_path, tank):
    frame = tank_table(200)
    frame["time_s"] *= 1e5
    (recording,) = read_recordings([write_recording(tmp_path, frame)], tank)
    assert recording.time_s[-1] > 90 * 86400


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (lambda f: f.drop(columns="pump_V"), "no column 'pump_V' for channel pump_V"),
        (lambda f: f.assign(pump_V=np.nan), "input pump_V is empty; fill it in"),
        (lambda f: f[:29], "holds 29 samples, must hold 30; record longer"),
        (lambda f: f.assign(h_m=100.0 * f["h_m"]), "which no such machine shows; is it cm or mm?"),
    ],
)
def test_a_recording_that_cannot_be_used(tmp_path, tank, change, says):
    line = refused(read_recordings, [write_recording(tmp_path, change(tank_table()))], tank)
    assert says in line
    assert "day.csv" in line


def test_an_idle_sensor_may_read_a_little_below_its_zero(tmp_path, tank):
    read_recordings([write_recording(tmp_path, tank_table().assign(h_m=-0.01))], tank)


def test_two_recordings_of_one_name(tmp_path, tank):
    path = write_recording(tmp_path, tank_table())
    assert "two recordings are named day" in refused(read_recordings, [path, path], tank)


@pytest.mark.parametrize("readings", [0, 29])
def test_nothing_to_compare_with(tmp_path, tank, readings):
    frame = tank_table()
    frame.loc[readings:, "h_m"] = np.nan
    recordings = read_recordings([write_recording(tmp_path, frame)], tank)
    assert "none of the outputs (h_m) has 30 readings" in refused(check_measured, recordings, tank)


def test_columns_that_nobody_asked_for_are_offered(tmp_path, tank):
    path = write_recording(tmp_path, tank_table().rename(columns={"h_m": "level"}))
    assert "it has unread columns: level" in refused(check_measured, read_recordings([path], tank), tank)


def test_sensors_that_stand_still(tmp_path, tank):
    recordings = read_recordings([write_recording(tmp_path, tank_table().assign(h_m=0.5))], tank)
    assert "no output moves (h_m)" in refused(check_measured, recordings, tank)


def test_time_in_another_unit_than_the_other_recordings(tmp_path, tank):
    late = tank_table()
    late["time_s"] *= 1000.0
    paths = [write_recording(tmp_path, tank_table(), "day.csv"), write_recording(tmp_path, late, "ms.csv")]
    assert "is its time in ms?" in refused(check_measured, read_recordings(paths, tank), tank)
    (tmp_path / "ms.toml").write_text('[channels]\ntime_s = {column = "time_s", unit = "ms"}\n')
    check_measured(read_recordings(paths, tank), tank)


def test_columns_separated_by_semicolons(tmp_path, tank):
    path = tmp_path / "excel.csv"
    path.write_text("time_s;pump_V;h_m\n" + "".join(f"{k},0;3,5;0,{k % 9}\n" for k in range(40)))
    assert "separates its columns by semicolons" in refused(read_recordings, [path], tank)


def test_no_excitation(tmp_path, tank):
    still = write_recording(tmp_path, tank_table().assign(pump_V=3.0), "still.csv")
    moving = write_recording(tmp_path, tank_table(), "moving.csv")
    assert "no input varies (pump_V)" in refused(check_excited, read_recordings([still], tank), tank)
    check_excited(read_recordings([still, moving], tank), tank)


def test_a_machine_without_inputs_needs_no_excitation(tmp_path):
    text = TANK.replace('(Variable("pump_V", "V", 0.0, 10.0, 3.0),)', "()").replace("theta[1] * u[0] ", "0.0 ")
    simulator = load_simulator(write_python(tmp_path, text))
    recordings = read_recordings([write_recording(tmp_path, tank_table())], simulator)
    assert recordings[0].channels == ("h_m",)
    check_excited(recordings, simulator)


@pytest.mark.skipif(not RECORDINGS.is_dir(), reason="the public recordings are not at hand")
def test_real_recordings_are_read_recordings(tmp_path):
    text = TANK.replace("pump_V", "u_V").replace('"h_m", "m", 0.0, 2.0, 0.5', '"level2_V", "V", 0.0, 10.0, 5.0')
    simulator = load_simulator(write_python(tmp_path, text))
    recordings = read_recordings([RECORDINGS / "cascaded_tanks" / f"{n}.csv" for n in ("train", "test")], simulator)
    assert [r.values.shape for r in recordings] == [(1024, 2), (1024, 2)]
    check_measured(recordings, simulator)
    check_excited(recordings, simulator)


def test_recordings_that_know_their_dates_share_one_clock(tmp_path, tank, caplog):
    rows = tank_table()
    write_mdf(rows, tmp_path / "later.mf4")
    before = pd.Timestamp(BEGAN_NS, tz="Europe/Berlin") - pd.Timedelta(minutes=10)
    stamps = [(before + pd.Timedelta(seconds=s)).isoformat() for s in rows["time_s"] - rows["time_s"][0]]
    paths = [tmp_path / "later.mf4", write_recording(tmp_path, rows.assign(time_s=stamps), "first.csv")]
    later, first = read_recordings(paths, tank)
    assert first.time_s[0] == 0.0
    assert np.allclose(later.time_s, 600.0 + rows["time_s"], rtol=0.0, atol=1e-9)
    assert not caplog.text
    undated = write_recording(tmp_path, rows, "undated.csv")
    begins = [r.time_s[0] for r in read_recordings([*paths, undated], tank)]
    assert begins == [rows["time_s"][0], 0.0, rows["time_s"][0]]
    assert "only some recordings say in UTC when they began; each keeps its own clock" in caplog.text


def test_a_slow_output_beside_fast_channels_asks_for_means(tmp_path, tank):
    """Blocks in which most readings are missing are not compared: such a channel would pass unseen."""
    time_s = 0.1 * np.arange(4000)
    fast = pd.DataFrame({"time_s": time_s, "pump_V": 3.0 + np.sin(time_s / 7.0)})
    slow = pd.DataFrame({"time_s": time_s, "h_m": 0.5 + 0.1 * np.sin(time_s)}).iloc[::10]
    path = tmp_path / "day.mf4"
    write_mdf_groups([fast, slow], path, {"h_m": "m", "pump_V": "V"})
    line = refused(check_measured, read_recordings([path], tank), tank)
    assert "output h_m is read every 1 s, other channels more often; write rate_Hz = 1 into day.toml" in line
    (tmp_path / "day.toml").write_text("rate_Hz = 1\n")
    recordings = read_recordings([path], tank)
    check_measured(recordings, tank)
    (track,) = prepare(recordings, tank)
    assert np.isfinite(track.means).all()
    assert np.array_equal(recordings[0].values[:, 1], slow["h_m"])
