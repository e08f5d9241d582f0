"""What work will cost, told before it starts, by what its like took in an earlier run."""

from __future__ import annotations

from collections.abc import Hashable, Mapping, Sequence
from pathlib import Path

import pandas as pd

Rates = Mapping[Path, Mapping[Hashable, float]]
"""By table and kind of work, the seconds that a piece took on average."""


def foretold(what: str, todo: Sequence[Hashable], rates: Rates) -> str:
    """One line: what is to be done, and about how many minutes that takes one core.

    Args:
        what: a piece of work is called.
        todo: the kind of each piece of work.
        rates: the first table that knows a kind is asked.
    """
    took_s, unknown = dict[Path, float](), 0
    for kind in todo:
        by = next((file for file in rates if kind in rates[file]), None)
        if by is None:
            unknown += 1
        else:
            took_s[by] = took_s.get(by, 0.0) + rates[by][kind]
    line = f"to do: {len(todo)} {what}{'' if len(todo) == 1 else 's'}"
    if took_s or not unknown:
        return line + (in_words(took_s, unknown) if took_s else "")
    return f"{line}; the cost is not known: nothing of the kind is in {' or '.join(map(str, rates))}"


def in_words(took_s: Mapping[Path, float], unknown: int) -> str:
    """The end of such a line: by table, the seconds of what it knows, and how many pieces of work none knows."""
    minutes = sum(took_s.values()) / 60.0
    about = f"about {minutes:,.0f} core-minutes" if minutes >= 1.5 else "about a core-minute at most"
    by = " and ".join(map(str, took_s))
    return f", {about} by {by}" + (f"; the cost of {unknown} is not known" if unknown else "")


def rates_of(files: Sequence[Path], columns: Sequence[str]) -> Rates:
    """What pieces of work took, by the tables of earlier runs; their column ``seconds`` says it.

    Args:
        files: tables; one that is not there, or is damaged, knows nothing.
        columns: pieces of work that agree in these are of one kind, which is the tuple of their values.
    """
    return {file: _seconds(file, columns) for file in dict.fromkeys(files)}


def _seconds(file: Path, columns: Sequence[str]) -> dict[Hashable, float]:
    try:
        table = pd.read_csv(file, dtype=dict.fromkeys(columns, str)).dropna(subset="seconds")
        seconds = pd.to_numeric(table["seconds"]).to_numpy()
        kinds = [tuple(row) for row in table[list(columns)].to_numpy()]
    except (OSError, LookupError, TypeError, ValueError):
        return {}
    return {kind: float(seconds[[k == kind for k in kinds]].mean()) for kind in set(kinds)}
