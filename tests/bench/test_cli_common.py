"""What holds for every command: JSON alone on stdout, --jobs, --verbose, --version, completion, exit statuses."""

from __future__ import annotations

import argparse
import json
import os
import re
import shutil
import subprocess
from pathlib import Path
from types import SimpleNamespace

import pandas as pd
import pytest
from helpers.refusals import refused
from helpers.tiny_run import run_arguments, twinbench, write_estimator, write_profile

from twinbench.bench.cli.completion import script
from twinbench.bench.cli.main import COMMANDS as COMMANDS_OF
from twinbench.bench.cli.main import build_parser
from twinbench.bench.cli.mismatch_status import STATUS
from twinbench.bench.roster import LABELS
from twinbench.common.jobs import cores

pytestmark = pytest.mark.usefixtures("in_this_process")

(COMMANDS,) = (a.choices for a in build_parser()._actions if isinstance(a, argparse._SubParsersAction))
"""The parser of each."""


@pytest.fixture(scope="module")
def tiny(tmp_path_factory: pytest.TempPathFactory) -> SimpleNamespace:
    """A finished run of one estimator, which prints what it does, and a recording."""
    folder = tmp_path_factory.mktemp("tiny")
    profile = write_profile(folder, updates=10)
    spec = write_estimator(folder, "steady", fit="print('I am learning')")
    assert twinbench(*run_arguments(profile, folder / "run", [spec])) == 0
    assert twinbench("simulate", "--profile", profile, "--out", folder / "recordings") == 0
    return SimpleNamespace(
        profile=profile, spec=spec, run=folder / "run", recording=folder / "recordings" / "test-01.csv"
    )


def read(capsys: pytest.CaptureFixture[str], status: int, *arguments: object) -> object:
    """What a program reads of a command with --json."""
    capsys.readouterr()
    assert twinbench(*arguments, "--json") == status
    return json.loads(capsys.readouterr().out)


