"""Channels that were sampled at times of their own, on one clock: the union of all times, and gaps between."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from twinbench.common.errors import BadInput
from twinbench.common.shown import bare
from twinbench.data.formats import holdings
from twinbench.data.formats.holdings import TIME, too_large

if TYPE_CHECKING:
    import pandas as pd

NANOSECONDS = 1e9
"""In a second. Stamps of two channels that differ by less than a nanosecond are one: clocks are no finer, and the same
time reckoned in two ways differs in its last digit."""
_LAST_S = 9e9
"""Seconds from a clock's zero, 285 years: no file holds later ones, and in nanoseconds these still are whole numbers
of 63 bits."""


class Series(NamedTuple):
    """One channel of a file.

    Attributes:
        group: which part of the file it is in; tells two channels of one name apart.
        time_s: (N,) seconds from the clock's zero.
        values: (N,) as they are in the file.
        unit: as the file states it; empty where it states none.
    """

    group: str
    name: str
    time_s: np.ndarray
    values: Any
    unit: str = ""


def united(path: Path, series: Sequence[Series]) -> pd.DataFrame:
    """A table with the column ``time_s`` and one column per channel; a cell is empty where a channel has no sample.

    Raises:
        BadInput: no channel, one whose time does not increase, or too many cells.
    """
    import pandas as pd

    if not series:
        raise BadInput(f"{path}: holds no channel with numbers over time; record again or name another file")
    clocks: dict[int, np.ndarray] = {}  # by the array that holds it: channels of one group share one
    for each in series:
        if id(each.time_s) not in clocks:
            clocks[id(each.time_s)] = _nanoseconds(path, each)
    every = np.unique(np.concatenate(list(clocks.values())))
    if len(every) * (len(series) + 1) > holdings.MOST_CELLS:
        raise too_large(path, len(every), len(series) + 1)
    places = {key: np.searchsorted(every, clock) for key, clock in clocks.items()}
    time_s = np.empty(len(every))
    columns = []
    for each in reversed(series):  # so that of equal stamps the first channel's own stays
        place = places[id(each.time_s)]
        time_s[place] = each.time_s
        columns.append(_spread(each.values, place, len(every)))
    table = pd.DataFrame(dict(enumerate([time_s, *reversed(columns)])))
    table.columns = pd.Index([TIME, *told_apart(series)])
    return table


def told_apart(series: Sequence[Series]) -> list[str]:
    """The channels' names; where several have one, each with its group before it."""
    several = {name for name, n in Counter(each.name for each in series).items() if n > 1}
    return [f"{each.group}/{each.name}" if each.name in several else each.name for each in series]


def stated(series: Sequence[Series]) -> dict[str, str]:
    """The units that a file states, by the channels' names in the table."""
    return {n: each.unit.strip() for n, each in zip(told_apart(series), series, strict=True) if each.unit.strip()}


def _nanoseconds(path: Path, series: Series) -> np.ndarray:
    """Whole nanoseconds (N,) of a channel's stamps."""
    time_s = series.time_s
    wrong = ~(np.abs(time_s) < _LAST_S)
    if wrong.any():
        k = int(np.argmax(wrong))
        raise BadInput(
            f"{path}, channel {bare(series.name)}: the time of sample {k + 1} is {time_s[k]:.3g} s; "
            "it is damaged, export it again"
        )
    whole = np.round(time_s * NANOSECONDS).astype(np.int64)
    if (back := np.diff(whole) <= 0).any():
        raise BadInput(
            f"{path}, channel {bare(series.name)}: its time does not increase at sample "
            f"{int(np.argmax(back)) + 2}; sort it by time, or split the recording where the clock was set back"
        )
    return whole


def _spread(values: np.ndarray, place: np.ndarray, rows: int) -> np.ndarray:
    """The values in their rows; NaN elsewhere. Where they fill all rows they stay as they are."""
    if len(values) == rows:
        return values
    out = np.full(rows, np.nan)
    out[place] = values
    return out
