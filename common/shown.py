"""Text that others wrote, as it may be shown: short, on one line, and without anything that a terminal obeys."""

from __future__ import annotations

import shlex

LONGEST_SHOWN = 60
"""Characters of a name or a cell that a message shows; longer ones are cut."""
LONGEST_MESSAGE = 2000
"""Characters of a whole message: it may list names, and a file may have thousands."""


def shown(text: object) -> str:
    """A name or a cell in quotation marks, cut, with control characters escaped."""
    whole = str(text)
    return repr(whole) if len(whole) <= LONGEST_SHOWN else f"{whole[:LONGEST_SHOWN]!r}..."


def printable(line: str) -> str:
    """A message with every character that a terminal would obey, or that breaks the line, escaped; cut if very long."""
    cut = line if len(line) <= LONGEST_MESSAGE else line[:LONGEST_MESSAGE] + "..."
    return "".join(c if c.isprintable() else repr(c)[1:-1] for c in cut)


def as_map(column: str, unit: str, channel: str) -> str:
    """The ``--map`` that says so, as the shell takes it: quoted, and joined by ``=`` where a dash leads."""
    between = "=" if column.startswith("-") else " "
    return f"--map{between}{shlex.quote(f'{column}[{unit}]={channel}')}"


def bare(text: object) -> str:
    """As ``shown``, but for the quotation marks."""
    whole = str(text)
    return printable(whole if len(whole) <= LONGEST_SHOWN else whole[:LONGEST_SHOWN] + "...")