def test_run_and_report_tell_the_comparison(
    tiny: SimpleNamespace, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    fails = write_estimator(tmp_path, "fails", fit="raise RuntimeError('no')")
    told = read(capsys, 1, *run_arguments(tiny.profile, tmp_path / "out", [tiny.spec, fails]))
    rows = {row["estimator"]: row for row in told["comparison"]}
    assert list(rows) == ["true_start_held", "fails", "steady"]
    assert told["failed"] == [{"estimator": "fails", "seed": 0, "stage": "fit", "reason": "RuntimeError: no"}]
    assert Path(told["report"]).is_file()
    table = pd.read_csv(tmp_path / "out" / "tables" / "comparison.csv").set_index("estimator")
    assert rows["steady"]["p_nrmse_pct"] == pytest.approx(table.loc["steady", "p_nrmse_pct"], rel=1e-9)
    assert rows["fails"]["p_nrmse_pct"] is None
    assert read(capsys, 0, "report", tmp_path / "out")["comparison"] == told["comparison"]


def test_simulate_and_export_tell_their_files(
    tiny: SimpleNamespace, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    files = read(capsys, 0, "simulate", "--profile", tiny.profile, "--part", "validation", "--out", tmp_path)["files"]
    assert files == [str(tmp_path / "validation-00.csv")]
    exported = [tmp_path / "operator.onnx", tmp_path / "filter.npz"]
    monkeypatch.setattr("twinbench.bench.export.export", lambda *_: exported)
    told = read(capsys, 0, "export", "--out", tmp_path)
    assert told["files"] == [str(tmp_path / "operator.onnx"), str(tmp_path / "filter.npz")]


def test_latency_tells_every_row(
    tiny: SimpleNamespace, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("twinbench.bench.latency.memory.process_MB", lambda *_: 60.0)  # starts Python for each peer
    where = ("--profile", tiny.profile, "--results", tiny.run, "--estimator", tiny.spec, "--out", tmp_path / "latency")
    told = read(capsys, 0, "latency", *where, "--updates", 10, "--ticks", 0)
    assert "steady" in json.dumps(told["latency"])
    assert told["failed"] == []


def test_estimate_tells_a_summary_of_each_recording(
    tiny: SimpleNamespace, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    where = ("--profile", tiny.profile, "--results", tiny.run, "--out", tmp_path)
    capsys.readouterr()
    twinbench("estimate", tiny.spec, tiny.recording, *where, "--json")
    assert [s["recording"] for s in json.loads(capsys.readouterr().out)] == ["test-01"]


def test_tune_tells_the_settings(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    spec = Path(write_estimator(tmp_path, "steady", fit="print('I am learning')"))
    space = '    search_space = {"scale": (0.6, 1.7)}\n    implementations'
    spec.write_text(spec.read_text().replace("    implementations", space))
    profile = write_profile(tmp_path)
    told = read(capsys, 0, "tune", spec, "--profile", profile, "--trials", 1, "--out", tmp_path / "tuning")
    assert told == [{"steady": {"scale": 1.0}}]


def test_prove_and_flagship_tell_the_gates(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    gates = pd.DataFrame([("right name", 3, 0.5, True)], columns=["gate", "cases", "measured", "met"])
    pd.DataFrame([("twinbench", 3)], columns=["engine", "cases"]).to_csv(tmp_path / "engines.csv", index=False)
    monkeypatch.setattr("twinbench.proof.concealed.suite.run", lambda *_, **__: gates)
    monkeypatch.setattr("twinbench.proof.flagship.suite.run", lambda *_, **__: gates)
    row = {"gate": "right name", "cases": 3, "measured": 0.5, "met": True}
    told = read(capsys, 0, "prove", "--out", tmp_path)
    assert (told["gates"], told["engines"]) == ([row], [{"engine": "twinbench", "cases": 3}])
    assert read(capsys, 0, "flagship", "--out", tmp_path)["gates"] == [row]


def test_every_command_takes_json_and_verbose_and_shows_an_example() -> None:
    for name, parser in COMMANDS.items():
        said = parser.format_help()
        assert "--verbose" in said, name
        assert ("--json" in said) is (name != "completion"), name
        assert f"twinbench {name} " in said.partition("example:")[2], name
        for action in parser._actions:
            assert action.help or action.choices or not action.option_strings or action.metavar in ("DIR", "N"), (
                name,
                action.option_strings,
            )


@pytest.mark.parametrize("command", ["run", "mismatch", "fleet", "prove", "flagship", "tune", "check"])
def test_jobs_are_checked_and_hold_meanwhile(
    command: str, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    needs = {
        "mismatch": ("s.py", "r.csv", "--out", "o"),
        "fleet": ("s.py", "a", "--out", "o"),
        "tune": ("oracle",),
        "check": ("oracle",),
    }.get(command, ())
    assert "--jobs is 0, must lie in [1, 1024]" in refused(tmp_path, capsys, command, *needs, "--jobs", 0)
    seen = []
    monkeypatch.setattr(COMMANDS_OF[command], "run", lambda a: seen.append(cores()) or 0)
    monkeypatch.delenv("LOKY_MAX_CPU_COUNT")
    assert twinbench(command, *needs, "--jobs", 1) == 0
    assert twinbench(command, *needs) == 0
    assert seen == [1, cores()]


def test_no_number_of_processes_is_written_into_the_code() -> None:
    root = Path(__file__).parents[2]
    fixed = re.compile(r"n_jobs\s*=\s*\d|ThreadPoolExecutor\(\s*\d|min\(2,|os\.cpu_count\(\) or")
    for package in ("common", "physics", "data", "methods", "baselines", "mismatch", "bench", "proof"):
        for path in (root / package).rglob("*.py"):
            found = [line for line in path.read_text().splitlines() if fixed.search(line)]
            assert not [line for line in found if "rng." not in line], path


@pytest.mark.parametrize("order", [("-v", "list", "simulators"), ("list", "simulators", "-v")])
def test_verbose_stands_before_or_after_the_command(order: tuple[str, ...], capsys: pytest.CaptureFixture[str]) -> None:
    assert twinbench(*order) == 0
    err = capsys.readouterr().err
    assert re.search(r"^\d{4}-\d\d-\d\d \d\d:\d\d:\d\d,\d{3} [\w.]+: twinbench list begins$", err, re.MULTILINE)
    assert twinbench(*(word for word in order if word != "-v")) == 0
    assert capsys.readouterr().err == ""


def test_verbose_names_stages_cells_and_files(
    tiny: SimpleNamespace, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert twinbench(*run_arguments(tiny.profile, tmp_path / "out", [tiny.spec]), "-v") == 0
    err = capsys.readouterr().err
    for line in (
        "twinbench.common.progress: train: done in",
        "twinbench.bench.runner: train: steady, seed 0: done",
        f"twinbench.common.store: wrote {tmp_path / 'out' / 'scores.csv'}",
    ):
        assert line in err


def test_the_version_is_that_of_the_package(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as stopped:
        twinbench("--version")
    assert stopped.value.code == 0
    assert re.fullmatch(r"twinbench \d+\.\d+\.\d+(, commit [0-9a-f]{40}(, with .*)?)?\n", capsys.readouterr().out)


def test_the_help_has_every_exit_status(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        twinbench("--help")
    table = capsys.readouterr().out.partition("exit status:")[2]
    for status in (0, 1, 2, 130, 143, *STATUS.values()):
        assert re.search(rf"\b{status}\b", table), status


BASH = """source {script}
COMP_WORDS=({words}); COMP_CWORD={at}
_twinbench
printf '%s\\n' "${{COMPREPLY[@]}}"
"""


@pytest.mark.skipif(shutil.which("bash") is None, reason="no bash")
@pytest.mark.parametrize(
    ("words", "offers", "not_offered"),
    [
        (["mis"], {"mismatch"}, {"run"}),
        (["run", "--pro"], {"--profile"}, {"--out"}),
        (["run", "--profile", "p"], {"paper"}, {"quick"}),
        (["run", "--only", "deep"], {"deeponet", "deeponet_kalman"}, {"oracle"}),
        (["-v", "list", "sim"], {"simulators"}, {"estimators"}),
        (["estimate", "ora"], {"oracle"}, set()),
        (["mismatch", "here."], {"here.csv"}, set()),
        (["simulate", "--format", "p"], {"parquet"}, {"csv"}),
    ],
)
def test_bash_completes(tmp_path: Path, words: list[str], offers: set[str], not_offered: set[str]) -> None:
    (tmp_path / "completion.bash").write_text(script(build_parser(), "bash"))
    (tmp_path / "here.csv").write_text("")
    text = BASH.format(script="completion.bash", words=" ".join(["twinbench", *words]), at=len(words))
    done = subprocess.run(["bash", "-c", text], cwd=tmp_path, capture_output=True, text=True, check=True)
    found = set(done.stdout.split())
    assert offers <= found
    assert not found & not_offered
    assert done.stderr == ""


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_completion_knows_every_command_and_option(shell: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert twinbench("completion", shell) == 0
    text = capsys.readouterr().out
    for name, parser in COMMANDS.items():
        assert re.search(rf"\b{name}\b", text)
        for action in parser._actions:
            if action.option_strings and not isinstance(action, argparse._HelpAction):
                assert action.option_strings[-1].lstrip("-") in text
    assert all(name in text for name in LABELS)
    if shutil.which(shell) and shell != "bash":
        check = subprocess.run([shell, "-n"], input=text, capture_output=True, text=True, env=dict(os.environ))
        assert check.returncode == 0, check.stderr
