"""Work in processes side by side; none of them is left behind, and one that is killed is told in one line."""

from __future__ import annotations

import contextlib
import functools
import multiprocessing
import os
import signal
import sys
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from typing import Any

import joblib

from twinbench.common.jobs import VARIABLE
from twinbench.common.orphans import end_with_parent


class WorkerKilled(RuntimeError):
    """A worker process ended in mid-work: killed, out of memory, or a crash in compiled code."""


def side_by_side(
    work: Callable[..., Any], several: Iterable[tuple[Any, ...]], jobs: int, local: bool = True
) -> Iterator[Any]:
    """``work(*arguments)`` for each of several arguments, results as they come.

    Args:
        jobs: processes; one: this one.
        local: they are joblib's own, not a cluster's.

    Raises:
        WorkerKilled: one of them ended in mid-work.
    """
    called = functools.partial(_in_worker, os.getpid(), work) if local and jobs != 1 else work
    parallel = joblib.Parallel(n_jobs=jobs, return_as="generator_unordered")
    with _telling():
        yield from parallel(joblib.delayed(called)(*arguments) for arguments in several)


def in_new_process(work: Callable[..., Any], *arguments: Any) -> Any:
    """``work(*arguments)`` in a process that has done nothing before.

    Raises:
        WorkerKilled: it ended in mid-work.
    """
    fresh = multiprocessing.get_context("spawn")
    with _telling(), ProcessPoolExecutor(1, fresh, _settle_in, (os.getpid(),)) as pool:
        return pool.submit(work, *arguments).result()


@contextlib.contextmanager
def _telling() -> Iterator[None]:
    try:
        yield
    except BrokenProcessPool as error:
        raise WorkerKilled(
            "a worker process was killed, perhaps because memory ran out; run the same command again to go on from "
            "what is finished, with --jobs 1 if it happens again"
        ) from error


def _in_worker(parent: int, work: Callable[..., Any], *arguments: Any) -> Any:
    _settle_in(parent)
    return work(*arguments)


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
