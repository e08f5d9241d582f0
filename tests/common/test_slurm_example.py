"""The file for a SLURM site works, where processes of this machine stand in for SLURM's jobs."""

from __future__ import annotations

import os
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
def test_the_slurm_file_asks_for_workers_that_do_the_work_and_end_with_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("dask_jobqueue")
    for name, text in (("sbatch", SBATCH), ("scancel", SCANCEL)):
        (tmp_path / name).write_text(text)
        (tmp_path / name).chmod(0o755)
    environment = os.environ | {"PATH": f"{tmp_path}{os.pathsep}{os.environ['PATH']}", "JOBS": str(tmp_path)}
    cluster = subprocess.Popen([sys.executable, str(EXAMPLE), "1"], cwd=tmp_path, env=environment)
    file = tmp_path / "scheduler.json"
    try:
        while not file.exists():
            assert cluster.poll() is None
            time.sleep(0.1)
        with working_on("dask", str(file)):
            assert list(side_by_side(abs, {"one": (-1,)}, print, tmp_path / "out")) == [1]
    finally:
        cluster.terminate()
        assert cluster.wait(timeout=60) == 0
    assert (tmp_path / "cancelled").is_file()
    assert not file.exists()
