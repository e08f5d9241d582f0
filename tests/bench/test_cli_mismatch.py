"""``twinbench mismatch`` and ``twinbench simulate --simulator``: what they hand on and write, and what they refuse."""

from __future__ import annotations

import hashlib
import json
import re
from datetime import datetime, timedelta
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pandas as pd
import pytest
from helpers.documents import bare_verdict
from helpers.lag import LAG
from helpers.refusals import refused
from helpers.tiny_run import twinbench

from twinbench.bench.cli.mismatch_status import NAMED, SAYS, STATUS
from twinbench.bench.cli.surroundings import Terminated
from twinbench.common.errors import BadInput
from twinbench.mismatch.verdict import VERDICTS

LOSS = """
from twinbench.physics.simulator import Term, Variable

def term(x, u, theta):
    return theta[-1] * (290.0 - x[0])

LOSS = Term("loss", "heat is lost", "balance:T", (Variable("c_1_s", "1/s", 0.0, 1.0, 0.1),), term=term)
"""
CHANGED = {
    "broken.py": LAG.replace("LAG = ", "LAG = undefined + "),
    "empty.py": "x = 1\n",
    "two.py": LAG + "\nfrom twinbench.physics.nominal import NOMINAL\n",
    "shapes.py": LAG.replace("return np.array([x[0]])", "return np.array([x[0], x[0]])"),
    "nan.py": LAG.replace("theta[0]])", "(theta[0] * 0.0) * 0.0])"),
    "blows_up.py": LAG.replace("(u[0] - x[0]) / theta[0]", "1e3 * x[0] ** 2"),
    "loss_port.py": LOSS.replace("balance:T", "balance:p"),
    "loss_term.py": LOSS.replace("x[0])", "x[7])"),
}


def table(samples: int = 200) -> pd.DataFrame:
    time_s = 0.5 * np.arange(samples)
    step = np.where(time_s < 10.0, 300.0, 310.0)
    return pd.DataFrame({"time_s": time_s, "T_in": step, "T_out": 300.0 + 0.1 * np.sin(time_s)})


