"""A recorded run comes out again to the bit, one bit of a reading is noticed at its tick, and no other file passes."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from helpers.compiled import doubled
from helpers.prose import ROOT
from helpers.tiny_run import twinbench, write_estimator

from twinbench.bench.cells import make_cell
from twinbench.bench.profile import load_profile
from twinbench.bench.registry import find
from twinbench.bench.replay.loaded import with_loaded_code
from twinbench.bench.replay.record import Record
from twinbench.bench.replay.recorder import Recorder
from twinbench.common.store import Store
from twinbench.machines.compressor import COMPRESSOR
from twinbench.methods.deeponet_kalman.method import DeepONetKalman
from twinbench.methods.deeponet_kalman.online import Online

COMMITTED = ROOT / "results/replay/deeponet_kalman.npz"
NEAR_SD = 1e-3
"""Another processor sums single precision in another order, and the filter carries that on and adapts by it. Compiled
for a processor without wide vectors, the run lies 2e-5 off. The rest is room for other versions, nothing that shows.
"""
TICKS, FLIPPED = 1200, 700
P_DIS = COMPRESSOR.channels.index("p_dis_bar")


@pytest.fixture(scope="module")
def committed() -> Record:
    return Record.load(COMMITTED)


@pytest.fixture(scope="module")
def twin(committed) -> DeepONetKalman:
    return committed.estimator(DeepONetKalman, COMPRESSOR)


@pytest.fixture(scope="module")
def short(committed, twin, tmp_path_factory) -> Path:
    """The beginning of the committed run, recorded here by the command, every tenth tick in full."""
    folder = tmp_path_factory.mktemp("short")
    profile = load_profile("quick")
    Store(folder / "run/store").put("fit", make_cell(twin.name, profile.seeds[0], profile).fit, twin.save)
    table = pd.DataFrame(committed.measured[:TICKS], columns=COMPRESSOR.channels).assign(
        time_s=committed.time_s[:TICKS]
    )
    table.to_csv(folder / "plant.csv", index=False)
    out, every = folder / "run.npz", ("--every", 10)
    assert twinbench("record", twin.name, folder / "plant.csv", "--results", folder / "run", "--out", out, *every) == 0
    return out


@pytest.fixture(scope="module")
def made(tmp_path_factory) -> tuple[str, Path]:
    folder = tmp_path_factory.mktemp("made")
    spec = write_estimator(folder, "steady", step="state = state._replace(mean=state.mean + sample.measured[:, :1])")
    estimator = find(spec)()
    estimator.arrays = {"mean": np.arange(1.0, 11.0), "cov": 4.0 * np.eye(10)}
    recorder, rng = Recorder(estimator), np.random.default_rng(0)
    for k in range(20):
        recorder.update(0.05 * k, rng.normal(size=7), np.full(7, 0.01) if k % 2 else None)
    recorder.record().save(folder / "steady.npz")
    return spec, folder / "steady.npz"


@pytest.fixture
def steady(made, tmp_path) -> tuple[str, Path]:
    """An estimator in a file of somebody's, and its record of twenty ticks, all in full; every other one is late."""
    spec, path = made
    return spec, Path(shutil.copy(path, tmp_path))


def test_the_committed_run_comes_out_as_it_was():
    """To the bit where it was made; elsewhere as near as another processor or other versions allow.

    In a process of its own: what is compiled in this one has other last bits.
    """
    command = [sys.executable, "-m", "twinbench", "replay", str(COMMITTED), "--within", str(NEAR_SD), "--json"]
    ended = subprocess.run(command, capture_output=True, text=True)
    told = json.loads(ended.stdout)
    assert ended.returncode == 0, told
    assert (told["ticks"], told["kept"]) == (18_000, 90)
    assert told["equal"] or told["elsewhere"], told


def test_what_is_recorded_here_is_replayed_here_to_the_bit(short, capsys):
    assert twinbench("replay", short) == 0
    assert capsys.readouterr().out == f"{short}: {TICKS} ticks, equal to the bit\n"


