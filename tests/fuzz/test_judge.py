"""The fuzz tells good ends from bad ones, ends what hangs, and makes the same case again."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from fuzz.answers import Answer, Nonsense, difference, strict_json
from fuzz.cases import CLOSE_OR_TOLD, ORDERLY, REFUSED, SAME, SAME_OR_REFUSED, TOLD, Case
from fuzz.commands import WAYS, make
from fuzz.judge import judge, listing
from fuzz.worker import Ended
from fuzz.world import World, tank_recording
from twinbench.bench.replay.record import ABOUT

HEALTHY = Answer("healthy", False, {"x": np.array([1.0])}, {"x": (0.9, 1.1)})
SICK = Answer("sick", True, {"x": np.array([2.0])}, {"x": (1.9, 2.1)})
ELSEWHERE = Answer("healthy", False, {"x": np.array([2.0])}, {"x": (1.9, 2.1)})
LINE = "twinbench: day.csv: is empty; record again or name another file\n"


def end(folder, expects=ORDERLY, status=0, err="", answer=HEALTHY, hung=False, monkeypatch=None, before=None) -> str:
    """How a case is sorted that ended so."""
    case = Case("estimate", 0, "m", ("estimate",), expects, ("day",), folder)
    before = listing(folder) if before is None else before
    monkeypatch.setitem(judge.__globals__["ANSWERS"], "estimate", lambda folder, ended: answer)
    return judge(case, Ended(status, "", err, hung, 1.0), before, lambda case: HEALTHY).kind


@pytest.fixture
def ends(tmp_path, monkeypatch):
    (tmp_path / "day.csv").write_text("")
    return lambda **how: end(tmp_path, monkeypatch=monkeypatch, **how)


@pytest.mark.parametrize(
    ("how", "kind"),
    [
        ({"hung": True, "status": -9}, "hang"),
        ({"status": -11}, "traceback"),
        ({"status": 70, "err": "Traceback (most recent call last):\n  x\nKeyError: 1\n"}, "traceback"),
        ({"status": 2, "err": LINE}, "refused"),
        ({"status": 2, "err": LINE, "expects": REFUSED}, "refused"),
        ({"status": 2, "err": LINE, "expects": TOLD}, "refused"),
        ({"status": 2, "err": LINE, "expects": SAME}, "nonsense"),
        ({"status": 2, "err": LINE, "expects": SAME_OR_REFUSED}, "refused"),
        ({"status": 2, "err": ""}, "unclear"),
        ({"status": 2, "err": LINE + LINE}, "unclear"),
        ({"status": 2, "err": LINE + "  warnings.warn(\n"}, "unclear"),
        ({"status": 2, "err": LINE.replace("day", "night")}, "unclear"),
        ({"status": 2, "err": LINE.replace("empty", "\x1b[31m")}, "unclear"),
        ({"status": 2, "err": LINE.replace("empty", "x" * 9000)}, "unclear"),
        ({"status": 3}, "not_usable"),
        ({"status": 3, "expects": TOLD}, "not_usable"),
        ({"status": 3, "expects": SAME}, "nonsense"),
        ({"expects": REFUSED}, "nonsense"),
        ({"expects": TOLD}, "nonsense"),
        ({"expects": TOLD, "answer": SICK}, "answered"),
        ({"expects": SAME}, "answered"),
        ({"expects": SAME, "answer": ELSEWHERE}, "nonsense"),
        ({"expects": SAME, "answer": SICK}, "nonsense"),
        ({"expects": CLOSE_OR_TOLD}, "answered"),
        ({"expects": CLOSE_OR_TOLD, "answer": ELSEWHERE}, "nonsense"),
        ({"expects": CLOSE_OR_TOLD, "answer": SICK}, "answered"),
    ],
)
def test_every_end_is_sorted(ends, how, kind):
    assert ends(**how) == kind


def test_a_refusal_leaves_nothing_behind(tmp_path, ends):
    before = listing(tmp_path)
    (tmp_path / "out").mkdir()
    assert ends(status=2, err=LINE, before=before) == "left_behind"
    assert ends(status=3, before=before) == "left_behind"
    assert ends(before=before) == "answered"


def test_a_refusal_changes_no_file(tmp_path, ends):
    before = listing(tmp_path)
    (tmp_path / "day.csv").write_text("more")
    assert ends(status=2, err=LINE, before=before) == "left_behind"


def test_nothing_is_half_written(tmp_path, ends):
    before = listing(tmp_path)
    (tmp_path / ".day.csv.x.part").write_text("")
    assert ends(before=before) == "left_behind"


def test_an_answer_that_cannot_be_read_is_nonsense(tmp_path):
    case = Case("estimate", 0, "m", ("estimate",), ORDERLY, ("day",), tmp_path)
    assert judge(case, Ended(0, "", "", False, 1.0), {}, lambda case: HEALTHY).kind == "nonsense"


def test_json_holds_no_nan():
    with pytest.raises(Nonsense):
        strict_json('{"x": NaN}')


def test_numbers_differ_where_they_do():
    a = {"x": [1.0, np.array([1.0, np.nan])]}
    assert difference(a, {"x": [1.0, np.array([1.0, np.nan])]}) == ""
    assert difference(a, {"x": [1.0, np.array([1.1, np.nan])]}).startswith("/x/1")
    assert difference(a, {"y": []})


FORKED = """
import sys, time
from pathlib import Path
sys.path.insert(0, {tests!r})
from fuzz import worker
import twinbench.bench.cli.main

