"""What the files of one run hold, channel by channel: mapped, in our units, joined, and on one clock."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from twinbench.common.errors import BadInput
from twinbench.common.shown import as_map, bare, shown
from twinbench.data.clock import stamps, usual_period
from twinbench.data.formats.holdings import TIME, Holdings, Zero
from twinbench.data.formats.united import NANOSECONDS
from twinbench.data.mapping import Offer, Source, sources
from twinbench.data.sidecar import Sidecar
from twinbench.data.table import LARGEST_READING, numbers, read_table, tell
from twinbench.data.units import convert
from twinbench.machines.coordinates import Array


@dataclass(frozen=True)
class Gathered:
    """A run's channels. N samples each.

    Attributes:
        time_s: (N,) seconds, increasing.
        values: (N,) of each channel, in its unit; NaN where missing.
        sources: where each came from in the first file.
        zero: when ``time_s`` is 0; None where nobody says.
        unread: columns of the first file that no channel came from.
        notes: what was done to it, and what is no column.
    """

    time_s: Array
    values: dict[str, Array]
    sources: dict[str, Source]
    zero: Zero | None
    unread: tuple[str, ...]
    notes: tuple[str, ...]

    @property
    def usual_s(self) -> float:
        """Seconds between two readings of the channel that is read most often."""
        return usual_period(self.time_s, self.values.values())


def gather(
    path: Path,
    sidecar: Sidecar,
    mapping: Sequence[str],
    units: Mapping[str, str] | None,
    may_lack: Sequence[str] = (),
) -> Gathered:
    """Read a file and those that its sidecar joins to it; the sidecar and ``mapping`` hold for all of them.

    Args:
        units: the channels to read and their units; None: whatever there is, in the units in which it is there.
        may_lack: channels that are missing throughout where a file has no column for them.

    Raises:
        BadInput: one line; a file cannot be read, or two do not follow on one clock.
    """
    files = (path, *sidecar.join)
    parts = [_read(file, sidecar, mapping, units, may_lack) for file in files]
    run = _joined(files, parts) if len(files) > 1 else parts[0]
    notes = list(run.notes)
    if sidecar.join:
        notes.append(f"joined of {', '.join(bare(file.name) for file in files)}")
    if sidecar.stamp:
        half = f"; {abs(sidecar.later_s):g} s were {'added' if sidecar.later_s > 0 else 'taken off'}"
        moved = half if sidecar.later_s else ""
        notes.append(f"means over {sidecar.average_s:g} s, stamped at their {sidecar.stamp}{moved}")
        tell(path, notes[-1])
    if run.zero is not None and not run.zero.utc:
        notes.append("its dates name no zone; they are taken as they are, as if no clock were ever set")
    return replace(run, time_s=run.time_s + sidecar.later_s, notes=tuple(notes))


def _read(
    path: Path, sidecar: Sidecar, mapping: Sequence[str], units: Mapping[str, str] | None, may_lack: Sequence[str]
) -> Gathered:
    held = read_table(path)
    found = sources(Offer(path, list(held.table.columns), held.units), sidecar, mapping, units)
    time_s, zero = stamps(held, found[TIME], path, sidecar.time_zone)
    values, others = {}, []
    for channel, source in found.items():
        if channel == TIME:
            continue
        if units is not None:
            values[channel] = _channel(held, channel, source, units[channel], path, channel in may_lack)
            continue
        try:
            values[channel] = _channel(held, channel, source, source.unit, path, may_lack=False)
        except BadInput:
            others.append(source.column)
    taken = {source.column for source in found.values()}
    unread = tuple(others) if units is None else tuple(c for c in held.table.columns if c and c not in taken)
    return Gathered(time_s, values, found, zero, unread, held.left_out)


def _channel(held: Holdings, channel: str, source: Source, unit: str, path: Path, may_lack: bool) -> Array:
    """Its values (N,) in its unit."""
    rows = len(held.table)
    if source.constant is not None:
        return np.full(rows, source.constant)
    if source.column not in held.table.columns and may_lack and source == Source(channel, unit):
        return np.full(rows, np.nan)
    if source.column not in held.table.columns:
        offered = ", ".join(bare(c) for c in held.table.columns if c and c != TIME)
        besides = f" (not read: {'; '.join(held.left_out)})" if held.left_out else ""
        raise BadInput(
            f"{path}: no column {shown(source.column)} for channel {channel}; it has: {offered or 'none'}{besides}. "
            f"Name the right one with --map COLUMN={channel}"
        )
    where = f"{path}, column {bare(source.column)}"
    values = numbers(held.table, source.column, path)
    try:
        values = convert(values, source.unit, unit, where)
    except BadInput as error:
        if held.units.get(source.column) != source.unit:
            raise
        told = as_map(source.column, unit, channel)
        raise BadInput(f"{error}; the file states that unit, and {told} says another") from error
    if (np.abs(values) > LARGEST_READING).any():
        raise BadInput(f"{where}: in {unit} it reaches {np.nanmax(np.abs(values)):.3g}; check its unit")
    return values


def _joined(files: Sequence[Path], parts: Sequence[Gathered]) -> Gathered:
    """One run of several files that follow each other, on the first one's clock."""
    first = parts[0]
    clocks: list[Array] = []
    for file, part in zip(files, parts, strict=True):
        if (part.zero and part.zero.utc) != (first.zero and first.zero.utc):
            raise BadInput(f"{file}: its clock is not that of {files[0]}; write the time of both in the same way")
        later_s = (part.zero.ns - first.zero.ns) / NANOSECONDS if part.zero and first.zero else 0.0
        time_s = part.time_s + later_s
        if clocks and time_s[0] <= clocks[-1][-1]:
            raise BadInput(
                f"{file}: begins at {time_s[0]:.6g} s, when the file before it has not ended ({clocks[-1][-1]:.6g} s); "
                "give them in the order of their time, on one clock"
            )
        clocks.append(time_s)
    names = dict.fromkeys(channel for part in parts for channel in part.values)
    lacking = [{c: p.values.get(c, np.full(len(p.time_s), np.nan)) for c in names} for p in parts]
    values = {channel: np.concatenate([part[channel] for part in lacking]) for channel in names}
    return replace(first, time_s=np.concatenate(clocks), values=values)
