"""Recordings of a machine: CSV or Parquet in, checked and in our units; CSV or Parquet out.

Columns are ``time_s`` and one per channel. NaN and empty cells mean missing; time stamps may be
uneven. A TOML file beside the recording, or ``--map PT101[psi]=p_dis_bar``, renames and converts
channels and the time (``--map stamp[ms]=time_s``).
Columns named ``true_*`` exist in simulated data only and never get past this door.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from twinbench.common.documents import read_file
from twinbench.common.errors import BadInput
from twinbench.common.shown import as_map, bare, shown
from twinbench.data.batch import Batch
from twinbench.data.mapping import TIME, TIME_UNIT, Source, sources
from twinbench.data.table import LARGEST_READING, TRUTH_PREFIX, numbers, read_table, row, stem
from twinbench.data.units import Limits, check_plausible, convert, limits_of, units_of
from twinbench.machines.compressor import COMPRESSOR
from twinbench.machines.coordinates import Array
from twinbench.machines.machine import Machine

if TYPE_CHECKING:
    import pandas as pd

__all__ = ["TIME", "Recording", "check_overlap", "files_of", "read_recording", "truth_table"]

LONGEST_RUN_S = 14 * 86400.0
LONGEST_GAP = 10.0
"""Times of what was recorded that a gap may last: whatever runs over a recording runs over its gaps, too."""
SHORT_GAP = 10_000
"""Samples that a gap may always last, however short the recording: eight minutes at 20 Hz."""
FIRST_EPOCH_S, LAST_EPOCH_S = 5e8, 5e9
"""Seconds since 1970 that a clock of our time shows: 1985 to 2128."""
A_THOUSAND = 500.0
"""Ratio of sample periods that is a mistake in the unit of time, between s and ms or ms and us."""
PARTS_OF_A_SECOND = {"ms": 1e3, "us": 1e6, "ns": 1e9}
LONGEST_NAME_BYTES = 150
"""Bytes of a recording's name; files are named after it, with endings, and may have 255."""
_DEVICES = re.compile(r"(con|prn|aux|nul|com\d|lpt\d)(\..*)?", re.IGNORECASE)
"""Names that Windows keeps for devices, whatever their ending."""


@dataclass(frozen=True)
class Recording:
    """One recording, its channels in our units.

    Attributes:
        name: after which results are named.
        time_s: (N,) seconds, increasing, as recorded.
        channels: C names.
        values: (N, C), each channel in its unit; NaN where missing.
        unread: columns of the file that no channel came from.
    """

    name: str
    time_s: Array
    channels: tuple[str, ...]
    values: Array
    unread: tuple[str, ...] = ()

    def to_batch(self, machine: Machine = COMPRESSOR) -> Batch:
        """On the machine's grid from the first time stamp: each channel's nearest reading, if within half a period.

        Args:
            machine: of which it is a recording, with the same channels.

        Returns:
            A batch of one, ``measured`` (1, N, C) in the channels' units.
        """
        ticks = (self.time_s - self.time_s[0]) / machine.sample_period_s
        steps = np.round(ticks).astype(int)
        nearest_last = np.argsort(-np.abs(ticks - steps), kind="stable")  # of several in one slot the last stays
        measured = np.full((1, steps[-1] + 1, len(self.channels)), np.nan)
        for c, values in enumerate(self.values.T):  # each by itself: channels may report at different times
            found = nearest_last[~np.isnan(values[nearest_last])]
            measured[0, steps[found], c] = values[found]
        time_s = self.time_s[0] + np.arange(measured.shape[1]) * machine.sample_period_s
        return Batch((self.name,), time_s, measured, machine=machine)


def read_recording(
    path: Path,
    mapping: Sequence[str] = (),
    units: Mapping[str, str] = units_of(COMPRESSOR),
    limits: Mapping[str, Limits] = limits_of(COMPRESSOR),
    may_lack: Sequence[str] = (),
    longest_s: float = LONGEST_RUN_S,
    period_s: float = COMPRESSOR.sample_period_s,
) -> Recording:
    """Read a recording and check it.

    Args:
        path: ``.csv``, ``.csv.gz`` or ``.parquet``.
        mapping: ``COLUMN=channel`` or ``COLUMN[unit]=channel``, each over a TOML sidecar's.
        units: the channels to read and their units; the compressor's by default.
        limits: where a channel's median has to lie; outside it is taken for another unit.
        may_lack: channels that are missing throughout where the file has no column for them.
        longest_s: the longest time span that is no mistake in the unit of time.
        period_s: how far apart samples usually are, to tell such a mistake; infinite where that may be anything.

    Raises:
        BadInput: one line that says what is wrong, where, and how to mend it.
    """
    table = read_table(path)
    name = _name(path)
    found = sources(path, _sidecar(path), list(table.columns), mapping, units)
    time_s = _clock(table, found[TIME], path, longest_s, period_s)
    columns = []
    for channel, unit in units.items():
        source = found[channel]
        if source.column not in table.columns and channel in may_lack and source == Source(channel, unit):
            columns.append(np.full(len(time_s), np.nan))
            continue
        if source.column not in table.columns:
            offered = ", ".join(bare(c) for c in table.columns if c and c != TIME)
            raise BadInput(
                f"{path}: no column {shown(source.column)} for channel {channel}; it has: {offered or 'none'}. "
                f"Name the right one with --map COLUMN={channel}"
            )
        values = _channel(table, source, unit, path)
        if channel in limits:
            where = f"{path}, column {bare(source.column)}"
            check_plausible(values, limits[channel], unit, where, source.column, channel)
        columns.append(values)
    read = {source.column for source in found.values()}
    unread = tuple(c for c in table.columns if c and c not in read)
    return Recording(name, time_s, tuple(units), np.stack(columns, axis=-1), unread)