worker.LONGEST_S = 3.0
def fails(arguments): print("half"); raise KeyError("x")
def exits(arguments): print("done"); raise SystemExit(2)
def waits(arguments): time.sleep(60)
def spins(arguments):
    while True: pass
for main in (fails, exits, waits, spins):
    twinbench.bench.cli.main.main = main
    ended = worker.run(("x",), Path({folder!r}), Path({folder!r}), 3.0)
    print(main.__name__, ended.status, ended.hung, "Traceback" in ended.err, ended.out.strip())
"""


def test_what_fails_is_caught_and_what_hangs_is_ended(tmp_path):
    text = FORKED.format(tests=str(Path(__file__).parents[1]), folder=str(tmp_path))
    done = subprocess.run([sys.executable, "-c", text], capture_output=True, text=True, timeout=60)
    assert [line.strip() for line in done.stdout.splitlines()] == [
        "fails 70 False True half",
        "exits 2 False False done",
        "waits -9 True False",
        "spins -9 True False",
    ], done.stderr


@pytest.fixture(scope="module")
def world(tmp_path_factory) -> World:
    """As ``fuzz.world.build`` makes it, without the training."""
    folder = tmp_path_factory.mktemp("world")
    (folder / "trained.toml").write_text("")
    tables = folder / "run" / "store" / "fit" / "k"
    tables.mkdir(parents=True)
    (folder / "run" / "store" / "estimate").mkdir()
    for name in ("scores", "failures", "latency", "cost"):
        (folder / "run" / f"{name}.csv").write_text("estimator,sequence,metric,value\na,b,c,1.0\nd,e,f,2.0\n")
    (folder / "run" / "manifest.json").write_text('{"seeds": [0], "wall_s": {}}')
    np.savez(tables / "part.npz", a=np.zeros(3), b=np.ones(200))
    (tables / ".done").write_text("x")
    shutil.copytree(folder / "run", folder / "unused")
    about = json.dumps(dict.fromkeys(ABOUT, 0)).encode()
    arrays = {name: np.ones((6, 2)) for name in ("time_s", "measured", "lag_s", "said.mean")}
    parts = {"about.json": np.frombuffer(about, np.uint8), "model.npz": np.frombuffer(about, np.uint8), **arrays}
    np.savez(folder / "online.npz", checksums=np.ones(6, np.uint64), **parts)
    time_s = 0.05 * np.arange(400)
    from twinbench.machines.compressor import CHANNELS

    rows = {c: 3.0 + np.sin(time_s + i) for i, c in enumerate(CHANNELS)}
    compressor = pd.DataFrame({"time_s": time_s, **rows})
    compressor.iloc[::50, 1:] = np.nan  # sensors drop readings
    return World(folder, compressor, tank_recording(1, 100), tank_recording(2, 60))


def contents(case: Case) -> dict[str, bytes]:
    return {str(p.relative_to(case.folder)): p.read_bytes() for p in case.folder.rglob("*") if p.is_file()}


@pytest.mark.parametrize("command", [pytest.param(c, marks=[pytest.mark.slow] * (c != "mismatch")) for c in WAYS])
def test_every_mutator_makes_its_case_and_the_same_one_again(tmp_path, world, command):
    for index in range(len(WAYS[command])):
        first, again = (make(command, index, 1, tmp_path / f"{k}-{index}", world) for k in "ab")
        assert first.arguments == again.arguments
        assert contents(first) == contents(again)
