"""``twinbench design``: what it writes and prints, and what it refuses."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from helpers.lag import LAG
from helpers.refusals import refused
from helpers.tiny_run import twinbench

from twinbench.common.store import sha256_of

LIMITS = """
[experiment]
duration_s = 100
sampling_s = 0.5
candidates = 5
[inputs.T_in]
low = 280.0
high = 320.0
rate_per_s = 5.0
[noise]
T_out = 0.5
"""
FOUND = {
    "findings": [],
    "inputs": {"inputs": "held"},
    "provenance": {
        "settings": {"catalogue": "", "map": [], "leave_out": [], "prior": [], "measured": []},
        "files": [{"role": "recording", "path": "gone.csv", "held_out": False, "sha256": "0" * 64}],
    },
}


@pytest.fixture
def workplace(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A simulator of one temperature, and limits for it, in the current folder."""
    monkeypatch.chdir(tmp_path)
    Path("lag.py").write_text(LAG)
    Path("limits.toml").write_text(LIMITS)
    Path("verdict.json").write_text(json.dumps(FOUND))
    Path("broken.json").write_text("{")
    Path("other.json").write_text("{}")
    return tmp_path


COMMAND = ("design", "lag.py", "--inputs", "limits.toml", "--out", "next")


def design(*options: str) -> int:
    return twinbench(*COMMAND, *options)


def test_an_experiment_is_written_that_keeps_the_limits(workplace: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert design("--rivals", "offset@T,loss_to_ambient@T") == 0
    told = capsys.readouterr().out
    assert re.match(r"To tell (offset@T|loss_to_ambient@T) and (offset@T|loss_to_ambient@T) apart, make a ", told)
    table = pd.read_csv("next/inputs.csv")
    assert list(table.columns) == ["time_s", "T_in"]
    assert len(table) == 200
    assert table["T_in"].between(280.0, 320.0).all()
    assert table["T_in"].diff().abs().max() <= 2.5 + 1e-9
    document = json.loads(Path("next/design.json").read_text())
    assert {rival["name"] for rival in document["rivals"]} == {"offset@T", "loss_to_ambient@T"}
    assert document["experiment"]["says"] in told.replace("\n", " ")
    assert Path("next/figures/experiment.png").is_file()


def test_nothing_contested_is_designed_for_the_parameters(workplace: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert design("--json") == 0
    document = json.loads(capsys.readouterr().out)
    assert (document["verdict"], document["expected"]) == ("nothing contested", None)
    (tau,) = document["parameters"]
    assert tau["name"] == "tau_s"
    assert 0.0 < tau["sd_left"] < 0.1


def test_an_input_of_the_proposal_drives_the_simulator(workplace: Path) -> None:
    assert design() == 0
    assert twinbench("simulate", "--simulator", "lag.py", "--inputs", "next/inputs.csv", "--out", "replayed") == 0


def test_recordings_at_hand_count_and_are_told_too(workplace: Path) -> None:
    """A lag that loses heat was recorded around one temperature: an offset would do the same there."""
    rng, time_s, x = np.random.default_rng(4), 0.5 * np.arange(200), 298.0
    u, y = 300.0 + 1.0 * (time_s > 40.0), np.empty(200)
    for k in range(200):
        y[k] = x + 0.3 * rng.normal()
        x += 0.5 * ((u[k] - x) / 20.0 + 0.01 * (290.0 - x))
    for name in ("day", "held"):
        pd.DataFrame({"time_s": time_s, "T_in": u, "T_out": y}).to_csv(f"{name}.csv", index=False)
    files = [
        {
            "role": "recording",
            "path": f"{name}.csv",
            "held_out": name == "held",
            "sha256": sha256_of(Path(f"{name}.csv")),
        }
        for name in ("day", "held")
    ]
    rivals = ["loss_to_ambient@T", "offset@T"]
    weights = dict.fromkeys(rivals, 0.5)
    finding = {"mechanism": rivals[0], "indistinguishable_from": rivals[1:], "since_s": None, "weights": weights}
    verdict = {**FOUND, "findings": [finding], "provenance": {**FOUND["provenance"], "files": files}}
    Path("verdict.json").write_text(json.dumps(verdict))
    assert design("--verdict", "verdict.json") == 0
    document = json.loads(Path("next/design.json").read_text())
    assert sorted(rival["name"] for rival in document["rivals"]) == rivals
    assert [rival["probability"] for rival in document["rivals"]] == pytest.approx([0.5, 0.5])
    (again,) = document["again"]
    assert again["says"] == "the inputs of day"
    assert again["worst_nats"] <= document["expected"]["worst_nats"]
    assert again["sensors"] == [], "its only state is read"


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (("high = 320.0", "high = 280.0"), "allows no input to move; raise high above low"),
        (("rate_per_s = 5.0", "rate_per_s = 0"), "allows no input to move"),
        (("high = 320.0", ""), r"\[inputs.T_in\]: high is missing; add it"),
        (("high = 320.0", "high = 'hot'"), "high is 'hot', must be a number"),
        (("high = 320.0", "high = 20.0"), "low must not be above high"),
        (("[inputs.T_in]", "[inputs.T_inn]"), "the simulator has no such input; did you mean 'T_in'"),
        (("duration_s = 100", ""), "duration_s is missing"),
        (("duration_s = 100", "duration_s = 5"), "has 10 samples, must have 30"),
        (("sampling_s = 0.5", "sampling_s = 0"), "sampling_s must be above 0"),
        (("[noise]\nT_out = 0.5", ""), "the noise of T_out is not known"),
        (("T_out = 0.5", "T_out = 0"), "T_out must be above 0"),
        (("T_out = 0.5", "T_in = 0.5"), "the simulator has no output 'T_in'"),
        (("[experiment]", "[trial]"), "'trial' is not known"),
        (("candidates = 5", "runs = ['gone.csv']"), "gone.csv"),
        (("candidates = 5", "runs = 'a.csv'"), "runs must be a list of files"),
    ],
)
def test_limits_that_cannot_be_used_are_refused(
    change: tuple[str, str], says: str, workplace: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert change[0] in LIMITS
    Path("limits.toml").write_text(LIMITS.replace(*change))
    assert re.search(says, refused(workplace, capsys, *COMMAND))


@pytest.mark.parametrize(
    ("options", "says"),
    [
        (("--rivals", "offset@T,ofset@T"), "rival 'ofset@T' is not in the catalogue; did you mean 'offset@T'"),
        (("--rivals", "sensor_stuck@T_out"), "has no size that a fit could find"),
        (("--verdict", "gone.json"), "gone.json: cannot be read"),
        (("--verdict", "broken.json"), "broken.json: is not JSON"),
        (("--verdict", "other.json"), "is no verdict.json of this version"),
        (("--verdict", "verdict.json"), "its recording gone.csv is not there"),
    ],
)
def test_rivals_and_verdicts_that_cannot_be_used_are_refused(
    options: tuple[str, ...], says: str, workplace: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert re.search(says, refused(workplace, capsys, *COMMAND, *options))
