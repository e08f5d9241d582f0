"""A recording's clock: seconds as numbers, or dates as ISO 8601 writes them, and what no clock shows."""

from __future__ import annotations

import re
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from twinbench.common.errors import BadInput
from twinbench.common.shown import as_map, bare, shown
from twinbench.data.formats.holdings import TIME, Holdings, Zero
from twinbench.data.formats.united import NANOSECONDS
from twinbench.data.mapping import TIME_UNIT, Source
from twinbench.data.table import numbers, one_column, row
from twinbench.data.units import convert
from twinbench.machines.coordinates import Array

if TYPE_CHECKING:
    import pandas as pd

LONGEST_GAP = 10.0
"""Times of what was recorded that a gap may last: whatever runs over a recording runs over its gaps, too."""
SHORT_GAP = 10_000
"""Samples that a gap may always last, however short the recording: eight minutes at 20 Hz."""
FIRST_EPOCH_S, LAST_EPOCH_S = 5e8, 5e9
"""Seconds since 1970 that a clock of our time shows: 1985 to 2128."""
A_THOUSAND = 500.0
"""Ratio of sample periods that is a mistake in the unit of time, between s and ms or ms and us."""
PARTS_OF_A_SECOND = {"ms": 1e3, "us": 1e6, "ns": 1e9}
LONGEST_FOLD_S = 3600.0
"""By which clocks are set back in autumn."""
_ISO = re.compile(r"\d{4}-\d\d-\d\d")
_ZONE = r"[T ]\d.*(?:Z|[+-]\d\d(?::?\d\d)?)$"
"""The end of a date that says how far its clock is from UTC."""


class Stamps(NamedTuple):
    """The times of a file's rows.

    Attributes:
        time_s: (N,) seconds, increasing.
        zero: when that is 0; None where nobody says.
    """

    time_s: Array
    zero: Zero | None


def stamps(held: Holdings, clock: Source, path: Path, zone: str | None = None) -> Stamps:
    """The time of each row; it increases. Dates count from the first one.

    Args:
        clock: the column, and its unit where it holds numbers.
        zone: of dates that name none; None: they are taken as they are, as if no clock were ever set.

    Raises:
        BadInput: no such column, a time that is missing, is none or does not increase, or fewer than two.
    """
    if clock.column not in held.table.columns:
        raise BadInput(
            f"{path}: has no column {shown(clock.column)}; add the time in seconds, or name it with --map COLUMN={TIME}"
        )
    cells = one_column(held.table, clock.column, path)
    if len(cells) < 2:
        raise BadInput(f"{path}: holds {len(cells)} samples; a recording needs at least two")
    if cells.isna().any():
        raise BadInput(f"{path}, row {row(cells.isna().to_numpy())}: {TIME} is missing; every row needs its time")
    if _are_dates(cells):
        return _dates(cells, f"{path}, column {bare(clock.column)}", path, zone)
    where = f"{path}, column {bare(clock.column)}"
    time_s = convert(numbers(held.table, clock.column, path), clock.unit, TIME_UNIT, where)
    if (back := np.diff(time_s) <= 0).any():
        raise BadInput(f"{path}, row {row(back) + 1}: {TIME} does not increase; sort the rows by time")
    return Stamps(time_s, held.zero if clock.column == TIME else None)


def usual_period(time_s: Array, channels: Iterable[Array]) -> float:
    """Seconds between two readings of the channel that is read most often; rows may be closer where channels alternate.

    Args:
        time_s: (N,) seconds, increasing.
        channels: (N,) each, in any unit; NaN means missing.
    """
    read = [time_s[~np.isnan(values)] for values in channels]
    periods = [float(np.median(np.diff(own_s))) for own_s in read if len(own_s) > 1]
    return min(periods, default=float(np.median(np.diff(time_s))))


