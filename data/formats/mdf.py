"""MDF 4 (ASAM), by asammdf: channel groups with clocks of their own, units, and the time at which it began."""

from __future__ import annotations

import contextlib
import gc
from pathlib import Path
from typing import Any

import numpy as np

from twinbench.common.errors import BadInput
from twinbench.common.shown import bare
from twinbench.data.formats import holdings
from twinbench.data.formats.holdings import TIME, Holdings, Zero, library, too_large
from twinbench.data.formats.united import Series, stated, united

_FORMULA = 3
"""Conversion by a formula, in the standard's count. asammdf hands its text to Python, and no recording is executed."""
_MASTERS = (2, 3)
"""Channel types of a group's clock, recorded and reckoned."""
_NUMBERS = range(6)
"""Data types of whole numbers and of floats; behind them come text, bytes and dates."""
_OF_A_RECORD = (0, 6)
"""Channel types whose samples stand in the records, or are counted; others point elsewhere, and a damaged pointer leads
asammdf out of memory."""
_TIME = 1
"""Kind of clock: others are angles, lengths or numbers of samples."""
_LOCAL = 1
"""Flag of a time that is in no known zone."""


def read(path: Path) -> Holdings:
    """Every channel of an MDF 4 file that holds one number a sample, in the unit that it states.

    Raises:
        BadInput: asammdf is not installed, another version, too large, or no such channel.
    """
    asammdf = library("asammdf", "asammdf", "mdf", path)
    version = _version(path)
    if not version.startswith("4"):
        raise BadInput(f"{path}: is MDF {bare(version)}; save it as MDF 4")
    try:
        return _held(asammdf, path)
    except BadInput:
        raise
    except Exception as error:
        why = str(error) or type(error).__name__
    gc.collect()  # what asammdf could not open it fails to close, too: let it complain of that now
    raise ValueError(why)


def _held(asammdf: Any, path: Path) -> Holdings:
    with contextlib.closing(asammdf.MDF(path, process_bus_logging=False)) as file:
        for group in file.groups:
            _check_inside(path, group)
        cells = sum(g.channel_group.cycles_nr * len(g.channels) for g in file.groups)
        if cells > holdings.MOST_CELLS:
            raise too_large(path, max(g.channel_group.cycles_nr for g in file.groups), len(file.groups))
        series, unread = _series(file)
        zero = Zero(int(file.header.abs_time), not file.header.time_flags & _LOCAL)
        listed = ", ".join(map(bare, unread[:5]))
        left_out = (f"channels of text or arrays, by a formula, or without a time ({listed})",) if unread else ()
        return Holdings(united(path, series), stated(series), zero, left_out)


def _series(file: Any) -> tuple[list[Series], list[str]]:
    """Each channel of numbers but for the clocks; and the names of those that hold none."""
    series, unread = [], []
    for g, group in enumerate(file.groups):
        masters = [c for c in group.channels if c.channel_type in _MASTERS]
        timed = len(masters) == 1 and masters[0].sync_type == _TIME and not _has_formula(masters[0].conversion)
        time_s = file.get_master(g) if timed and group.channel_group.cycles_nr else np.empty(0)
        for c, channel in enumerate(group.channels):
            if channel in masters or channel.name == TIME:
                continue
            numeric = channel.data_type in _NUMBERS and channel.channel_type in _OF_A_RECORD
            if len(time_s) and numeric and not group.channel_dependencies[c] and not _has_formula(channel.conversion):
                series.append(_channel(file, g, c, time_s))
            else:
                unread.append(channel.name)
    return series, unread


def _channel(file: Any, g: int, c: int, time_s: np.ndarray) -> Series:
    """A channel's numbers, without samples that the file calls invalid."""
    signal, conversion = file.get(group=g, index=c, raw=True), file.groups[g].channels[c].conversion
    values = signal.samples
    if conversion is not None:
        values = conversion.convert(values, ignore_value2text_conversions=True)
    own_s = time_s if len(signal.timestamps) == len(time_s) else signal.timestamps
    return Series(str(g + 1), signal.name, own_s, values, signal.unit)


def _check_inside(path: Path, group: Any) -> None:
    """Refuse a channel that is beside its records: asammdf would read what is in memory there, if not end Python."""
    for channel in group.channels:
        bits = 8 * channel.byte_offset + channel.bit_offset + channel.bit_count
        if bits > 8 * group.channel_group.samples_byte_nr:
            raise BadInput(f"{path}, channel {bare(channel.name)}: lies beside its records; export it again")


def _has_formula(conversion: Any) -> bool:
    """Is a conversion a formula, or does it lead to one?"""
    if conversion is None or not hasattr(conversion, "conversion_type"):
        return False
    inside = (conversion.referenced_blocks or {}).values()
    return conversion.conversion_type == _FORMULA or any(map(_has_formula, inside))


def _version(path: Path) -> str:
    with path.open("rb") as file:
        begin = file.read(16)
    if begin[:8].strip() not in (b"MDF", b"UnFinMF"):
        raise BadInput(f"{path}: is no MDF file; name another, or name this one by its kind")
    return begin[8:16].decode("ascii", "replace").strip("\0 ")
