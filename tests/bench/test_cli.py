"""The command line: what it prints, how it exits, and that bad input leaves one line and nothing else."""

from __future__ import annotations

import errno
import json
import os
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
from helpers.refusals import listing, refused
from helpers.tiny_run import run_arguments, twinbench, write_estimator, write_profile

from twinbench.common.errors import WorkerKilled
from twinbench.machines.compressor import CHANNELS, ESTIMATED

pytestmark = pytest.mark.usefixtures("in_this_process")


@pytest.fixture(scope="module")
def tiny(tmp_path_factory: pytest.TempPathFactory) -> SimpleNamespace:
    """A finished run of one estimator, and a recording like those it was tested on."""
    folder = tmp_path_factory.mktemp("tiny")
    profile, spec = write_profile(folder, updates=10), write_estimator(folder, "steady")
    assert twinbench(*run_arguments(profile, folder / "run", [spec])) == 0
    assert twinbench("simulate", "--profile", profile, "--out", folder / "recordings") == 0
    recording = folder / "recordings" / "test-01.csv"
    return SimpleNamespace(profile=profile, spec=spec, run=folder / "run", recording=recording)


def test_starting_up_imports_nothing_heavy() -> None:
    heavy = "{'numpy', 'pandas', 'torch', 'numba', 'scipy', 'matplotlib', 'rich'}"
    code = (
        "import sys, twinbench\nfrom twinbench.bench.cli.main import build_parser\nbuild_parser().format_help()\n"
        f"print(sorted({heavy} & set(sys.modules)))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == "[]\n"


def test_help_names_every_command_and_the_exit_status(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as stopped:
        twinbench("--help")
    assert stopped.value.code == 0
    said = capsys.readouterr().out
    commands = ("run", "list", "check", "simulate", "estimate", "export", "report", "latency")
    for word in (*commands, "exit status:\n    0  done"):
        assert word in said


@pytest.mark.parametrize(
    ("what", "key", "some"),
    [
        ("estimators", "name", "oracle"),
        ("ablations", "estimator", None),
        ("mechanisms", "name", None),
        ("simulators", "name", None),
    ],
)
def test_lists_are_json_alone_on_stdout(
    capsys: pytest.CaptureFixture[str], what: str, key: str, some: str | None
) -> None:
    assert twinbench("list", what, "--json") == 0
    rows = json.loads(capsys.readouterr().out)
    assert all(row[key] for row in rows)
    assert some is None or some in [row[key] for row in rows]
    assert rows or what == "ablations"
    assert twinbench("list", what) == 0


def test_the_list_of_mechanisms_is_that_of_any_simulator(capsys: pytest.CaptureFixture[str]) -> None:
    assert twinbench("list", "mechanisms", "--simulator", "examples/two_tanks.py", "--json") == 0
    assert any(row["name"].startswith("overflow@") for row in json.loads(capsys.readouterr().out))
    assert twinbench("list", "estimators", "--simulator", "nominal") == 2
    assert "--simulator goes with mechanisms or simulators only" in capsys.readouterr().err


@pytest.mark.parametrize(("statuses", "code"), [(("pass", "skip"), 0), (("pass", "fail"), 1)])
def test_check_exits_with_what_the_battery_found(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], statuses: tuple[str, ...], code: int
) -> None:
    found = [SimpleNamespace(name=f"c{i}", status=s, detail="so [it] is") for i, s in enumerate(statuses)]
    monkeypatch.setattr("twinbench.bench.contract.run_battery", lambda *_: found)
    assert twinbench("check", "oracle", "--json") == code
    assert json.loads(capsys.readouterr().out) == [vars(f) for f in found]
    assert twinbench("check", "oracle") == code
    assert "so [it] is" in capsys.readouterr().out


@pytest.mark.parametrize("kind", ["csv", "parquet"])
def test_simulate_writes_recordings(tiny: SimpleNamespace, tmp_path: Path, kind: str) -> None:
    arguments = ("simulate", "--profile", tiny.profile, "--part", "validation", "--format", kind, "--out", tmp_path)
    assert twinbench(*arguments) == 0
    assert [p.name for p in listing(tmp_path)] == [f"validation-00.{kind}"]
    read = pd.read_csv if kind == "csv" else pd.read_parquet
    table = read(tmp_path / f"validation-00.{kind}")
    assert list(table.columns[:8]) == ["time_s", *CHANNELS]
    assert f"true_{ESTIMATED[0]}" in table
    assert len(table) == 2400
    assert twinbench(*arguments, "--no-truth") == 0
    assert list(read(tmp_path / f"validation-00.{kind}").columns) == ["time_s", *CHANNELS]


def test_estimate_writes_estimates_with_intervals(
    tiny: SimpleNamespace, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    arguments = ("estimate", tiny.spec, tiny.recording, "--profile", tiny.profile, "--results", tiny.run)
    assert twinbench(*arguments, "--out", tmp_path, "--json", "--force") == 3  # it learns nothing, ever
    (summary,) = json.loads(capsys.readouterr().out)
    assert {p.name for p in listing(tmp_path)} == {f"test-01.{s}" for s in ("estimates.csv", "png", "summary.json")}
    assert json.loads((tmp_path / "test-01.summary.json").read_text()) == summary
    table = pd.read_csv(tmp_path / "test-01.estimates.csv")
    assert len(table) == 2400
    for quantity in ESTIMATED:
        low, mean, high = (table[f"{quantity}{suffix}"] for suffix in ("_low", "", "_high"))
        assert ((low <= mean) & (mean <= high)).all()
        assert summary["final"][quantity]["value"] == pytest.approx(mean.iloc[-1], rel=1e-6)
    assert (tmp_path / "test-01.png").read_bytes().startswith(b"\x89PNG")
    assert "capacity" in summary["says"]


def test_report_draws_again(tiny: SimpleNamespace, capsys: pytest.CaptureFixture[str]) -> None:
    page = (tiny.run / "report.html").read_bytes()
    (tiny.run / "report.html").unlink()
    assert twinbench("report", tiny.run) == 0
    assert (tiny.run / "report.html").read_bytes() == page
    assert str(tiny.run / "report.html") in capsys.readouterr().out


def test_latency_of_one_estimator_stands_beside_its_peers(
    tiny: SimpleNamespace, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("twinbench.bench.latency.memory.process_MB", lambda *_: 60.0)  # starts Python for each peer
    before = (tiny.run / "latency.csv").read_bytes()
    arguments = ("latency", "--profile", tiny.profile, "--results", tiny.run, "--updates", 10, "--ticks", 2)
    out = tmp_path / "latency"
    assert twinbench(*arguments, "--estimator", tiny.spec, "--out", out) == 0
    printed = capsys.readouterr().out
    assert "at 20 Hz" in printed
    assert str(out) in printed
    table = pd.read_csv(out / "latency.csv")
    peers = ["filterpy_ekf", "filterpy_ukf", "numba_ekf", "numba_ukf"]
    for _, rows in table.groupby("mode"):
        assert set(rows["estimator"]) == {*peers, "steady"}
    assert (table["p50_us"] <= table["p99_us"]).all()
    assert json.loads((out / "manifest.json").read_text())["measured"]["wall_s"] > 0.0
    assert pd.read_csv(out / "memory.csv")["process_MB"].eq(60.0).all()
    with np.load(out / "samples.npz") as kept:
        assert kept["back_to_back.filterpy_ukf.NumPy model.1"].shape == (10,)
        assert kept["paced_20_hz.filterpy_ukf.NumPy model.1"].shape == (2,)
    assert (tiny.run / "latency.csv").read_bytes() == before


def test_a_run_that_is_broken_off_says_how_to_go_on(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def interrupted(name: str) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("twinbench.bench.profile.load_profile", interrupted)
    assert twinbench("run") == 130
    assert "run the same command again to go on" in capsys.readouterr().err


def test_an_item_that_kills_its_workers_is_one_line_and_status_1(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def killed(name: str) -> None:
        raise WorkerKilled("steady, seed 0 lost 3 workers")

    monkeypatch.setattr("twinbench.bench.profile.load_profile", killed)
    assert twinbench("run") == 1
    assert capsys.readouterr().err == "twinbench: steady, seed 0 lost 3 workers\n"


def test_a_training_that_no_longer_fits_is_refused_with_what_differs(tiny, tmp_path, capsys, monkeypatch):
    arguments = ("estimate", tiny.spec, tiny.recording, "--results", tiny.run, "--out", tmp_path / "e", "--profile")
    longer = tmp_path / "tiny.toml"
    longer.write_text(Path(tiny.profile).read_text().replace("minutes = 2.5", "minutes = 3.5"))
    assert twinbench(*arguments, longer) == 2
    assert "(there data.minutes was 2.5, now it is 3.5)" in capsys.readouterr().err
    changed = write_estimator(tmp_path, Path(tiny.spec).stem, scale=1.25)
    monkeypatch.setattr("twinbench.bench.estimate.apply.code_version", lambda module: f"other than of {module}")
    assert twinbench("estimate", changed, *arguments[2:], tiny.profile) == 2
    assert "has changed since" in capsys.readouterr().err


BAD_USE = [
    (("run", "--only", "orcale"), "no estimator 'orcale'; did you mean 'oracle'?"),
    (("check", "orcale"), "did you mean 'oracle'?"),
    (("run", "--only", "broken.py"), "plug-in broken.py fails to import: NameError"),
    (("run", "--only", "gone.py"), "no file gone.py"),
    (("run", "--profile", "range.toml"), "range.toml: design: n_test is 0, must lie in [1, 1000]"),
    (("run", "--profile", "type.toml"), "seeds is 'a', must be a list"),
    (("run", "--profile", "setting.toml", "--only", "oracle"), "[settings.oracle]: oracle: unknown setting 'colour'"),
    (("run", "--profile", "nobody.toml", "--only", "oracle"), "has settings for 'nobody', which is no estimator"),
    (("run", "--profile", "nosuch"), "no profile 'nosuch'; choose one of"),
    (("run", "--only", "one/mine.py", "two/mine.py"), "two of the estimators are named 'mine'"),
    (("run", "--only", "one/mine.py", "--out", "file/out"), "cannot write file/out/.writable: Not a directory"),
    (("run", "--only", "one/mine.py", "--backend", "dask"), "--backend dask needs --scheduler ADDRESS"),
    (("tune", "oracle", "--backend", "joblib", "--scheduler", "tcp://x:1"), "--scheduler is for --backend dask"),
    (("prove", "--scheduler", "tcp://x:1", "--jobs", "2"), "--jobs is for this machine alone"),
    (("flagship", "--scheduler", "gone.json"), "no Dask scheduler in gone.json; start one with: dask scheduler"),
    (("flagship", "--scheduler", "good.csv"), "no Dask scheduler in good.csv"),
    (("compare", "good.csv", "--out", "o", "--scheduler", "tcp://127.0.0.1:1"), "no Dask scheduler answers at"),
    (("simulate", "--out", "file/out"), "Not a directory"),
    (("report", "a" * 300), "cannot use 'aaa"),
    (("run", "--only", "one/mine.py", "--out", "a" * 300), "File name too long; give another path"),
    (("report", "."), "holds no run (no manifest.json)"),
    (("latency", "--updates", "3"), "--updates is 3, must lie in"),
    (("latency", "--estimator", "one/mine.py"), "is not trained in results/quick"),
    (("estimate", "one/mine.py", "good.csv", "--out", "out"), "train it with: twinbench run --profile quick"),
    (("export", "--out", "out"), "train it with: twinbench run --profile quick --only deeponet_kalman"),
    (("export", "--estimator", "oracle", "--out", "out"), "oracle cannot be exported, only deeponet_kalman can"),
    (("export", "--estimator", "orcale", "--out", "out"), "did you mean 'oracle'?"),
    (("export",), "the following arguments are required: --out"),
    (("estimate", "oracle", "good.csv"), "the following arguments are required: --out"),
    (("fly",), "invalid choice: 'fly'"),
]


@pytest.fixture
def workplace(tiny: SimpleNamespace, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with files of every bad kind, as the current one."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "file").write_text("")
    (tmp_path / "broken.py").write_text("import numpy\nundefined\n")
    for name in ("one", "two"):
        (tmp_path / name).mkdir()
        write_estimator(tmp_path / name, "mine")
    for name, text in {
        "range": "[data]\nn_test = 0",
        "type": "seeds = 'a'",
        "setting": "[settings.oracle]\ncolour = 1",
        "nobody": "[settings.nobody]\ncolour = 1",
    }.items():
        (tmp_path / f"{name}.toml").write_text(text)
    table = pd.read_csv(tiny.recording)
    table.to_csv(tmp_path / "good.csv", index=False)
    table.drop(columns="N_rpm").to_csv(tmp_path / "lacks.csv", index=False)
    table.assign(T_dis_K=table["T_dis_K"] - 273.15).to_csv(tmp_path / "celsius.csv", index=False)
    table[:40].to_csv(tmp_path / "short.csv", index=False)
    table.astype({"valve": object}).replace({"valve": {table["valve"][7]: "open"}}).to_csv("words.csv", index=False)
    table.to_parquet(tmp_path / "whole.parquet")
    (tmp_path / "cut.parquet").write_bytes((tmp_path / "whole.parquet").read_bytes()[:5000])
    (tmp_path / "empty.csv").write_text("")
    return tmp_path


@pytest.mark.parametrize(("arguments", "says"), BAD_USE, ids=[" ".join(a)[:50] for a, _ in BAD_USE])
def test_bad_use_is_one_line(
    workplace: Path, capsys: pytest.CaptureFixture[str], arguments: tuple[str, ...], says: str
) -> None:
    assert says in refused(workplace, capsys, *arguments)


def test_without_dask_a_cluster_says_what_to_install(
    workplace: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("twinbench.common.cluster.find_spec", lambda name: None)
    assert "pip install 'twinbench[dask]'" in refused(workplace, capsys, "run", "--scheduler", "tcp://x:1")


def test_without_onnx_export_says_what_to_install(
    workplace: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("twinbench.bench.export.find_spec", lambda name: None)
    assert "pip install 'twinbench[export]'" in refused(workplace, capsys, "export", "--out", "out")


@pytest.mark.parametrize(
    ("recordings", "says"),
    [
        (["nowhere.csv"], "nowhere.csv: no such file"),
        (["one"], "one: is a folder"),
        (["file"], "file: unknown kind of file"),
        (["empty.csv"], "empty.csv: is empty"),
        (["cut.parquet"], "cut.parquet: cannot be read, it may be cut short"),
        (["words.csv"], "column valve: 'open' is no number"),
        (["lacks.csv"], "no column 'N_rpm' for channel N_rpm"),
        (["celsius.csv"], "is it degC or degF?"),
        (["good.csv", "--map", "p_dis_bar[furlong]=p_dis_bar"], "unit 'furlong' cannot be turned into 'bar'"),
        (["good.csv", "--map", "PT1=nothing"], "unknown channel 'nothing'"),
        (["short.csv"], "lasts 2.0 s; at least 10 s are needed"),
        (["good.csv", "good.csv"], "two recordings are named good"),
        (["good.csv", "lacks.csv"], "no column 'N_rpm'"),
        (["good.csv", "--force", "--out", "file/out"], "cannot write file/out/good.estimates.csv: Not a directory"),
    ],
)
def test_a_bad_recording_is_one_line(
    tiny: SimpleNamespace, workplace: Path, capsys: pytest.CaptureFixture[str], recordings: list[str], says: str
) -> None:
    trained = ("--profile", tiny.profile, "--results", tiny.run)
    assert says in refused(workplace, capsys, "estimate", tiny.spec, *trained, "--out", "out", *recordings)


@pytest.mark.parametrize("command", ["run", "simulate", "estimate"])
def test_a_full_disk_is_one_line(
    tiny: SimpleNamespace,
    workplace: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    command: str,
) -> None:
    def full(handle: int) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(os, "fsync", full)
    arguments = {
        "run": ["run", "--only", tiny.spec],
        "simulate": ["simulate"],
        "estimate": ["estimate", tiny.spec, "good.csv", "--force", "--results", tiny.run],
    }[command]
    line = refused(workplace, capsys, *arguments, "--profile", tiny.profile, "--out", "out")
    assert "No space left on device; give --out a folder with room" in line


def test_a_disk_that_fills_up_in_mid_run_stops_it(
    tiny: SimpleNamespace, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    replace = os.replace

    def fills_up(source: Path, target: Path) -> None:
        if "fit" in Path(target).parts:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        replace(source, target)

    monkeypatch.setattr(os, "replace", fills_up)
    assert twinbench(*run_arguments(tiny.profile, tmp_path / "out", [tiny.spec])) == 2
    assert "twinbench: cannot write" in capsys.readouterr().err.splitlines()[-1]
    left = [p.name for p in listing(tmp_path) if p.is_file()]
    assert sorted(left) == [".done", "part.npz"], "the data, and nothing half-written"


def test_a_method_that_breaks_on_a_recording_exits_with_1(
    tiny: SimpleNamespace, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Trained and tested without fault, it fails where a channel is missing all the time."""
    spec = write_estimator(
        tmp_path,
        "brittle",
        step="if np.isnan(sample.measured[:, 3]).all() and abs(sample.time_s - 110.0) < 0.01: "
        "state = state._replace(mean=state.mean * np.nan)",
    )
    out = tmp_path / "out"
    assert twinbench(*run_arguments(tiny.profile, out, [spec])) == 0
    table = pd.read_csv(tiny.recording).assign(valve=np.nan)
    table.to_csv(tmp_path / "gap.csv", index=False)
    capsys.readouterr()
    arguments = ("estimate", spec, tmp_path / "gap.csv", "--profile", tiny.profile, "--results", out, "--out", tmp_path)
    assert twinbench(*arguments) == 1
    assert "brittle: the estimate or its interval is not finite at" in capsys.readouterr().err
    assert not list(tmp_path.glob("gap.*[!v]"))