def test_the_estimator_in_place_says_the_same_bits(short, committed, twin):
    record, online = Record.load(short), Online(twin)
    assert np.array_equal(record.measured, committed.measured[:TICKS], equal_nan=True)
    for k, readings in enumerate(record.measured):
        online.update(readings)
        if k % 10 == 0:
            for name, values in {**online.state._asdict(), **online.info._asdict()}.items():
                if name != "memory":
                    assert values[0].tobytes() == record.said[name][k // 10].tobytes(), (name, k)


@pytest.mark.parametrize("tick", [FLIPPED, FLIPPED + 5])
def test_one_bit_of_one_reading_is_noticed_at_its_tick(short, tmp_path, capsys, tick):
    record = Record.load(short)
    measured = record.measured.copy()
    assert not np.isnan(measured[tick, P_DIS])
    # 1e-12 of it: too little to round a network's sums otherwise, on whichever processor.
    measured.view(np.uint64)[tick, P_DIS] ^= 1 << 12
    replace(record, measured=measured).save(tmp_path / "flipped.npz")
    assert twinbench("replay", tmp_path / "flipped.npz", "--json") == 1
    told = json.loads(capsys.readouterr().out)
    assert (told["equal"], told["passed"], told["first_tick"]) == (False, False, tick)
    assert told["first_time_s"] == pytest.approx(0.05 * tick)
    assert told["seen"]["tick"] >= tick
    assert (told["elsewhere"], told["other_code"]) == ([], False)
    assert 0.0 < told["distance_sd"] < 1e-6
    assert twinbench("replay", tmp_path / "flipped.npz", "--within", 1e-6) == 0
    assert f"differs from tick {tick} (" in capsys.readouterr().out


def test_an_estimator_of_ones_own_is_replayed_from_its_file_and_the_quantity_is_named(steady, tmp_path, capsys):
    spec, path = steady
    assert twinbench("replay", path, "--estimator", spec) == 0
    record = Record.load(path)
    said = {name: values.copy() for name, values in record.said.items()}
    said["mean"][7, 8] += 0.5
    said["cov"][9, 2, 3] = 1.2
    checksums = record.checksums.copy()
    checksums[[7, 9]] += 1
    about = {**record.about, "code": "other", "place": {**record.about["place"], "numba": "0.1"}}
    replace(record, said=said, checksums=checksums, about=about).save(path)
    capsys.readouterr()
    assert twinbench("replay", path, "--estimator", spec, "--within", 0.2) == 1
    now, then = float(record.said["mean"][7, 8]), float(said["mean"][7, 8])
    first, far, where, code, not_within = capsys.readouterr().out.splitlines()
    assert f"differs from tick 7 (0.35 s) on: heat_transfer was {then!r}, is {now!r}" in first
    assert "0.3 recorded standard deviations, covariance of T_gas_K and T_wall_K at tick 9" in far
    assert "numba 0.1 (here " in where
    assert "code" in code
    assert "not within 0.2" in not_within


def test_a_change_that_is_meant_becomes_the_record(steady, tmp_path):
    spec, path = steady
    changed = tmp_path / "steady.py"
    changed.write_text(Path(spec).read_text().replace("sample.measured[:, :1]", "2.0 * sample.measured[:, :1]"))
    assert twinbench("replay", path, "--estimator", changed, "--out", tmp_path / "now.npz") == 1
    assert twinbench("replay", tmp_path / "now.npz", "--estimator", changed) == 0


def test_what_is_carried_on_counts_too(steady, capsys):
    spec, path = steady
    record = Record.load(path)
    checksums = record.checksums.copy()
    checksums[4] ^= np.uint64(1)
    replace(record, checksums=checksums).save(path)
    assert twinbench("replay", path, "--estimator", spec) == 1
    assert "differs from tick 4 (0.2 s) on: what is carried to the next tick" in capsys.readouterr().out


def test_what_compiles_is_done_again_in_a_new_process():
    first, compiled_in = with_loaded_code(doubled, 1.0)
    again, loaded_in = with_loaded_code(doubled, 1.0)
    assert (first, again) == (2.0, 2.0)
    assert loaded_in == os.getpid() != compiled_in


def cut(path):
    path.write_bytes(path.read_bytes()[:-400])


def spoilt(path):
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 255
    path.write_bytes(content)


def other(**changed):
    """A record in which something is different, or another estimator's is."""

    def spoil(path):
        record = Record.load(path)
        about = {**record.about, **{k: v for k, v in changed.items() if k in record.about}}
        replace(record, about=about, **{k: v for k, v in changed.items() if k not in about}).save(path)

    return spoil


REFUSED = {
    "gone": (lambda path: path.unlink(), "No such file or directory"),
    "text": (lambda path: path.write_text("time_s,h\n0,1\n"), "no record of an online run; give a file that"),
    "arrays": (lambda path: np.savez(path, z=np.zeros(3)), "no record of an online run; give a file that"),
    "cut short": (cut, "cut short or damaged"),
    "spoilt": (spoilt, "cut short or damaged"),
    "later version": (other(record_version=2), "a record of version 2, this twinbench reads version 1"),
    "other model": (other(model=b"PK of another"), "its model is not the one that was recorded"),
    "other machine": (other(channels=["a", "b", "c", "d", "e", "f", "g"]), "a record of another compressor"),
    "no such machine": (other(machine="mill"), "the machine 'mill' is not built in; name its file with --machine"),
    "fewer readings": (other(measured=np.zeros((19, 7))), "measured is float64 (19, 7), must be numbers (20, 7)"),
    "no list": (other(outputs="abc"), "outputs in about.json must be list"),
    "never": (other(every=0), "every in about.json is 0"),
}


@pytest.mark.parametrize("what", REFUSED)
def test_what_is_no_record_of_this_is_refused_in_one_line(steady, capsys, what):
    spec, path = steady
    spoil, says = REFUSED[what]
    spoil(path)
    assert twinbench("replay", path, "--estimator", spec) == 2
    said = capsys.readouterr()
    assert says in said.err
    assert str(path) in said.err
    assert (said.out, said.err.count("\n")) == ("", 1)


@pytest.mark.parametrize(
    ("more", "says"),
    [
        ((), "the estimator 'steady' is not built in; name its file with --estimator FILE"),
        (("--estimator", "last_value"), "its model holds the estimator 'steady', not 'last_value'"),
        (("--estimator", "nobody"), "no estimator 'nobody'"),
        (("--within", "-1"), "--within is -1, must be a number of standard deviations"),
        (("--within", "nan"), "--within is nan"),
    ],
)
def test_another_estimator_is_refused_in_one_line(steady, capsys, more, says):
    _, path = steady
    assert twinbench("replay", path, *more) == 2
    err = capsys.readouterr().err
    assert says in err
    assert err.count("\n") == 1


def test_nothing_is_recorded_that_cannot_be(short, twin, tmp_path, capsys):
    run, day = short.parent / "run", short.parent / "plant.csv"
    trained = ("record", "deeponet_kalman", day, "--results", run)
    assert twinbench(*trained, "--out", tmp_path / "run.npz", "--every", 0) == 2
    assert "--every is 0, must be at least 1" in capsys.readouterr().err
    assert twinbench("record", "last_value", day, "--results", run, "--out", tmp_path / "run.npz") == 2
    assert "last_value is not trained in" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []
    with pytest.raises(ValueError, match="nothing is recorded yet"):
        Recorder(twin).record()
