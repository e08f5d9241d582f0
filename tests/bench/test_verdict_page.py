"""The page on verdicts for programs: its statuses are the command's, its filters run, its fields are all there are."""

from __future__ import annotations

import hashlib
import json
import re
import shutil
import subprocess
from pathlib import Path
from typing import Any

import pytest
from helpers.documents import NOWHERE, bare_verdict, described
from helpers.prose import ROOT
from helpers.site_code import site_code
from helpers.tiny_run import twinbench

from twinbench.bench.cli.mismatch_status import SAYS
from twinbench.bench.cli.schema import SCHEMAS

PAGE = (ROOT / "docs" / "verdict_json.md").read_text(encoding="utf-8")
FINDING = {"kind": "missing physics", "mechanism": None, "port": "balance:T", "probability": 0.5}
FIT = {"held_out": True, "rmse_after": 2.0, "noise_sd": 1.0}


def test_the_exit_statuses_are_those_of_the_help(capsys: pytest.CaptureFixture[str]) -> None:
    told = {int(status): says for status, says in re.findall(r"^\| (\d+) \|[^|]*\| (.*) \|$", PAGE, re.MULTILINE)}
    with pytest.raises(SystemExit):
        twinbench("--help")
    listed = capsys.readouterr().out.partition("exit status:\n")[2].partition("completion of")[0]
    assert set(told) == {int(a or b) for a, b in re.findall(r"^ +(\d+)  |\((\d+) by SIGTERM\)", listed, re.MULTILINE)}
    for status, says in SAYS.items():
        assert told[status].endswith(says)


@pytest.mark.skipif(shutil.which("jq") is None, reason="no jq")
def test_the_filters_of_jq_run(tmp_path: Path) -> None:
    (tmp_path / "found").mkdir()
    (tmp_path / "tanks.py").write_text("x")
    made: dict[str, Any] = {**NOWHERE, "files": [{"path": "tanks.py", "sha256": hashlib.sha256(b"x").hexdigest()}]}
    noted = [{"name": "day1", "notes": ["means over 10 s", "joined of day1.csv"]}]
    document = {**bare_verdict("missing physics"), "findings": [FINDING], "fit": [FIT], "recordings": noted}
    document["provenance"] = made
    (tmp_path / "found" / "verdict.json").write_text(json.dumps(document))
    lines = re.findall(r"^jq .*$", PAGE, re.MULTILINE)
    said = []
    for line in lines:
        done = subprocess.run(["sh", "-c", line], cwd=tmp_path, capture_output=True, text=True, check=True)
        said.append(done.stdout.split("\n")[0])
    first = ["missing physics", "day1: means over 10 s; joined of day1.csv"]
    assert said == [*first, "no name\tbalance:T\t0.5", "true", "true", "tanks.py: OK"]


@pytest.mark.parametrize("name", SCHEMAS)
def test_the_table_has_every_field_of_the_schema(name: str) -> None:
    hooks = site_code("hooks")
    assert hooks.FIELDS.findall(PAGE) == list(SCHEMAS)
    rows = re.findall(r"^\| `([^`]+)` \| [^|]+ \| (.+) \|$", hooks.fields_table(name), re.MULTILINE)
    told = {(where.rpartition(".")[2], says) for where, says in rows}
    schema = json.loads(SCHEMAS[name].read_text(encoding="utf-8"))
    assert told == {(where.rpartition(".")[2], says) for where, says in described(schema)}
