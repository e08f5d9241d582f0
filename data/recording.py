"""Recordings of a machine: CSV or Parquet in, checked and in our units; CSV or Parquet out.

Columns are ``time_s`` and one per channel. NaN and empty cells mean missing; time stamps may be
uneven. A TOML file beside the recording, or ``--map PT101[psi]=p_dis_bar``, renames and converts
channels and the time (``--map stamp[ms]=time_s``).
Columns named ``true_*`` exist in simulated data only and never get past this door.
"""

from __future__ import annotations

import tomllib
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from data.batch import CHANNELS, ESTIMATED, OUTPUTS, SAMPLE_PERIOD_S, Array, Batch
from data.errors import BadInput
from data.units import PLAUSIBLE, UNITS, Limits, check_plausible, convert

if TYPE_CHECKING:
    import pandas as pd

TIME = "time_s"
TIME_UNIT = "second"
LONGEST_S = 14 * 86400.0
KINDS = (".csv", ".csv.gz", ".parquet")
TRUTH_PREFIX = "true_"


@dataclass(frozen=True)
class Source:
    """Where a channel comes from: a column of the file, and its unit there."""

    column: str
    unit: str


@dataclass(frozen=True)
class Recording:
    """One recording. ``values`` (N, C) in our units, NaN where missing; ``time_s`` (N,) as recorded.

    ``unread`` are columns of the file that no channel came from.
    """

    name: str
    time_s: Array
    channels: tuple[str, ...]
    values: Array
    unread: tuple[str, ...] = ()

    def to_batch(self) -> Batch:
        """On the 20 Hz grid from the first time stamp: each channel's nearest reading, missing if half a period off."""
        ticks = (self.time_s - self.time_s[0]) / SAMPLE_PERIOD_S
        steps = np.round(ticks).astype(int)
        nearest_last = np.argsort(-np.abs(ticks - steps), kind="stable")  # of several in one slot the last stays
        measured = np.full((1, steps[-1] + 1, len(self.channels)), np.nan)
        for c, values in enumerate(self.values.T):  # each by itself: channels may report at different times
            found = nearest_last[~np.isnan(values[nearest_last])]
            measured[0, steps[found], c] = values[found]
        time_s = self.time_s[0] + np.arange(measured.shape[1]) * SAMPLE_PERIOD_S
        return Batch((self.name,), time_s, measured)


def read_recording(
    path: Path,
    mapping: Sequence[str] = (),
    units: Mapping[str, str] = UNITS,
    must_vary: Sequence[str] = (),
    limits: Mapping[str, Limits] = PLAUSIBLE,
    may_lack: Sequence[str] = (),
    longest_s: float = LONGEST_S,
) -> Recording:
    """Read a recording and check it.

    Args:
        path: ``.csv``, ``.csv.gz`` or ``.parquet``.
        mapping: ``COLUMN=channel`` or ``COLUMN[unit]=channel``, each over a TOML sidecar's.
        units: the channels to read and their units; the compressor's by default.
        must_vary: channels that must not be constant, because something is learnt from them.
        limits: where a channel's median has to lie; outside it is taken for another unit.
        may_lack: channels that are missing throughout where the file has no column for them.
        longest_s: the longest time span that is no mistake in the unit of time.

    Raises:
        BadInput: one line that says what is wrong, where, and how to mend it.
    """
    table = _read_table(path)
    sources = _sources(path, mapping, units)
    clock = sources.get(TIME, Source(TIME, TIME_UNIT))
    if clock.column not in table.columns:
        raise BadInput(
            f"{path}: has no column {clock.column!r}; add the time in seconds, or name it with --map COLUMN={TIME}"
        )
    time_s = _channel(table, clock, TIME_UNIT, path)
    if len(time_s) < 2:
        raise BadInput(f"{path}: holds {len(time_s)} samples; a recording needs at least two")
    if np.isnan(time_s).any():
        raise BadInput(f"{path}, row {_row(np.isnan(time_s))}: {TIME} is missing; every row needs its time")
    if (np.diff(time_s) <= 0).any():
        raise BadInput(f"{path}, row {_row(np.diff(time_s) <= 0) + 1}: {TIME} does not increase; sort the rows by time")
    if time_s[-1] - time_s[0] > longest_s:
        raise BadInput(
            f"{path}: {TIME} spans {time_s[-1] - time_s[0]:.3g} s, at most {longest_s:.3g} s can be read; "
            f"is it in ms? Say so with --map '{clock.column}[ms]={TIME}', or split the recording"
        )
    columns = []
    for channel, unit in units.items():
        source = sources.get(channel, Source(channel, unit))
        if source.column not in table.columns and channel in may_lack and channel not in sources:
            columns.append(np.full(len(time_s), np.nan))
            continue
        if source.column not in table.columns:
            offered = ", ".join(c for c in table.columns if c != TIME)
            raise BadInput(
                f"{path}: no column {source.column!r} for channel {channel}; it has: {offered or 'none'}. "
                f"Name the right one with --map COLUMN={channel}"
            )
        values = _channel(table, source, unit, path)
        if channel in limits:
            check_plausible(
                values, limits[channel], unit, f"{path}, column {source.column}", source.column, channel
            )
        if channel in must_vary and len(np.unique(values[~np.isnan(values)])) < 2:
            raise BadInput(f"{path}: channel {channel} is constant; record the machine while its load changes")
        columns.append(values)
    read = {clock.column, *(sources.get(channel, Source(channel, "")).column for channel in units)}
    unread = tuple(c for c in table.columns if c not in read)
    return Recording(_stem(path), time_s, tuple(units), np.stack(columns, axis=-1), unread)


