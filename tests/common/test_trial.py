"""What a user wrote is tried under a clock: it ends in one line, wherever it loops and however it ends Python."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from pathlib import Path

import pytest
from helpers.linked_tanks import LEAK, TANK, write

from twinbench.common import trial
from twinbench.physics.load import load_catalogue, load_simulator

REST = "return np.array(["
ENDLESS = "import time; time.sleep(6.0)"  # a thread cannot be ended, and must not run beside all later tests
WAYS = [pytest.param(trial._in_child, id="process"), pytest.param(trial._in_thread, id="thread")]


@pytest.fixture(params=WAYS)
def way(request, monkeypatch):
    """Both ways of trying, each with little patience."""
    monkeypatch.setattr(trial, "CALL_S", 2.0)
    monkeypatch.setattr(trial, "IDLE_S", 2.0)
    monkeypatch.setattr(trial, "_in_child", request.param)
    monkeypatch.setattr(trial, "_in_thread", request.param)


def refused(spec: str) -> str:
    began = time.perf_counter()
    with pytest.raises(ValueError) as caught:  # noqa: PT011
        load_simulator(spec)
    assert time.perf_counter() - began < 90.0
    assert "\n" not in str(caught.value)
    return str(caught.value)


@pytest.mark.usefixtures("way")
@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        (f"{REST}u", f"{ENDLESS}\n    {REST}u", "rhs(x, u, theta) has not ended"),
        (f"{REST}x", f"{ENDLESS}\n    {REST}x", "output(x, u, theta) has not ended"),
        (f"{REST}y", f"{ENDLESS}\n    {REST}y", "initial(u0, y0, theta) has not ended"),
        ("STATES = (", f"{ENDLESS}\nSTATES = (", "importing it has not ended"),
        (
            f"{REST}u",
            f"if x[0] == 0.0:\n        {ENDLESS}\n    {REST}u",
            "rhs(x, u, theta) at values between its bounds has not ended",
        ),
    ],
)
def test_what_does_not_end(tmp_path: Path, old: str, new: str, says: str) -> None:
    assert old in TANK
    line = refused(write(tmp_path, TANK.replace(old, new)))
    assert line.startswith(str(tmp_path / "tank.py"))
    assert says in line


@pytest.mark.usefixtures("way")
def test_a_mechanism_that_does_not_end(tmp_path: Path) -> None:
    text = LEAK.replace("    return -theta", f"    {ENDLESS}\n    return -theta")
    tank = load_simulator(write(tmp_path, TANK))
    with pytest.raises(ValueError, match=r"leak.py: mechanism 'leak': term\(x, u, theta\) has not ended"):
        load_catalogue(write(tmp_path, text, "leak.py"), tank)


@pytest.mark.skipif(sys.platform != "linux", reason="a thread cannot be ended")
def test_an_endless_loop_is_told_by_the_computing_it_does(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(trial, "CALL_S", 0.3)
    text = TANK.replace("    return np.array([u[0]", "    while True:\n        pass\n    return np.array([u[0]")
    assert "rhs(x, u, theta) has not ended after 0.3 s of computing" in refused(write(tmp_path, text))


COMPILED = """
from numba import njit

@njit
def forever(x):
    while x < 1e9:
        x = x * 1.0
    return x