def files_of(path: Path, held_out: bool = False) -> Iterator[dict[str, Any]]:
    """A recording's file and the TOML file beside it, if there is one, as a document's provenance names them."""
    yield from read_file("recording", path, held_out)
    if _sidecar(path).is_file():
        yield from read_file("sidecar", _sidecar(path), held_out)


def _sidecar(path: Path) -> Path:
    return path.with_name(stem(path) + ".toml")


def _name(path: Path) -> str:
    """The recording's name, after which files are named.

    Raises:
        BadInput: no file can bear it everywhere.
    """
    name = stem(path)
    if not name.strip(". ") or name.startswith(".") or not name.isprintable():
        raise BadInput(f"{path}: no result can be named after this; rename it, printable, without a point in front")
    if len(name.encode(errors="surrogateescape")) > LONGEST_NAME_BYTES:
        raise BadInput(
            f"{path}: results are named after it, and it is longer than {LONGEST_NAME_BYTES} bytes; rename it"
        )
    if _DEVICES.fullmatch(name):
        raise BadInput(f"{path}: Windows keeps {name} for a device and results are named after it; rename it")
    return name


def _clock(table: pd.DataFrame, clock: Source, path: Path, longest_s: float, period_s: float) -> Array:
    """The time of each row, checked: it increases, and neither its unit nor a gap makes it endless."""
    if clock.column not in table.columns:
        raise BadInput(
            f"{path}: has no column {shown(clock.column)}; add the time in seconds, or name it with --map COLUMN={TIME}"
        )
    time_s = _channel(table, clock, TIME_UNIT, path)
    if len(time_s) < 2:
        raise BadInput(f"{path}: holds {len(time_s)} samples; a recording needs at least two")
    if np.isnan(time_s).any():
        raise BadInput(f"{path}, row {row(np.isnan(time_s))}: {TIME} is missing; every row needs its time")
    steps_s = np.diff(time_s)
    if (steps_s <= 0).any():
        raise BadInput(f"{path}, row {row(steps_s <= 0) + 1}: {TIME} does not increase; sort the rows by time")
    for unit, parts in PARTS_OF_A_SECOND.items():
        if FIRST_EPOCH_S <= time_s[0] / parts <= LAST_EPOCH_S:
            raise BadInput(
                f"{path}: {TIME} begins at {time_s[0]:.4g} s, which looks like {unit} since 1970; "
                f"say so with {as_map(clock.column, unit, TIME)}"
            )
    usual_s, k = float(np.median(steps_s)), int(np.argmax(steps_s))
    for unit, parts in PARTS_OF_A_SECOND.items():
        if A_THOUSAND < usual_s / period_s * 1e3 / parts <= A_THOUSAND * 1e3:
            raise BadInput(
                f"{path}: its samples are {usual_s:.4g} s apart, usual are {period_s:g} s; that looks like {unit}: "
                f"say so with {as_map(clock.column, unit, TIME)}, or record faster"
            )
    if steps_s[k] > max(LONGEST_GAP * len(time_s), SHORT_GAP) * usual_s:
        raise BadInput(
            f"{path}, row {k + 3}: {steps_s[k]:.4g} s have passed since the row before, usual are {usual_s:.4g} s; "
            "split the recording there, or mend the stamp"
        )
    if time_s[-1] - time_s[0] > longest_s:
        raise BadInput(
            f"{path}: {TIME} spans {time_s[-1] - time_s[0]:.3g} s, at most {longest_s:.3g} s can be read; "
            f"is it in ms? Say so with {as_map(clock.column, 'ms', TIME)}, or split the recording"
        )
    return time_s


def _channel(table: pd.DataFrame, source: Source, unit: str, path: Path) -> Array:
    where = f"{path}, column {bare(source.column)}"
    values = convert(numbers(table, source.column, path), source.unit, unit, where)
    if (np.abs(values) > LARGEST_READING).any():
        raise BadInput(f"{where}: in {unit} it reaches {np.nanmax(np.abs(values)):.3g}; check its unit")
    return values


def check_overlap(recordings: Sequence[Recording]) -> None:
    """Refuse recordings that share no channel that was ever measured.

    Raises:
        BadInput: names the two that have nothing in common.
    """
    measured = [{c for c, v in zip(r.channels, r.values.T, strict=True) if not np.isnan(v).all()} for r in recordings]
    for recording, channels in zip(recordings[1:], measured[1:], strict=True):
        if not channels & measured[0]:
            raise BadInput(
                f"recordings {recordings[0].name} and {recording.name} share no measured channel; "
                "estimate them one by one"
            )


def truth_table(batch: Batch, b: int) -> pd.DataFrame:
    """A simulated sequence as a table: time, channels, and ``true_*`` columns where it has truth."""
    import pandas as pd

    machine = batch.machine
    columns: dict[str, Array] = {TIME: batch.time_s}
    columns |= dict(zip(machine.channels, batch.measured[b].T, strict=True))
    if batch.truth is not None:
        truth = zip(machine.quantities, batch.truth.estimated[b].T, strict=True)
        columns |= {TRUTH_PREFIX + name: values for name, values in truth}
        clean = zip(machine.outputs, batch.truth.outputs[b].T, strict=True)
        columns |= {TRUTH_PREFIX + name: values for name, values in clean}
    return pd.DataFrame(columns)