def _stem(path: Path) -> str:
    """The file's name without its kind; dots inside it stay."""
    return next(path.name.removesuffix(kind) for kind in KINDS if path.name.endswith(kind))


def _channel(table: pd.DataFrame, source: Source, unit: str, path: Path) -> Array:
    return convert(_numbers(table, source.column, path), source.unit, unit, f"{path}, column {source.column}")


def _read_table(path: Path) -> pd.DataFrame:
    import pandas as pd

    if not path.exists():
        raise BadInput(f"{path}: no such file; check the path")
    if not path.is_file():
        raise BadInput(f"{path}: is a folder; name the recording's file")
    if not path.name.endswith(KINDS):
        raise BadInput(f"{path}: unknown kind of file; a recording is {', '.join(KINDS)}")
    if path.stat().st_size == 0:
        raise BadInput(f"{path}: is empty; record again or name another file")
    try:
        if path.suffix == ".parquet":
            table = pd.read_parquet(path)
        else:
            table = pd.read_csv(path, low_memory=False)
    except pd.errors.EmptyDataError as error:
        raise BadInput(f"{path}: is empty; record again or name another file") from error
    except PermissionError as error:
        raise BadInput(f"{path}: cannot be read: {_first(error)}; check its permissions") from error
    except (OSError, EOFError, ValueError, zlib.error) as error:
        if path.suffix != ".csv":
            raise BadInput(f"{path}: cannot be read, it may be cut short ({_first(error)}); copy it again") from error
        raise BadInput(f"{path}: is no table: {_first(error)}; write it as CSV with one header line") from error
    if path.suffix != ".parquet" and any(";" in str(c) for c in table.columns):
        raise BadInput(f"{path}: separates its columns by semicolons; write commas, and points in numbers")
    if path.suffix != ".parquet" and not isinstance(table.index, pd.RangeIndex):
        raise BadInput(f"{path}: its rows have more cells than its header; name every column")
    table.columns = table.columns.map(str)
    if table.columns.has_duplicates:
        raise BadInput(f"{path}: column {table.columns[table.columns.duplicated()][0]!r} is there twice; rename one")
    table = table[[c for c in table.columns if not c.startswith(TRUTH_PREFIX)]]
    if table.empty:
        raise BadInput(f"{path}: has no rows; record again or name another file")
    return table


def _first(error: Exception) -> str:
    return (str(error).splitlines() or [type(error).__name__])[0]