@pytest.fixture
def workplace(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with a good simulator, catalogue and recording, and bad ones, as the current one."""
    monkeypatch.chdir(tmp_path)
    for name, text in {"lag.py": LAG, "loss.py": LOSS, **CHANGED}.items():
        Path(name).write_text(text)
    table().to_csv("day.csv", index=False)
    table().to_csv("next.csv", index=False)
    table(20).to_csv("short.csv", index=False)
    table().drop(columns="T_in").to_csv("lacks.csv", index=False)
    table().drop(columns="T_out").to_csv("inputs.csv", index=False)
    table().assign(T_in=300.0).to_csv("still.csv", index=False)
    table().head(0).to_csv("no_rows.csv", index=False)
    Path("model.toml").write_text('base = "gone.py"\n')
    Path("file").write_text("")
    return tmp_path


@pytest.fixture
def engine(monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    """In place of the engine: what it was called with. Set ``fails`` to have it fail."""
    called: dict[str, Any] = {"fails": None, "page_fails": None, "verdict": "missing physics"}

    def diagnose(simulator: Any, recordings: Any, **others: Any) -> Any:
        if called["fails"]:
            raise called["fails"]
        called.update(others, simulator=simulator, recordings=recordings)
        mechanisms = [m for m in others["catalogue"] if m.name == "loss"]
        values = {"tau_s": 25.0, **{v.name: 0.2 for m in mechanisms for v in m.parameters}}
        found = called["verdict"]
        return SimpleNamespace(
            verdict=found,
            says="Heat is lost.",
            points=("It is lost through the wall.", "And " + "so on " * 20),
            mechanisms=mechanisms,
            values=values,
            to_dict=lambda: bare_verdict(found),
            diagnosis=SimpleNamespace(joined=SimpleNamespace(inputs="held")),
        )

    def write_page(verdict: Any, out: Path) -> None:
        called["there"] = sorted(p.name for p in out.iterdir())
        if called["page_fails"]:
            raise called["page_fails"]

    monkeypatch.setattr("twinbench.mismatch.diagnose", diagnose)
    monkeypatch.setattr("twinbench.mismatch.report.write.write_page", write_page)
    monkeypatch.setattr("twinbench.mismatch.report.sheet.write_sheet", lambda *_: None)
    return called


def test_mismatch_hands_on_what_it_read_and_writes_the_mended_model(
    workplace: Path, engine: dict[str, Any], capsys: pytest.CaptureFixture[str]
) -> None:
    arguments = ("mismatch", "lag.py", "day.csv", "--hold-out", "next.csv", "--catalogue", "loss.py", "--out", "found")
    assert twinbench(*arguments, "--json") == NAMED
    assert json.loads(capsys.readouterr().out)["verdict"] == "missing physics"
    assert [r.name for r in engine["recordings"]] == ["day"]
    assert [r.name for r in engine["hold_out"]] == ["next"]
    names = [m.name for m in engine["catalogue"]]
    assert {"loss", "sensor_bias@T_out"} < set(names)
    assert len(names) == len(set(names))
    assert engine["simulator"].name == "lag"
    assert {p.name for p in Path("found").iterdir()} == {"verdict.json", "model.toml", "sizes.csv"}
    assert twinbench("mismatch", "found/model.toml", "day.csv", "--out", "again") == NAMED
    assert engine["simulator"].mechanisms == ("loss",)
    assert engine["simulator"].theta().tolist() == [25.0, 0.2]


def test_the_terminal_has_one_sentence_then_a_list_then_the_files(
    workplace: Path, engine: dict[str, Any], capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "60")
    twinbench("mismatch", "lag.py", "day.csv", "--out", "found")
    lines = capsys.readouterr().out.splitlines()
    assert lines[:3] == ["Heat is lost.", "", "- It is lost through the wall."]
    assert lines[3].startswith("- And so on")
    assert lines[4].startswith(("  so on", "  on"))
    assert max(map(len, lines[:6])) <= 60
    files = [line.rpartition("/")[2] for line in lines if "/found/" in line]
    assert files == ["report.html", "report.pdf", "verdict.json", "model.toml", "sizes.csv"]
    assert lines[-5:] == [line for line in lines if "/found/" in line]


def test_json_is_the_file_and_says_what_the_verdict_rests_on(
    workplace: Path, engine: dict[str, Any], capsys: pytest.CaptureFixture[str]
) -> None:
    Path("next.toml").write_text("stamp = 'end'\naverage_s = 1.0\n[channels]\nT_in = 'T_in'\n")
    given = ("--catalogue", "loss.py", "--map", "T_out=T_out", "--leave-out", "offset@T", "--prior", "loss=0.5")
    known = ("--measured", "T_in=1K", "--inputs", "linear")
    assert twinbench("mismatch", "lag.py", "day.csv", "next.csv", *given, *known, "--out", "found", "--json") == NAMED
    said = capsys.readouterr().out
    assert said.encode() == Path("found/verdict.json").read_bytes()
    noted = {recording["name"]: recording["notes"] for recording in json.loads(said)["recordings"]}
    assert noted["day"] == []
    assert any(note.startswith("means over 1 s, stamped at their end") for note in noted["next"])
    made = json.loads(said)["provenance"]
    assert made["settings"] == {
        "simulator": "lag.py", "catalogue": "loss.py", "map": ["T_out=T_out"], "inputs": "linear",
        "leave_out": ["offset@T"], "prior": ["loss=0.5"], "measured": ["T_in=1K"], "seed": 0,
    }  # fmt: skip
    read = [("simulator", "lag.py", False), ("catalogue", "loss.py", False), ("recording", "day.csv", False)]
    read += [("recording", "next.csv", True), ("sidecar", "next.toml", True)]  # of several the last is held out
    assert [(f["role"], f["path"], f["held_out"]) for f in made["files"]] == read
    for file in made["files"]:
        content = Path(file["path"]).read_bytes()
        assert (file["bytes"], file["sha256"]) == (len(content), hashlib.sha256(content).hexdigest())
    assert datetime.fromisoformat(made["time"]).utcoffset() == timedelta(0)
    assert re.fullmatch(r"\d+\.\d+\.\d+", made["twinbench"])
    assert str(workplace) not in said, "nobody named it"


def test_a_mended_model_counts_with_all_that_it_is_made_of(workplace: Path, engine: dict[str, Any]) -> None:
    arguments = ("mismatch", "lag.py", "day.csv", "--hold-out", "next.csv", "--catalogue", "loss.py", "--out", "found")
    assert twinbench(*arguments) == NAMED
    assert twinbench("mismatch", "found/model.toml", "day.csv", "--out", "again") == NAMED
    files = json.loads(Path("again/verdict.json").read_text())["provenance"]["files"]
    assert [(f["role"], f["path"], f["held_out"]) for f in files] == [
        *(("simulator", path, False) for path in ("found/model.toml", "lag.py", "loss.py")),
        ("recording", "day.csv", False),
    ]


@pytest.mark.parametrize("verdict", VERDICTS)
def test_the_exit_status_tells_the_verdict_and_help_and_docs_say_which(
    workplace: Path, engine: dict[str, Any], capsys: pytest.CaptureFixture[str], verdict: str
) -> None:
    engine["verdict"] = verdict
    status = twinbench("mismatch", "lag.py", "day.csv", "--out", "found")
    assert status == STATUS[verdict]
    assert (status == 0) == (verdict in ("consistent", "parameter change"))
    assert status not in (1, 2, 3, 130)
    capsys.readouterr()
    with pytest.raises(SystemExit):
        twinbench("mismatch", "--help")
    assert f"{status}  {SAYS[status]}\n" in capsys.readouterr().out
    page = (Path(__file__).parents[2] / "docs" / "mismatch_tutorial.md").read_text(encoding="utf-8")
    assert f"| {status} | {SAYS[status]} |" in page


@pytest.mark.parametrize(
    ("ends", "status"),
    [(FloatingPointError("it diverges"), 1), (BadInput("no"), 2), (KeyboardInterrupt(), 130), (Terminated(), 143)],
    ids=str,
)
def test_without_a_verdict_the_exit_status_says_why_and_a_program_reads_nothing(
    workplace: Path, engine: dict[str, Any], capsys: pytest.CaptureFixture[str], ends: BaseException, status: int
) -> None:
    engine["fails"] = ends
    assert twinbench("mismatch", "lag.py", "day.csv", "--out", "found", "--json") == status
    said, complaint = capsys.readouterr()
    assert said == ""
    assert complaint.startswith("twinbench: ")
    assert not Path("found").exists()


def test_findings_and_model_are_there_before_anything_is_drawn(
    workplace: Path, engine: dict[str, Any], capsys: pytest.CaptureFixture[str]
) -> None:
    engine["page_fails"] = BadInput("cannot write found/figures/x.png: No space left on device")
    assert twinbench("mismatch", "lag.py", "day.csv", "--out", "found") == 2
    assert engine["there"] == ["model.toml", "sizes.csv", "verdict.json"]
    assert {p.name for p in Path("found").iterdir()} == {"model.toml", "sizes.csv", "verdict.json"}
    said, complaint = capsys.readouterr()
    assert said.startswith("Heat is lost.")
    assert complaint == "twinbench: cannot write found/figures/x.png: No space left on device\n"


def test_simulate_runs_a_simulator_over_recorded_inputs(workplace: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert twinbench("simulate", "--simulator", "lag.py", "--inputs", "day.csv", "inputs.csv", "--out", "replayed") == 0
    assert capsys.readouterr().out.split() == [str(Path("replayed", f"{n}.simulated.csv")) for n in ("day", "inputs")]
    simulated = pd.read_csv("replayed/inputs.simulated.csv")
    since = simulated["time_s"] - 10.0
    exact = np.where(since < 0.0, 300.0, 310.0 - 10.0 * np.exp(-since / 20.0))
    assert list(simulated.columns) == ["time_s", "T_in", "T_out"]
    assert np.allclose(simulated["T_out"], exact, atol=1e-3)


BIASED = 'base = "lag.py"\n[[mechanisms]]\nname = "sensor_bias@T_out"\nfrom = "faults"\n[values]\nbias_T_out = 5.0\n'


def test_mismatch_goes_on_from_the_faults_that_a_mended_model_holds(workplace: Path, engine: dict[str, Any]) -> None:
    Path("model.toml").write_text(BIASED)
    assert twinbench("mismatch", "model.toml", "day.csv", "--out", "again") == NAMED
    (fault,) = engine["faults"]
    assert (fault.name, fault.parameters[0].nominal) == ("sensor_bias@T_out", 5.0)


def test_simulate_takes_a_mended_model_with_the_faults_of_its_sensors(workplace: Path) -> None:
    Path("model.toml").write_text(BIASED)
    common = ("--inputs", "inputs.csv", "--format", "parquet", "--out")
    assert twinbench("simulate", "--simulator", "model.toml", *common, "mended") == 0
    assert twinbench("simulate", "--simulator", "lag.py", *common, "plain") == 0
    mended, plain = (pd.read_parquet(f"{folder}/inputs.simulated.parquet") for folder in ("mended", "plain"))
    assert np.allclose(mended["T_out"] - plain["T_out"], 5.0)


BAD = [
    (("lag", "day.csv"), "no simulator 'lag'"),
    (("gone.py", "day.csv"), "no file gone.py; check the path"),
    (("broken.py", "day.csv"), "broken.py, line 14: fails to import: NameError"),
    (("empty.py", "day.csv"), "empty.py: holds no Simulator"),
    (("two.py", "day.csv"), "two.py: holds Simulators LAG, NOMINAL; name one, like two.py:LAG"),
    (("lag.py:LOG", "day.csv"), "has no Simulator 'LOG'; it has: LAG"),
    (("shapes.py", "day.csv"), "returns an array of shape (2,), must return 1 numbers (T_out)"),
    (("nan.py", "day.csv"), "rhs(x, u, theta) returns nan for T at the nominal values"),
    (("model.toml", "day.csv"), "no file gone.py"),
    (("lag.py", "gone.csv"), "gone.csv: no such file"),
    (("lag.py", "lacks.csv"), "lacks.csv: no column 'T_in' for channel T_in"),
    (("lag.py", "short.csv"), "short.csv: holds 20 samples, must hold 30"),
    (("lag.py", "inputs.csv"), "none of the outputs (T_out) has 30 readings"),
    (("lag.py", "still.csv"), "no input varies (T_in)"),
    (("lag.py", "day.csv", "day.csv"), "two recordings are named day"),
    (("lag.py", "day.csv", "--hold-out", "day.csv"), "two recordings are named day"),
    (("lag.py", "day.csv", "--hold-out", "no_rows.csv"), "no_rows.csv: has no rows"),
    (("lag.py", "day.csv", "--hold-out"), "argument --hold-out: expected at least one argument"),
    (("lag.py", "day.csv", "--hold-out", "inputs.csv"), "recording inputs: none of the outputs"),
    (("lag.py", "day.csv", "--map", "T_in[bar]=T_in"), "unit 'bar' cannot be turned into 'K'"),
    (("lag.py", "day.csv", "--map", "x=T_inn"), "unknown channel 'T_inn'; choose from T_in, T_out, time_s"),
    (("lag.py", "day.csv", "--catalogue", "gone.py"), "no file gone.py"),
    (("lag.py", "day.csv", "--catalogue", "empty.py"), "empty.py: holds no Mechanism"),
    (("lag.py", "day.csv", "--catalogue", "loss_port.py"), "simulator 'lag' has no balance 'p'; it has: T"),
    (("lag.py", "day.csv", "--catalogue", "loss_term.py"), "mechanism 'loss': term(x, u, theta) fails in line 5"),
    (("lag.py", "day.csv", "--leave-out", "leak@T"), "leave out 'leak@T': no candidate has that name"),
    (("lag.py", "day.csv", "--prior", "offset@T"), "--prior 'offset@T': must read NAME=ODDS"),
    (("lag.py", "day.csv", "--prior", "offset@T=0"), "prior of 'offset@T': odds are '0.0', must be a number above 0"),
    (("lag.py", "day.csv", "--measured", "T_in=0.1"), "--measured 'T_in=0.1': has no unit; write T_in=0.1K"),
    (("lag.py", "day.csv", "--measured", "T_in=0.1bar"), "unit 'bar' cannot be turned into 'K'"),
    (("lag.py", "day.csv", "--measured", "T_in=-0.1K"), "measured 'T_in': its noise is '-0.1', must be a number above"),
    (("lag.py", "day.csv", "--measured", "T_inn=1K"), "no input 'T_inn'; did you mean 'T_in'?"),
    (("lag.py", "day.csv", "--out", "file/out"), "cannot write file/out/.writable"),
    (("lag.py",), "the following arguments are required: RECORDING"),
]


@pytest.mark.parametrize(("arguments", "says"), BAD, ids=[" ".join(a)[:50] for a, _ in BAD])
def test_bad_input_is_one_line_and_nothing_is_written(
    workplace: Path, engine: dict[str, Any], capsys: pytest.CaptureFixture[str], arguments: tuple[str, ...], says: str
) -> None:
    assert says in refused(workplace, capsys, "mismatch", "--json", "--out", "found/here", *arguments)


def test_mismatch_hands_on_what_is_known_beforehand(workplace: Path, engine: dict[str, Any]) -> None:
    known = ("--leave-out", "periodic@*", "--leave-out", "offset@T", "--prior", "radiation@T=0.1", "--measured")
    assert twinbench("mismatch", "lag.py", "day.csv", *known, "T_in=0.9 degF", "--out", "found") == NAMED
    assert engine["leave_out"] == ("periodic@*", "offset@T")
    assert engine["prior"] == {"radiation@T": 0.1}
    assert engine["measured"] == pytest.approx({"T_in": 0.5})


def test_input_that_the_engine_refuses_leaves_no_folder(
    workplace: Path, engine: dict[str, Any], capsys: pytest.CaptureFixture[str]
) -> None:
    engine["fails"] = BadInput("simulator 'lag' diverges")
    line = refused(workplace, capsys, "mismatch", "lag.py", "day.csv", "--out", "found/here")
    assert "twinbench: simulator 'lag' diverges" in line


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (("--simulator", "lag.py"), "--simulator and --inputs go together"),
        (("--inputs", "day.csv"), "--simulator and --inputs go together"),
        (("--simulator", "blows_up.py", "--inputs", "day.csv"), "simulator 'lag' diverges on recording day at"),
        (("--simulator", "lag.py", "--inputs", "day.csv", "lacks.csv"), "lacks.csv: no column 'T_in'"),
    ],
)
def test_simulate_refuses_in_one_line(
    workplace: Path, capsys: pytest.CaptureFixture[str], arguments: tuple[str, ...], says: str
) -> None:
    assert says in refused(workplace, capsys, "simulate", "--out", "replayed", *arguments)


def test_help_teaches(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        twinbench("mismatch", "--help")
    said = capsys.readouterr().out
    for word in ("--hold-out", "--catalogue", "--map", "--json", "model.toml", "example:"):
        assert word in said
