"""The file for a SLURM site works, where processes of this machine stand in for SLURM's jobs."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from twinbench.common.cluster import working_on
from twinbench.common.workers import side_by_side

EXAMPLE = Path(__file__).parents[2] / "examples" / "slurm_cluster.py"
SBATCH = """#!/bin/bash
setsid bash -c "$(cat "$1")" >"$JOBS/log" 2>&1 &
echo "Submitted batch job $!"
"""
SCANCEL = """#!/bin/bash
echo "$@" >>"$JOBS/cancelled"
kill -- "-$1"
"""


@pytest.mark.timeout(200)
def test_the_slurm_file_submits_a_job_again_that_ends_and_takes_all_along(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("dask_jobqueue")
    for name, text in (("sbatch", SBATCH), ("scancel", SCANCEL)):
        (tmp_path / name).write_text(text)
        (tmp_path / name).chmod(0o755)
    environment = os.environ | {
        "PATH": f"{tmp_path}{os.pathsep}{os.environ['PATH']}",
        "JOBS": str(tmp_path),
        "DASK_DISTRIBUTED__DEPLOY__LOST_WORKER_TIMEOUT": "1s",
    }
    begun = tmp_path / "begun"

    def ends_its_job_once() -> str:
        if not begun.exists():
            begun.touch()
            os.killpg(0, signal.SIGKILL)
        return "done"

    said: list[str] = []
    cluster = subprocess.Popen([sys.executable, str(EXAMPLE), "1"], cwd=tmp_path, env=environment)
    file = tmp_path / "scheduler.json"
    try:
        while not file.exists():
            assert cluster.poll() is None
            time.sleep(0.1)
        with working_on("dask", str(file)):
            assert list(side_by_side(ends_its_job_once, {"one": ()}, said.append, tmp_path / "out")) == ["done"]
    finally:
        cluster.terminate()
        assert cluster.wait(timeout=60) == 0
    assert said[-1].startswith("one lost its worker, tcp://"), said
    assert (tmp_path / "cancelled").is_file()
    assert not file.exists()
