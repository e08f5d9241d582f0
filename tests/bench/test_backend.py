"""A cluster of two processes, one of which is killed in mid-suite, gives the tables of this machine alone."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pandas as pd
import pytest
from helpers.oven_fleet import LEFT_OUT, LOSS, write_ovens
from helpers.tiny_run import comparable, run_arguments, twinbench, write_estimator, write_profile

dask, distributed = pytest.importorskip("dask"), pytest.importorskip("distributed")
pytestmark = pytest.mark.usefixtures("in_this_process")

DIES = """
        import os, pathlib
        if not os.path.exists({mark!r}):
            pathlib.Path({mark!r}).touch()
            os.kill(os.getpid(), 9)
"""
"""The first process that comes here ends as by the system's hand."""
SEARCHED = '    search_space = {"scale": (0.6, 1.7)}\n    implementations'


@pytest.fixture(scope="module")
def scheduler() -> Iterator[str]:
    """The scheduler's address of a cluster of two processes, which nobody starts again once they are killed.

    It gives an item up that loses one worker. So Twinbench has to ask for it again.
    """
    with (
        dask.config.set({"distributed.scheduler.allowed-failures": 0}),
        distributed.LocalCluster(n_workers=0, dashboard_address=":0", silence_logs=50) as cluster,
    ):
        command = [sys.executable, "-m", "dask", "worker", cluster.scheduler_address, "--no-nanny", "--nthreads", "1"]
        workers = [subprocess.Popen(command, stderr=subprocess.DEVNULL) for _ in range(2)]
        try:
            yield cluster.scheduler_address
        finally:
            for worker in workers:
                worker.kill()
                worker.wait()


def estimators(folder: Path, fit: str = "") -> list[str]:
    """Two that can be tuned; ``fit``: lines of the first."""
    folder.mkdir(exist_ok=True)
    specs = [write_estimator(folder, "steady", fit=fit), write_estimator(folder, "wrong", scale=1.05)]
    for spec in map(Path, specs):
        spec.write_text(spec.read_text().replace("    implementations", SEARCHED))
    return specs


@pytest.mark.timeout(300)
def test_a_worker_killed_in_mid_suite_is_told_and_changes_no_table(
    scheduler: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    profile = write_profile(tmp_path)
    here, there = tmp_path / "here", tmp_path / "there"
    assert twinbench(*run_arguments(profile, here, estimators(tmp_path / "sound"))) == 0
    dies = estimators(tmp_path / "dies", DIES.format(mark=str(tmp_path / "died")))
    capsys.readouterr()
    # Paths are relative to where the command starts, and the workers started elsewhere.
    spread = run_arguments(Path("tiny.toml"), Path("there"), [str(Path(s).relative_to(tmp_path)) for s in dies])
    assert twinbench(*spread, "--backend", "dask", "--scheduler", scheduler) == 0
    said = capsys.readouterr().err
    assert said.count(" lost its worker, tcp://") == 1
    assert "train: steady, seed 0 lost its worker, tcp://" in said
    assert comparable(there) == comparable(here)
    assert not list(there.glob(".at-work-*"))


@pytest.mark.timeout(300)
def test_tuning_on_a_cluster_tries_what_it_tries_here(scheduler: str, tmp_path: Path) -> None:
    specs = estimators(tmp_path)
    arguments = ("tune", *specs, "--profile", write_profile(tmp_path), "--trials", 5, "--out")
    assert twinbench(*arguments, tmp_path / "here") == 0
    assert twinbench(*arguments, tmp_path / "there", "--scheduler", scheduler) == 0
    for name in ("steady", "wrong"):
        here, there = (pd.read_csv(tmp_path / out / f"{name}.csv").drop(columns="seconds") for out in ("here", "there"))
        pd.testing.assert_frame_equal(there, here, check_exact=True)


@pytest.mark.timeout(300)
def test_the_machines_of_a_fleet_are_asked_on_a_cluster(
    scheduler: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Paths are relative here too."""
    monkeypatch.chdir(tmp_path)
    asked = ("fleet", *write_ovens(tmp_path, (0.0, LOSS)), *LEFT_OUT)
    assert twinbench(*asked, "--out", "found", "--scheduler", scheduler) == 10
    told = json.loads((tmp_path / "found" / "fleet.json").read_text())
    assert [one["mechanism"] for one in told["shared"]] == ["offset@T_C"]
    for name in ("oven0", "oven1"):
        own = json.loads((tmp_path / "found" / "machines" / name / "verdict.json").read_text())
        assert told["machines"][name]["says"] == own["says"]