def _row(wrong: np.ndarray) -> int:
    """Line of the file, the header being line 1."""
    return int(np.flatnonzero(wrong)[0]) + 2


def _numbers(table: pd.DataFrame, column: str, path: Path) -> Array:
    import pandas as pd

    cells = table[column]
    if not (pd.api.types.is_numeric_dtype(cells) or cells.dtype == object or pd.api.types.is_string_dtype(cells)):
        raise BadInput(f"{path}, column {column}: holds {cells.dtype}, not numbers; write numbers, time in seconds")
    values = pd.to_numeric(cells, errors="coerce").to_numpy(dtype=float)
    wrong = (np.isnan(values) & cells.notna().to_numpy()) | np.isinf(values)
    if wrong.any():
        text = str(cells.iloc[int(np.flatnonzero(wrong)[0])])
        raise BadInput(
            f"{path}, row {_row(wrong)}, column {column}: {text!r} is no number; leave the cell empty if missing"
        )
    return values


def _sources(path: Path, mapping: Sequence[str], units: Mapping[str, str]) -> dict[str, Source]:
    """channel -> where it comes from, from the sidecar and the command line."""
    found: dict[str, Source] = {}
    units = {**units, TIME: TIME_UNIT}
    sidecar = path.with_name(_stem(path) + ".toml")
    if sidecar.is_file():
        try:
            content = tomllib.loads(sidecar.read_text())
        except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
            raise BadInput(f"{sidecar}: not TOML: {error}; mend it or remove it") from error
        channels = content.pop("channels", {})
        if content or not isinstance(channels, dict):
            raise BadInput(f"{sidecar}: must hold one table, [channels], and nothing else; move the rest elsewhere")
        for channel, entry in channels.items():
            _known(channel, units, str(sidecar))
            if isinstance(entry, str):
                entry = {"column": entry}
            source = {"column": channel, "unit": units[channel]} | (entry if isinstance(entry, dict) else {"?": entry})
            if len(source) > 2 or not all(isinstance(v, str) for v in source.values()):
                raise BadInput(f"{sidecar}: channel {channel} must be a column's name, or hold column and unit only")
            found[channel] = Source(**source)
    for item in mapping:
        column, equals, channel = item.rpartition("=")
        if not equals or not column or not channel:
            raise BadInput(
                f"--map {item!r}: must read COLUMN=channel or COLUMN[unit]=channel, like PT101[psi]=p_dis_bar"
            )
        _known(channel, units, f"--map {item!r}")
        name, bracket, unit = column.partition("[")
        found[channel] = Source(name, unit.rstrip("]") if bracket else units[channel])
    return found


def _known(channel: str, units: Mapping[str, str], where: str) -> None:
    if channel not in units:
        raise BadInput(f"{where}: unknown channel {channel!r}; choose from {', '.join(units)}")


def check_overlap(recordings: Sequence[Recording]) -> None:
    """Refuse recordings that share no channel that was ever measured.

    Raises:
        BadInput: names the two that have nothing in common.
    """
    measured = [
        {c for c, v in zip(r.channels, r.values.T, strict=True) if not np.isnan(v).all()} for r in recordings
    ]
    for recording, channels in zip(recordings[1:], measured[1:], strict=True):
        if not channels & measured[0]:
            raise BadInput(
                f"recordings {recordings[0].name} and {recording.name} share no measured channel; "
                "estimate them one by one"
            )


def truth_table(batch: Batch, b: int) -> pd.DataFrame:
    """A simulated sequence as a table: time, channels, and ``true_*`` columns where it has truth."""
    import pandas as pd

    columns: dict[str, Array] = {TIME: batch.time_s}
    columns |= dict(zip(CHANNELS, batch.measured[b].T, strict=True))
    if batch.truth is not None:
        columns |= {TRUTH_PREFIX + n: v for n, v in zip(ESTIMATED, batch.truth.estimated[b].T, strict=True)}
        columns |= {TRUTH_PREFIX + n: v for n, v in zip(OUTPUTS, batch.truth.outputs[b].T, strict=True)}
    return pd.DataFrame(columns)
