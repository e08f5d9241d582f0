"""The tutorial is run as it stands: its files, its commands, and what it says they print."""

from __future__ import annotations

import contextlib
import io
import json
import re
import runpy
import shlex
import tomllib
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from twinbench.bench.cli.main import main
from twinbench.bench.cli.mismatch_status import NAMED

PAGE = (Path(__file__).parents[2] / "docs" / "mismatch_tutorial.md").read_text()
NUMBER = re.compile(r"\d+(?:\.\d+)?")


def blocks(language: str) -> list[str]:
    return re.findall(rf"```{language}\n(.*?)```", PAGE, re.DOTALL)


@pytest.fixture(scope="module")
def followed(tmp_path_factory) -> tuple[Path, list[str]]:
    """A folder in which somebody followed the page, and what was printed, verdict by verdict."""
    folder = tmp_path_factory.mktemp("tutorial")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        for block in blocks("python"):
            Path(re.match(r"# (\w+\.py)\n", block)[1]).write_text(block)
        runpy.run_path("logger.py")
        verdicts = []
        for line in "".join(blocks("sh")).splitlines():
            with contextlib.redirect_stdout(io.StringIO()) as printed:
                status = main(shlex.split(line)[1:])
            assert status == (NAMED if line.startswith("twinbench mismatch") else 0)
            if status == NAMED:
                verdicts.append(printed.getvalue().partition("\nreport: ")[0])
        runpy.run_path("again.py")
    return folder, verdicts


def verdict(folder: Path, name: str) -> dict:
    return json.loads((folder / name / "verdict.json").read_text())


def test_the_verdicts_are_those_on_the_page(followed):
    _, said = followed
    shown = blocks("text")
    said = [text if text.endswith("\n") else f"{text}\n" for text in said]
    assert [NUMBER.sub("#", text) for text in said] == [NUMBER.sub("#", text) for text in shown]
    for a, b in zip(said, shown, strict=True):
        assert [float(x) for x in NUMBER.findall(a)] == pytest.approx(list(map(float, NUMBER.findall(b))), rel=0.1)


def test_dry_friction_is_found_alone_and_of_its_true_size(followed):
    (finding,) = verdict(followed[0], "found")["findings"]
    assert finding["mechanism"] == "coulomb_friction@omega_rad_s"
    assert finding["indistinguishable_from"] == []
    size = finding["parameters"]["coulomb_friction_omega_rad_s"]["value"]
    inertia = verdict(followed[0], "found")["parameters"]["J_kg_m2"]["after"]
    assert size * inertia == pytest.approx(0.9, rel=0.05)


def test_the_users_mechanism_is_found_beside_all_of_ours(followed):
    (finding,) = verdict(followed[0], "found_brake")["findings"]
    assert finding["mechanism"] == "eddy_current_brake"
    assert finding["port"] == "balance:omega_rad_s"


def test_the_mended_model_stands_on_the_first_and_on_the_users_file(followed):
    model = tomllib.loads((followed[0] / "found_brake" / "model.toml").read_text())
    assert model["base"] == "../found/model.toml"
    assert [m["from"] for m in model["mechanisms"]] == ["../brake.py"]


def test_everything_that_the_page_says_is_written_is(followed):
    for name in ("report.html", "report.pdf", "verdict.json", "model.toml", "figures"):
        assert (followed[0] / "found" / name).exists()


def test_the_mended_model_follows_the_held_out_recording(followed):
    folder, _ = followed
    measured = pd.read_csv(folder / "saturday.csv")["speed_rad_s"]
    simulated = pd.read_csv(folder / "replayed" / "saturday.simulated.csv")["speed_rad_s"]
    assert np.sqrt(np.mean((measured - simulated) ** 2)) < 0.5
