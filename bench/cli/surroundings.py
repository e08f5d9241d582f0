"""What holds for every command: logging, the number of jobs, where output goes, what SIGTERM does."""

from __future__ import annotations

import argparse
import contextlib
import logging
import signal
import sys
import time
from collections.abc import Iterator
from typing import NoReturn

log = logging.getLogger(__name__)


class Terminated(BaseException):
    """SIGTERM came."""


@contextlib.contextmanager
def surroundings(a: argparse.Namespace) -> Iterator[None]:
    """Set them up for a command and take them down after it."""
    from twinbench.common.cluster import working_on
    from twinbench.common.jobs import at_most

    a.stdout = sys.stdout
    with contextlib.ExitStack() as stack:
        if getattr(a, "json", False):
            # What a plug-in prints must not stand between what a program reads.
            stack.enter_context(contextlib.redirect_stdout(sys.stderr))
        jobs = getattr(a, "jobs", None)
        stack.enter_context(at_most(jobs))
        stack.enter_context(_logging(a.verbose))
        stack.enter_context(_sigterm())
        if hasattr(a, "backend"):
            stack.enter_context(working_on(a.backend, a.scheduler, jobs))
        begun = time.monotonic()
        log.info("twinbench %s begins", a.command)
        yield
        log.info("twinbench %s ends after %.1f s", a.command, time.monotonic() - begun)


@contextlib.contextmanager
def _logging(verbose: int) -> Iterator[None]:
    """With --verbose: what this package does, with times, on stderr; twice: details as well."""
    if not verbose:
        yield
        return
    handler = logging.StreamHandler(sys.stderr)
    handler.setFormatter(logging.Formatter("%(asctime)s %(name)s: %(message)s"))
    ours = logging.getLogger("twinbench")
    before = ours.level
    ours.addHandler(handler)
    ours.setLevel(logging.DEBUG if verbose > 1 else logging.INFO)
    try:
        yield
    finally:
        ours.removeHandler(handler)
        ours.setLevel(before)


@contextlib.contextmanager
def _sigterm() -> Iterator[None]:
    """SIGTERM unwinds this process as Ctrl-C does, where it is the main thread's to decide."""

    def stop(*_: object) -> NoReturn:
        raise Terminated

    try:
        before = signal.signal(signal.SIGTERM, stop)
    except ValueError:  # a program runs the command in another thread
        yield
        return
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)
