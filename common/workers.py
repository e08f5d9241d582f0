"""Work in processes side by side, here or on a cluster: an item whose worker dies goes to another one.

No process of this machine is left behind.
"""

from __future__ import annotations

import functools
import multiprocessing
import os
import signal
import sys
import tempfile
import warnings
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path
from typing import Any

import joblib

from twinbench.common.attempts import AT_WORK, Done, at_work, attempt
from twinbench.common.cluster import current, on_cluster
from twinbench.common.errors import WorkerKilled
from twinbench.common.jobs import VARIABLE, cores
from twinbench.common.orphans import end_with_parent

Several = Mapping[str, tuple[Any, ...]]
"""Arguments of a function, by what the item is called."""


def side_by_side(
    work: Callable[..., Any],
    several: Several,
    say: Callable[[str], object],
    folder: Path | None = None,
    jobs: int = 0,
) -> Iterator[Any]:
    """``work(*arguments)`` for each of several items, results as they come.

    Work is done on the cluster that ``common.cluster.working_on`` names, else in processes of this machine. An item
    whose worker dies is done by another one.

    Args:
        say: hears of each item that lost a worker, in one line.
        folder: where the results go; all workers of a cluster have to see it.
        jobs: processes on this machine; one: this one; 0: as many as there are cores.

    Raises:
        BadInput: a worker of the cluster cannot be used.
        WorkerKilled: an item lost too many workers; all others are done.
    """
    client = current()
    if client is None:
        ended = _in_processes(work, several, min(jobs or cores(), len(several)))
    else:
        ended = on_cluster(client, work, several, say, folder or Path())
    given_up = []
    for name, done in ended:
        if done.given_up:
            given_up.append(done.says(name))
            continue
        if done.lost:
            say(done.says(name))
        yield done.result
    if given_up:
        raise WorkerKilled(
            f"{'; '.join(given_up)}. Perhaps memory ran out; run the same command again to go on from what is finished"
        )


def in_new_process(work: Callable[..., Any], *arguments: Any) -> Any:
    """``work(*arguments)`` in a process that has done nothing before.

    Raises:
        WorkerKilled: it ended in mid-work.
    """
    fresh = multiprocessing.get_context("spawn")
    try:
        with ProcessPoolExecutor(1, fresh, _settle_in, (os.getpid(),)) as pool:
            return pool.submit(work, *arguments).result()
    except BrokenProcessPool as error:
        raise WorkerKilled("the process that was at work died; perhaps memory ran out") from error


def _in_processes(work: Callable[..., Any], several: Several, jobs: int) -> Iterator[tuple[str, Done]]:
    if jobs <= 1:
        for name, arguments in several.items():
            yield name, Done((), work(*arguments))
        return
    left = dict(enumerate(several.items()))
    # loky starts a process anew once it holds much memory. Loaded sequences do that; nothing is lost.
    with tempfile.TemporaryDirectory(prefix=AT_WORK, ignore_cleanup_errors=True) as folder, warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="A worker stopped while some jobs")
        marks, suspects = Path(folder), list[int]()
        while left:
            # All that were at work end with the one that dies. Each is tried alone: then it is known who dies.
            calls = [
                joblib.delayed(_in_worker)(os.getpid(), marks, number, work, left[number][1])
                for number in suspects[:1] or left
            ]
            try:
                for number, done in joblib.Parallel(n_jobs=jobs, return_as="generator_unordered")(calls):
                    name, _ = left.pop(number)
                    yield name, done
            except BrokenProcessPool as error:
                if not any(at_work(marks, number) for number in left):
                    raise WorkerKilled("worker processes die before they begin; perhaps memory ran out") from error
            suspects = [number for number in left if at_work(marks, number)]


def _in_worker(
    parent: int, marks: Path, number: int, work: Callable[..., Any], arguments: tuple[Any, ...]
) -> tuple[int, Done]:
    _settle_in(parent)
    return number, attempt(marks, number, f"process {os.getpid()}", lambda: work(*arguments))


@functools.cache
def _settle_in(parent: int) -> None:
    """Once in each worker: it works alone, prints beside the results, leaves Ctrl-C to its parent and ends with it."""
    os.environ[VARIABLE] = "1"
    sys.stdout = sys.stderr
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    end_with_parent(parent)


def end_workers() -> None:
    """End all workers of this process; joblib's know no kill."""
    for child in multiprocessing.active_children():
        child.terminate()
