"""One command line in a process of its own, which may hang, crash or leave something behind."""

from __future__ import annotations

import contextlib
import os
import resource
import signal
import sys
import time
import traceback
from dataclasses import dataclass
from pathlib import Path

LONGEST_CPU_S = 20
"""Processor time after which a case counts as hung. A fuzz on a busy machine must not find hangs that are queues."""
LONGEST_WALL_S = 60.0
"""And wall-clock time, for one that waits."""
MOST_MEMORY_BYTES = 8 << 30
LARGEST_FILE_BYTES = 200 << 20
UNCAUGHT = 70


@dataclass(frozen=True)
class Ended:
    """How it ended. ``status`` is negative for a signal; ``hung`` if it ran out of time."""

    status: int
    out: str
    err: str
    hung: bool
    seconds: float


def run(arguments: tuple[str, ...], folder: Path, logs: Path) -> Ended:
    """``twinbench`` with arguments in a folder, in a fork of this process, so that imports are paid for once.

    Args:
        logs: a folder for what it prints, apart from the one it works in.
    """
    files = [logs / "out", logs / "err"]
    sys.stdout.flush()
    sys.stderr.flush()
    start = time.monotonic()
    child = os.fork()
    if child == 0:
        _child(arguments, folder, files)
    status, late = _wait(child, start + LONGEST_WALL_S)
    with contextlib.suppress(ProcessLookupError):
        os.killpg(child, signal.SIGKILL)  # workers of its own, if it left any
    out, err = (path.read_text(encoding="utf-8", errors="replace") for path in files)
    code = os.waitstatus_to_exitcode(status)
    return Ended(code, out, err, late or code == -signal.SIGXCPU, time.monotonic() - start)


def _wait(child: int, until: float) -> tuple[int, bool]:
    pause, late = 0.002, False
    while True:
        done, status = os.waitpid(child, os.WNOHANG)
        if done:
            return status, late
        if time.monotonic() > until and not late:
            os.killpg(child, signal.SIGKILL)
            late = True
        time.sleep(pause)
        pause = min(2 * pause, 0.05)


def _child(arguments: tuple[str, ...], folder: Path, files: list[Path]) -> None:
    """Never returns."""
    status = UNCAUGHT
    try:
        os.setsid()
        os.chdir(folder)
        for descriptor, path in enumerate((Path(os.devnull), *files)):
            how = os.O_RDONLY if descriptor == 0 else os.O_WRONLY | os.O_CREAT | os.O_TRUNC
            os.dup2(os.open(path, how, 0o644), descriptor)
        limits = {
            resource.RLIMIT_CPU: (LONGEST_CPU_S, LONGEST_CPU_S + 5), resource.RLIMIT_CORE: (0, 0),
            resource.RLIMIT_AS: (MOST_MEMORY_BYTES,) * 2, resource.RLIMIT_FSIZE: (LARGEST_FILE_BYTES,) * 2,
        }  # fmt: skip
        for what, (soft, hard) in limits.items():
            resource.setrlimit(what, (soft, hard))
        sys.argv = ["twinbench", *arguments]
        from bench.cli import main

        status = main(list(arguments))
    except SystemExit as stopped:
        status = stopped.code if isinstance(stopped.code, int) else int(stopped.code is not None)
    except BaseException:
        traceback.print_exc()
    finally:
        with contextlib.suppress(Exception):
            sys.stdout.flush()
            sys.stderr.flush()
        os._exit(status)
