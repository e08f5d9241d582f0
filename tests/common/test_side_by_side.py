"""Work side by side: an item whose worker dies is done by another, or given up; workers that cannot be used are told.

The benchmark's own work on a cluster is in tests/bench/test_backend.py.
"""

from __future__ import annotations

import os
import re
import signal
from collections.abc import Iterator
from pathlib import Path

import pytest

from twinbench.common.cluster import working_on
from twinbench.common.errors import BadInput, WorkerKilled
from twinbench.common.workers import side_by_side


def dies(folder: Path, name: str, times: int) -> str:
    """Ends its process the first few times that it is called, as the system does when memory runs out."""
    with open(folder / name, "a+") as file:
        file.seek(0)
        died = len(file.read())
        if died < times:
            file.write("x")
            file.flush()
            os.kill(os.getpid(), signal.SIGKILL)
    return name


def test_an_item_that_loses_its_process_is_done_by_another_and_told(tmp_path: Path) -> None:
    said: list[str] = []
    several = {name: (tmp_path, name, int(name == "b")) for name in "abcd"}
    assert sorted(side_by_side(dies, several, said.append, jobs=2)) == list("abcd")
    assert any(re.fullmatch(r"b lost its worker, process \d+; another has done it", line) for line in said), said


def test_an_item_that_no_process_survives_is_given_up_after_all_others(tmp_path: Path) -> None:
    said: list[str] = []
    several = {name: (tmp_path, name, 9 * (name == "a")) for name in "abcd"}
    ended: list[str] = []
    says = r"^a lost 3 workers, process \d+ and .*; it is given up.*run the same command"
    with pytest.raises(WorkerKilled, match=says):
        ended.extend(side_by_side(dies, several, said.append, jobs=2))
    assert sorted(ended) == list("bcd")
    assert (tmp_path / "a").read_text() == "xxx"
    assert all("a lost" not in line for line in said), "it is told once"


@pytest.fixture
def threads(request: pytest.FixtureRequest) -> Iterator[None]:
    """On a cluster in this process, of one worker with so many threads."""
    distributed = pytest.importorskip("distributed")
    with (
        distributed.LocalCluster(
            n_workers=1, threads_per_worker=request.param, processes=False, dashboard_address=":0"
        ) as cluster,
        working_on("dask", cluster.scheduler_address),
    ):
        yield


@pytest.mark.parametrize("threads", [2], indirect=True)
@pytest.mark.usefixtures("threads")
def test_a_worker_of_several_threads_is_refused(tmp_path: Path) -> None:
    with pytest.raises(BadInput, match=r"^worker \S+ on \S+ has 2 threads; start it with --nthreads 1"):
        list(side_by_side(abs, {"one": (-1,)}, print, tmp_path / "out"))
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("threads", [1], indirect=True)
@pytest.mark.usefixtures("threads")
def test_a_worker_of_other_code_or_without_the_folder_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("OMP_NUM_THREADS", "LOKY_MAX_CPU_COUNT"):  # the worker, which is this process, pins them
        monkeypatch.setenv(name, "1")
    folder = tmp_path / "out"
    with monkeypatch.context() as patch:
        versions = iter("12")  # the command's and the worker's
        patch.setattr("twinbench.common.cluster.own_source", lambda: next(versions))
        with pytest.raises(BadInput, match=r"^worker \S+ on \S+ has not the Twinbench, or the libraries, of this mach"):
            list(side_by_side(abs, {"one": (-1,)}, print, folder))
        patch.undo()
        patch.setattr("twinbench.common.cluster.Path.cwd", lambda: tmp_path / "elsewhere")
        with pytest.raises(
            BadInput, match=r"^worker \S+ on \S+ does not see \S+/elsewhere of this machine; use a fold"
        ):
            list(side_by_side(abs, {"one": (-1,)}, print, folder))
    assert list(side_by_side(abs, {"one": (-1,)}, print, folder)) == [1]
