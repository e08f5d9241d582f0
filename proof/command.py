"""What the commands of this folder have in common: bad input is one line on stderr, and status 2."""

from __future__ import annotations

import functools
import sys
from collections.abc import Callable, Sequence
from typing import Protocol

from twinbench.common.errors import BadInput


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
