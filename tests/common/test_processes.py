"""Killed, stopped and orphaned: one line, and no process is left behind."""

from __future__ import annotations

import contextlib
import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from helpers.tiny_run import run_arguments, write_estimator, write_profile

pytestmark = pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="looks for processes in /proc")

GONE = "ZX"
"""States of a process that has ended; whoever adopted it may not have looked yet."""
SLEEPS = "import os, pathlib, time; pathlib.Path(r'{}', str(os.getpid())).touch(); time.sleep({})"


def hears_ctrl_c() -> None:
    """In the process to be: what a shell starts in the background, these tests perhaps, ignores Ctrl-C."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)


class Run:
    """``twinbench run`` in a process of its own, whose workers say where they are and then sleep in ``fit``."""

    def __init__(self, folder: Path, seconds: float = 300.0) -> None:
        self.marks, self.out = folder / "marks", folder / "out"
        self.marks.mkdir()
        sleeps = SLEEPS.format(self.marks, seconds)
        specs = [write_estimator(folder, name, fit=sleeps) for name in ("one", "two")]
        self.command = [
            sys.executable,
            "-m",
            "twinbench",
            *run_arguments(write_profile(folder), self.out, specs),
            "--jobs",
            "2",
        ]
        environment = {k: v for k, v in os.environ.items() if k != "LOKY_MAX_CPU_COUNT"}
        environment["LOKY_MAX_CPU_COUNT"] = "2"  # even where the tests have one core
        self.process = subprocess.Popen(
            self.command,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            env=environment,
            start_new_session=True,
            preexec_fn=hears_ctrl_c,
        )

    def workers(self) -> list[int]:
        """Process ids, once both are at work."""
        until = time.monotonic() + 120.0
        while len(list(self.marks.iterdir())) < 2:
            assert self.process.poll() is None, self.process.stderr.read()
            assert time.monotonic() < until
            time.sleep(0.1)
        return [int(mark.name) for mark in self.marks.iterdir()]

    def left(self) -> list[int]:
        """Processes of its session that are still there a few seconds later."""
        until = time.monotonic() + 8.0
        while (found := in_session(self.process.pid)) and time.monotonic() < until:
            time.sleep(0.1)
        return found


def in_session(session: int) -> list[int]:
    """Living processes of a session."""
    found = []
    for stat in Path("/proc").glob("[0-9]*/stat"):
        with contextlib.suppress(OSError):
            state, _, _, its_session = stat.read_text().rpartition(")")[2].split()[:4]
            if int(its_session) == session and state not in GONE:
                found.append(int(stat.parent.name))
    return found


@pytest.fixture
def run(tmp_path: Path) -> Iterator[Run]:
    started = Run(tmp_path)
    yield started
    with contextlib.suppress(ProcessLookupError):
        os.killpg(started.process.pid, signal.SIGKILL)
    started.process.communicate()


def said(run: Run) -> list[str]:
    """What stands on stderr beside the plan and progress."""
    _, err = run.process.communicate(timeout=60)
    lines = err.splitlines()
    begins = next(i for i, line in enumerate(lines) if line.startswith("results in"))
    return [line for line in lines[begins + 1 :] if not re.match(r"(simulate|train): ", line)]


def test_sigterm_takes_the_workers_along(run: Run) -> None:
    run.workers()
    os.kill(run.process.pid, signal.SIGTERM)
    assert said(run) == ["twinbench: stopped; run the same command again to go on"]
    assert run.process.returncode == 143
    assert run.left() == []


def test_ctrl_c_reaches_all_and_is_told_once(run: Run) -> None:
    run.workers()
    os.killpg(run.process.pid, signal.SIGINT)
    assert said(run) == ["twinbench: stopped; run the same command again to go on"]
    assert run.process.returncode == 130
    assert run.left() == []


def test_workers_of_a_killed_run_end_by_themselves(run: Run) -> None:
    run.workers()
    os.kill(run.process.pid, signal.SIGKILL)
    run.process.wait(timeout=10)
    assert run.left() == []


def test_a_process_of_a_worker_ends_with_it(tmp_path: Path) -> None:
    child = (
        "import time; from twinbench.common.orphans import end_with_parent; end_with_parent(); "
        "print('here', flush=True); time.sleep(300)"
    )
    parent = (
        "import subprocess, sys, time\n"
        f"p = subprocess.Popen([sys.executable, '-c', {child!r}], stdout=subprocess.PIPE)\n"
        "p.stdout.readline(); print(p.pid, flush=True); time.sleep(300)"
    )
    started = subprocess.Popen(
        [sys.executable, "-c", parent], stdout=subprocess.PIPE, text=True, start_new_session=True
    )
    assert started.stdout is not None
    child_id = int(started.stdout.readline())
    assert child_id in in_session(started.pid)
    started.kill()
    started.communicate()
    until = time.monotonic() + 8.0
    while in_session(started.pid) and time.monotonic() < until:
        time.sleep(0.1)
    assert in_session(started.pid) == []


WAITING = '''
import multiprocessing
import os
from twinbench.common.workers import end_workers, side_by_side

print(sorted(side_by_side(abs, {str(n): (-n,) for n in (1, 2, 3)}, print, jobs=2)))
waiting = multiprocessing.active_children()
print(len(waiting))
end_workers()


def there(process):
    """By the system: whether joblib's thread or this one has waited for it, ``is_alive`` does not know."""
    try:
        os.kill(process.pid, 0)
    except ProcessLookupError:
        return False
    return True


for child in waiting:
    child.join(timeout=10)
print(any(there(child) for child in waiting))
'''


def test_workers_that_wait_for_work_are_ended_too() -> None:
    done = subprocess.run([sys.executable, "-c", WAITING], capture_output=True, text=True, check=False, timeout=100)
    assert done.stdout == "[1, 2, 3]\n2\nFalse\n", done.stderr
