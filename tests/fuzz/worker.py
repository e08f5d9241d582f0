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

LONGEST_S = 20.0
"""After so much processor time of all its processes a case counts as hung, and after so long a time in which they use
next to none: a fuzz on a busy machine must not take for a hang what waits for its turn."""
NOTHING_S = 0.1
"""Processor time in LONGEST_S that is next to none."""
LONG_PAUSE_S = 0.05
"""Between looks at a case that has run for longer than most."""
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


def run(arguments: tuple[str, ...], folder: Path, logs: Path, longest_s: float = LONGEST_S) -> Ended:
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
    status, late = _wait(child, longest_s)
    with contextlib.suppress(ProcessLookupError):
        os.killpg(child, signal.SIGKILL)  # workers of its own, if it left any
    out, err = (path.read_text(encoding="utf-8", errors="replace") for path in files)
    code = os.waitstatus_to_exitcode(status)
    return Ended(code, out, err, late, time.monotonic() - start)


def _wait(child: int, longest_s: float) -> tuple[int, bool]:
    """Its status, and whether it had to be ended."""
    pause, late, since, used = 0.002, False, time.monotonic(), 0.0
    while True:
        done, status = os.waitpid(child, os.WNOHANG)
        if done:
            return status, late
        now_used = _processor_s(child) if pause > LONG_PAUSE_S else 0.0
        if now_used - used > NOTHING_S:
            since, used = time.monotonic(), now_used
        if not late and (now_used > longest_s or time.monotonic() - since > LONGEST_S):
            os.killpg(child, signal.SIGKILL)
            late = True
        time.sleep(pause)
        pause = min(1.5 * pause, 2.0 * LONG_PAUSE_S)


def _processor_s(session: int) -> float:
    """Processor time of all processes of a session, and of those of theirs that have ended."""
    ticks = 0
    for stat in Path("/proc").glob("[0-9]*/stat"):
        with contextlib.suppress(OSError):
            fields = stat.read_text().rpartition(")")[2].split()
            if int(fields[3]) == session:
                ticks += sum(map(int, fields[11:15]))
    return ticks / os.sysconf("SC_CLK_TCK")


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
            resource.RLIMIT_CORE: (0, 0),
            resource.RLIMIT_AS: (MOST_MEMORY_BYTES,) * 2,
            resource.RLIMIT_FSIZE: (LARGEST_FILE_BYTES,) * 2,
        }
        for what, (soft, hard) in limits.items():
            resource.setrlimit(what, (soft, hard))
        sys.argv = ["twinbench", *arguments]
        from twinbench.bench.cli.main import main

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
