"""TDMS (LabVIEW), by npTDMS: waveforms have clocks of their own, other channels share a column of times."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from twinbench.common.errors import BadInput
from twinbench.common.shown import bare
from twinbench.data.formats import holdings
from twinbench.data.formats.holdings import Holdings, Zero, library, too_large
from twinbench.data.formats.united import NANOSECONDS, Series, stated, told_apart, united

if TYPE_CHECKING:
    import pandas as pd

_UNITS = ("unit_string", "NI_UnitDescription")
"""Properties that hold a channel's unit, in the order in which LabVIEW's own functions write them."""
_SINCE_1904_S = 2_082_844_800
"""Seconds from TDMS's zero, 1904, to 1970."""


def read(path: Path) -> Holdings:
    """Every channel of numbers or times; waveforms by their own clocks, where there are any.

    Raises:
        BadInput: npTDMS is not installed, too large, or no channel of numbers.
    """
    nptdms = library("nptdms", "npTDMS", "tdms", path)
    with path.open("rb") as stream, nptdms.TdmsFile.open(stream, raw_timestamps=True) as file:
        channels = [c for group in file.groups() for c in group.channels() if len(c)]
        if sum(map(len, channels)) > holdings.MOST_CELLS:
            raise too_large(path, max(map(len, channels)), len(channels))
        waves = [c for c in channels if c.properties.get("wf_increment") and _numbers(c)]
        others = [c for c in channels if c not in waves]
        held = _waveforms(path, waves, others) if waves else _columns(path, channels)
        cut = ("the end of its last segment, which is cut short",) if file.file_status.incomplete_final_segment else ()
        return replace(held, left_out=held.left_out + cut)


def _waveforms(path: Path, waves: list[Any], others: list[Any]) -> Holdings:
    begins = [_nanoseconds(c.properties.get("wf_start_time")) for c in waves]
    zero_ns = min(b for b in begins if b is not None) if None not in begins else None
    series = []
    for channel, begin_ns in zip(waves, begins, strict=True):
        late_s = (begin_ns - zero_ns) / NANOSECONDS if begin_ns is not None and zero_ns is not None else 0.0
        late_s += float(channel.properties.get("wf_start_offset", 0.0))
        time_s = late_s + np.arange(len(channel)) * float(channel.properties["wf_increment"])
        series.append(Series(channel.group_name, channel.name, time_s, channel[:], _unit(channel)))
    listed = ", ".join(bare(c.name) for c in others[:5])
    left_out = (f"channels without a clock of their own, beside waveforms ({listed})",) if others else ()
    zero = None if zero_ns is None else Zero(zero_ns, utc=True)
    return Holdings(united(path, series), stated(series), zero, left_out)


def _columns(path: Path, channels: list[Any]) -> Holdings:
    """Channels as columns, those that have the length that most have; one of them has to be the time."""
    import pandas as pd

    good = [c for c in channels if _numbers(c) or _is_time(c)]
    if not good:
        raise BadInput(f"{path}: holds no channel of numbers; record again or name another file")
    lengths = Counter(map(len, good))
    length = max(lengths, key=lambda n: (lengths[n], n))
    kept = [c for c in good if len(c) == length]
    series = [Series(c.group_name, c.name, np.empty(0), _times(c[:]) if _is_time(c) else c[:], _unit(c)) for c in kept]
    table = pd.DataFrame(dict(enumerate(each.values for each in series)))
    table.columns = pd.Index(told_apart(series))
    others = ", ".join(bare(c.name) for c in [c for c in channels if c not in kept][:5])
    left_out = (f"channels of text, or that have not {length:,} samples as most have ({others})",) if others else ()
    return Holdings(table, stated(series), None, left_out)


def _unit(channel: Any) -> str:
    """The unit that it states; empty if none."""
    return next((str(channel.properties[p]) for p in _UNITS if channel.properties.get(p)), "")


def _numbers(channel: Any) -> bool:
    return not _is_time(channel) and channel.dtype is not None and channel.dtype.kind in "fiub"


def _is_time(channel: Any) -> bool:
    return channel.data_type.__name__ == "TimeStamp"


def _times(stamps: Any) -> pd.DatetimeIndex:
    """Times (N,) in UTC to the nanosecond, which TDMS counts in 2**-64 s."""
    import pandas as pd

    whole = stamps.seconds.astype(np.int64) - _SINCE_1904_S
    parts = np.rint(stamps.second_fractions.astype(float) * (NANOSECONDS / 2.0**64)).astype(np.int64)
    return pd.DatetimeIndex((whole * int(NANOSECONDS) + parts).view("datetime64[ns]"), tz="UTC")


def _nanoseconds(stamp: Any) -> int | None:
    """Nanoseconds from 1970 in UTC to a time stamp of TDMS; None where there is none."""
    if stamp is None:
        return None
    parts = round(int(stamp.second_fractions) * int(NANOSECONDS) / 2**64)
    return (int(stamp.seconds) - _SINCE_1904_S) * int(NANOSECONDS) + parts
