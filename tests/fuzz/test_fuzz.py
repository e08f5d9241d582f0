"""No mutated input ends in a traceback, a hang, silent nonsense, or with something left behind."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pandas as pd
import pytest

from fuzz.commands import CASES, WAYS
from fuzz.judge import BAD, GOOD

HERE = Path(__file__).parent
NOT_YET = ("fmu", "record")
"""Commands that the committed table has no rows of."""
COMMITTED = HERE.parents[1] / "results" / "fuzz" / "outcomes.csv"


def fuzz(folder: Path, *arguments: str) -> tuple[pd.DataFrame, str]:
    """``python tests/fuzz`` in a process of its own, which forks: the table, and what is wrong case by case."""
    command = [sys.executable, str(HERE), "--jobs", "1", "--out", str(folder), *arguments]
    done = subprocess.run(command, capture_output=True, text=True, cwd=folder)
    assert (folder / "outcomes.csv").is_file(), done.stderr
    return pd.read_csv(folder / "outcomes.csv"), done.stdout + done.stderr


@pytest.fixture(scope="module")
def few(tmp_path_factory) -> tuple[pd.DataFrame, str]:
    return fuzz(tmp_path_factory.mktemp("few"), "--fast")


@pytest.mark.parametrize("end", BAD)
def test_of_a_few_cases_of_every_command_none_ends_so(few, end):
    table, said = few
    assert table[end].sum() == 0, said


def test_a_few_cases_reach_every_command_and_end_in_every_way(few):
    table, _ = few
    assert set(table["command"]) == set(WAYS)
    assert (table[list(GOOD)].sum()[["refused", "answered"]] > 20).all()


@pytest.mark.parametrize("command", [command for command in WAYS if command not in NOT_YET])
def test_the_committed_table_is_whole_and_clean(command):
    table = pd.read_csv(COMMITTED).query("command == @command")
    assert table["n"].sum() >= 300
    assert (table[[*GOOD, *BAD]].sum(axis=1) == table["n"]).all()
    assert table[list(BAD)].to_numpy().sum() == 0


@pytest.mark.slow
@pytest.mark.timeout(3600)
@pytest.mark.parametrize("command", WAYS)
def test_of_all_cases_none_ends_badly(tmp_path, command):
    table, said = fuzz(tmp_path, command)
    assert table["n"].sum() == CASES
    assert table[list(BAD)].to_numpy().sum() == 0, said
