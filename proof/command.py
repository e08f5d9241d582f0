"""What the commands of this folder have in common: how they refuse bad input, and do many things with a bar."""

from __future__ import annotations

import functools
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Protocol

from rich.console import Console

from twinbench.common.errors import BadInput
from twinbench.common.progress import Progress
from twinbench.common.workers import Several, side_by_side


class Main(Protocol):
    """A command: the exit status."""

    def __call__(self, arguments: Sequence[str] | None = None) -> int: ...


def refusing(name: str) -> Callable[[Main], Main]:
    """A command that tells bad input in one line, which begins with its name."""

    def of(main: Main) -> Main:
        @functools.wraps(main)
        def command(arguments: Sequence[str] | None = None) -> int:
            try:
                return main(arguments)
            except BadInput as error:
                print(f"{name}: {error}", file=sys.stderr)
                return 2

        return command

    return of


def each(stage: str, work: Callable[..., Any], several: Several, out: Path, jobs: int) -> None:
    """``work(*arguments)`` for each of several items, side by side, with a bar on stderr.

    Args:
        stage: what the bar counts.
        out: where the results go.
        jobs: processes; 0: as many as there are cores.
    """
    with Progress(Console(stderr=True)) as progress, progress.stage(stage, len(several)) as going:
        for _ in side_by_side(work, several, progress.say, out, jobs):
            going.step()
