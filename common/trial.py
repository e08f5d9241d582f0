"""What a user wrote, tried under a clock: an endless loop in it is one line, not a command that stands still.

On Linux the trial runs in a forked process, which can be ended whatever it does, in compiled code too. Elsewhere it
runs in a thread: that catches loops of plain Python, and leaves the thread behind.
"""

from __future__ import annotations

import contextlib
import faulthandler
import multiprocessing
import os
import signal
import sys
import threading
import time
import warnings
from collections.abc import Callable
from multiprocessing.connection import Connection
from typing import NoReturn

CALL_S = 15.0
"""Seconds of computing that a file's import, or one call of a function in it, may take, compiling of what it calls
included. A call of a simulator takes microseconds, and fits make a million; importing torch takes some five seconds."""
IDLE_S = 10.0
"""Seconds on the clock after which what computes next to nothing is given up: it waits for what never comes."""
_IDLE_SHARE = 0.005  # of a processor; a process that has to share a busy one gets more
_PATIENCE_S = 60.0  # on the clock, for machines so busy that neither of the two has ended it

_here = threading.local()  # its ``tell`` is who listens to a trial in this thread


def about_to(what: str) -> None:
    """Told before each thing that a user wrote is run, so that a trial knows which one does not end."""
    if tell := getattr(_here, "tell", None):
        tell(what)


def tried(work: Callable[[], object], where: str) -> None:
    """Do the work, which tells ``about_to`` what it does, for its ``ValueError`` alone: what it changes may be lost.

    Args:
        where: the file that it runs, for the message.

    Raises:
        ValueError: one line; the work's own, or a part of it does not end, or ends Python.
    """
    (_in_child if sys.platform == "linux" else _in_thread)(work, where)


def _in_child(work: Callable[[], object], where: str) -> None:
    receive, send = multiprocessing.Pipe(duplex=False)
    with warnings.catch_warnings():
        # Python warns of forks beside threads, whose locks may be held for ever; the clock sees to that, too.
        warnings.simplefilter("ignore", DeprecationWarning)
        try:
            child = os.fork()
        except OSError:  # where no process may be started, as in a sandbox, a thread must do
            receive.close()
            send.close()
            return _in_thread(work, where)
    if child == 0:
        _be_the_child(work, where, send)
    send.close()
    doing, refused, late = "loading it", "", False
    try:
        while not (late := not receive.poll(_PATIENCE_S)):
            kind, text = receive.recv()
            doing, refused = (text, refused) if kind == "doing" else (doing, text)
    except EOFError:
        pass  # the child has ended
    finally:
        with contextlib.suppress(ProcessLookupError):
            os.kill(child, signal.SIGKILL)
        ended = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
        receive.close()
    if refused:
        raise ValueError(refused)
    if late or ended == -_OUT_OF_TIME:
        raise _endless(where, doing)
    if ended == _IDLE:
        raise _idle(where, doing)
    if ended != _DONE:
        how = f"signal {-ended}" if ended < 0 else f"exit status {ended}"
        raise ValueError(f"{where}: {doing} ends Python itself ({how}); mend it there")


_DONE, _IDLE = 71, 72  # exit statuses that nothing else has
_OUT_OF_TIME = signal.SIGPROF if sys.platform == "linux" else 0


def _be_the_child(work: Callable[[], object], where: str, send: Connection) -> NoReturn:
    status, doing = 1, "loading it"
    try:
        nowhere = open(os.devnull, "r+")  # what a file prints, it prints when it is loaded in earnest
        for stream in (0, 1, 2):
            os.dup2(nowhere.fileno(), stream)
        sys.stdout = sys.stderr = nowhere
        faulthandler.disable()
        for number in (_OUT_OF_TIME, signal.SIGINT, signal.SIGTERM):
            signal.signal(number, signal.SIG_DFL)

        computed_s = 0.0

        def look(number: int, frame: object) -> None:
            nonlocal computed_s
            before_s, computed_s = computed_s, time.process_time()
            if computed_s - before_s < _IDLE_SHARE * IDLE_S:
                os._exit(_IDLE)

        def tell(what: str) -> None:
            nonlocal computed_s, doing
            doing = what
            send.send(("doing", what))
            computed_s = time.process_time()
            # Both end this process even if its parent is gone; the first whatever it does.
            signal.setitimer(signal.ITIMER_PROF, CALL_S)
            signal.setitimer(signal.ITIMER_REAL, IDLE_S, IDLE_S)

        signal.signal(signal.SIGALRM, look)
        _here.tell = tell
        work()
        status = _DONE
    except BaseException as error:
        send.send(("refused", _said(error, where, doing)))
    finally:
        os._exit(status)


def _in_thread(work: Callable[[], object], where: str) -> None:
    doing, since_s, errors = ["loading it"], [time.monotonic()], []

    def tell(what: str) -> None:
        doing[0], since_s[0] = what, time.monotonic()

    def run() -> None:
        _here.tell = tell
        try:
            work()
        except BaseException as error:
            errors.append(error)

    thread = threading.Thread(target=run, daemon=True)
    thread.start()
    while thread.is_alive():
        thread.join(0.05)
        if time.monotonic() - since_s[0] > CALL_S:
            raise _endless(where, doing[0])
    if errors:
        raise ValueError(_said(errors[0], where, doing[0])) from errors[0]


def _said(error: BaseException, where: str, doing: str) -> str:
    """A refusal's own words; of anything else its kind, and where it came from."""
    text = (str(error).splitlines() or [""])[0]
    if isinstance(error, ValueError):
        return text
    return f"{where}: {doing} raises {type(error).__name__}{': ' * bool(text)}{text}; mend it there"


def _endless(where: str, doing: str) -> ValueError:
    return ValueError(f"{where}: {doing} has not ended after {CALL_S:g} s of computing; mend the loop in it")


def _idle(where: str, doing: str) -> ValueError:
    return ValueError(f"{where}: {doing} has not ended after {IDLE_S:g} s and computes nothing; it must not wait")