"""


@pytest.mark.skipif(sys.platform != "linux", reason="a thread cannot be ended in compiled code")
def test_an_endless_loop_in_compiled_code(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(trial, "CALL_S", 5.0)
    text = COMPILED + TANK.replace("u[0] - theta", "forever(u[0]) - theta")
    assert "rhs(x, u, theta) has not ended after 5 s" in refused(write(tmp_path, text))


@pytest.mark.skipif(sys.platform != "linux", reason="a thread ends with all of Python")
@pytest.mark.parametrize(
    ("line", "says"),
    [
        ("import os; os._exit(0)", "rhs(x, u, theta) ends Python itself (exit status 0)"),
        ("import os; os.abort()", "rhs(x, u, theta) ends Python itself (signal 6)"),
        ("raise SystemExit(3)", "tank.py: simulator 'tank': rhs(x, u, theta) raises SystemExit: 3; mend it there"),
        ("raise KeyboardInterrupt", "rhs(x, u, theta) raises KeyboardInterrupt"),
        ("if x[0] == 0.0: raise SystemExit(0)", "rhs(x, u, theta) at values between its bounds raises SystemExit: 0"),
        ("return rhs(x, u, theta)", "fails in line 6: RecursionError"),
        ("return np.zeros(10**15)", "fails in line 6: "),
        ("return np.array([1j, 0.0])", "returns complex numbers"),
    ],
)
def test_what_ends_python_or_is_no_number(tmp_path: Path, line: str, says: str) -> None:
    old = "    return np.array([u[0]"
    assert says in refused(write(tmp_path, TANK.replace(old, f"    {line}\n{old}")))


@pytest.mark.parametrize(
    "line",
    [
        "x = x + np.random.default_rng().random()",
        "import time; x = x + time.perf_counter()",
        "MEMORY.append(0); x = x + len(MEMORY)",
        "x = x + (MEMORY[-1] if MEMORY else 0.0); MEMORY.append(x[1])",
    ],
)
def test_a_simulator_that_is_another_each_time(tmp_path: Path, line: str) -> None:
    text = "MEMORY = []\n" + TANK.replace("    return np.array([u[0]", f"    {line}\n    return np.array([u[0]")
    assert "rhs(x, u, theta) returns other numbers for the same arguments" in refused(write(tmp_path, text))


def test_what_is_drawn_once_for_all_is_allowed(tmp_path: Path) -> None:
    text = "import numpy\nSHIFT = numpy.random.default_rng(1).random()\n" + TANK.replace("u[0] -", "u[0] + SHIFT -")
    assert load_simulator(write(tmp_path, text)).name == "tank"


def test_functions_may_fail_away_from_the_nominal_state(tmp_path: Path) -> None:
    text = "import math\n" + TANK.replace("u[0] - theta", "1.0 / x[0] + u[0] - theta")
    assert load_simulator(write(tmp_path, text)).name == "tank"


def test_a_file_prints_once(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    load_simulator(write(tmp_path, "print('hello')\n" + TANK))
    out, err = capfd.readouterr()
    assert (out, err) == ("", "hello\n")


def test_a_process_that_may_start_no_other_tries_in_a_thread(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def no_fork() -> int:
        raise PermissionError("the engine's process may start no other")

    monkeypatch.setattr(os, "fork", no_fork, raising=False)
    assert load_simulator(write(tmp_path, TANK)).name == "tank"
    assert "returns nothing" in refused(write(tmp_path, TANK.replace("return np.array([x[1]])", "pass")))


def test_no_child_is_left(tmp_path: Path) -> None:
    """In a process of its own: this one may have children of other tests."""
    asked = (
        "import os, sys\n"
        "from twinbench.physics.load import load_simulator\n"
        "load_simulator(sys.argv[1])\n"
        "try:\n    os.waitpid(-1, os.WNOHANG)\nexcept ChildProcessError:\n    print('none')"
    )
    command = [sys.executable, "-c", asked, write(tmp_path, TANK)]
    assert subprocess.run(command, capture_output=True, text=True, check=True).stdout == "none\n"


def test_where_no_process_may_be_started_a_thread_tries(tmp_path, monkeypatch):
    """As in the process of the concealed-effect suite's engine, which has given up that right."""

    def forbidden() -> int:
        raise PermissionError("may start no other")

    monkeypatch.setattr(os, "fork", forbidden)
    monkeypatch.setattr(trial, "CALL_S", 5.0)
    tried: list[str] = []
    trial.tried(lambda: tried.append("here"), "a file")
    assert tried == ["here"]
    with pytest.raises(ValueError, match="no good"):
        trial.tried(lambda: exec("raise ValueError('no good')"), "a file")