def check_clock(time_s: Array, usual_s: float, path: Path, column: str, longest_s: float, period_s: float) -> None:
    """Refuse a clock whose unit is not what it is taken for, or that a gap or a stray stamp makes endless.

    Args:
        time_s: (N,) seconds, increasing.
        usual_s: between two readings.
        column: what the file calls the time.
        longest_s: the longest time span that is no mistake in the unit of time.
        period_s: how far apart samples usually are; infinite where that may be anything.

    Raises:
        BadInput: it is.
    """
    for unit, parts in PARTS_OF_A_SECOND.items():
        if FIRST_EPOCH_S <= time_s[0] / parts <= LAST_EPOCH_S:
            raise BadInput(
                f"{path}: {TIME} begins at {time_s[0]:.4g} s, which looks like {unit} since 1970; "
                f"say so with {as_map(column, unit, TIME)}"
            )
    steps_s = np.diff(time_s)
    k = int(np.argmax(steps_s))
    for unit, parts in PARTS_OF_A_SECOND.items():
        if A_THOUSAND < usual_s / period_s * 1e3 / parts <= A_THOUSAND * 1e3:
            raise BadInput(
                f"{path}: its samples are {usual_s:.4g} s apart, usual are {period_s:g} s; that looks like {unit}: "
                f"say so with {as_map(column, unit, TIME)}, or record faster"
            )
    if steps_s[k] > max(LONGEST_GAP * len(time_s), SHORT_GAP) * usual_s:
        raise BadInput(
            f"{path}, row {k + 3}: {steps_s[k]:.4g} s have passed since the row before, usual are {usual_s:.4g} s; "
            "split the recording there, or mend the stamp"
        )
    if time_s[-1] - time_s[0] > longest_s:
        raise BadInput(
            f"{path}: {TIME} spans {time_s[-1] - time_s[0]:.3g} s, at most {longest_s:.3g} s can be read; "
            f"is it in ms? Say so with {as_map(column, 'ms', TIME)}, or split the recording"
        )


def _are_dates(cells: pd.Series) -> bool:
    """Times of a calendar, or text of which the first says that it is one."""
    import pandas as pd

    if pd.api.types.is_datetime64_any_dtype(cells):
        return True
    text = cells.dtype == object or pd.api.types.is_string_dtype(cells)
    return bool(text) and _ISO.match(str(cells.iloc[0]).strip()) is not None


def _dates(cells: pd.Series, where: str, path: Path, zone: str | None) -> Stamps:
    """Dates as seconds since the first."""
    import pandas as pd

    if pd.api.types.is_datetime64_any_dtype(cells):
        utc = getattr(cells.dt, "tz", None) is not None
        dates = cells.dt.tz_convert("UTC") if utc else cells
    else:
        text = cells.astype(str).str.strip()
        zoned = text.str.contains(_ZONE).to_numpy()
        utc = bool(zoned.all())
        if zoned.any() and not utc:
            raise BadInput(
                f"{path}, row {row(zoned != zoned[0])}: some dates name a zone and some do not; give all one"
            )
        dates = _parsed(text, utc, path, where)
    if zone is not None and not utc:
        dates, utc = _localized(dates, zone, where), True
    try:
        ns = dates.dt.tz_localize(None).dt.as_unit("ns").to_numpy().astype("datetime64[ns]").astype(np.int64)
    except ValueError as error:  # nanoseconds go from 1678 to 2262
        raise BadInput(f"{where}: a date is too far from ours; mend it") from error
    steps_s = np.diff(ns) / NANOSECONDS
    if (steps_s <= 0.0).any():
        step_s = float(steps_s[np.argmax(steps_s <= 0.0)])
        autumn = "; was the clock set back? Write each date with its distance from UTC, or say time_zone beside it"
        hint = autumn if not utc and -LONGEST_FOLD_S <= step_s < 0.0 else "; sort the rows by time"
        raise BadInput(f"{path}, row {row(steps_s <= 0.0) + 1}: {TIME} does not increase{hint}")
    return Stamps((ns - ns[0]) / NANOSECONDS, Zero(int(ns[0]), utc))


def _parsed(text: pd.Series, utc: bool, path: Path, where: str) -> pd.Series:
    """Text as dates, those with a zone in UTC."""
    import pandas as pd

    try:
        dates = pd.to_datetime(text, format="ISO8601", utc=utc, errors="coerce")
    except (ValueError, OverflowError) as error:
        raise BadInput(f"{where}: a date is too far from ours; mend it") from error
    if (wrong := dates.isna().to_numpy()).any():
        odd = text.iloc[int(np.argmax(wrong))]
        raise BadInput(
            f"{path}, row {row(wrong)}: {TIME} {shown(odd)} is no date as ISO 8601 writes it; "
            "write 2026-03-01T12:00:00Z, or seconds since the start"
        )
    return dates.dt.tz_localize(None) if utc else dates


def _localized(dates: pd.Series, zone: str, where: str) -> pd.Series:
    """Dates on the clocks of a zone, in UTC; in autumn the order says which of two equal ones is meant."""
    try:
        return dates.dt.tz_localize(zone, ambiguous="infer", nonexistent="raise").dt.tz_convert("UTC")
    except ValueError as error:
        raise BadInput(
            f"{where}: clocks in {zone} do not show {shown(str(error).splitlines()[0])}; "
            "write each date with its distance from UTC"
        ) from error
