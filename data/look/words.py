"""What a recording holds, in plain lines for a terminal."""

from __future__ import annotations

import bisect
from collections.abc import Iterator, Sequence

import numpy as np

from twinbench.common.shown import bare
from twinbench.data.clock import usual_period
from twinbench.data.look.channel import Channel
from twinbench.data.look.stretches import WIDE, Stretch
from twinbench.data.look.whole import Look
from twinbench.data.units import short_unit

MOST_TOLD = 5
"""Stretches of a kind that are told one by one."""
_HEAD = ("channel", "unit", "Hz", "readings", "lost", "lowest", "median", "highest", "noise", "moves by", "swings")


def told(seen: Look) -> list[str]:
    """The clock, a line for each channel, and what stands out."""
    rows = [_HEAD, *(_row(name, channel) for name, channel in seen.channels.items())]
    widths = [max(len(row[i]) for row in rows) for i in range(len(_HEAD))]
    lines = [
        "  " + "  ".join(c.rjust(w) if i > 1 else c.ljust(w) for i, (c, w) in enumerate(zip(row, widths, strict=True)))
        for row in rows
    ]
    return [_clock(seen), *lines, *(f"  {line}" for line in (*_remarks(seen), *seen.notes))]


def _clock(seen: Look) -> str:
    seconds, usual_s = seen.time_s[-1] - seen.time_s[0], usual_period(seen.time_s, seen.values.T)
    begins = f"; begins {seen.begins}" if seen.begins else ""
    return f"{seen.name}: {len(seen.time_s):,} rows over {seconds:.6g} s, usually every {usual_s:.4g} s{begins}"


def _row(name: str, channel: Channel) -> tuple[str, ...]:
    rate = f"{1.0 / channel.period_s:.4g}" if channel.period_s else "–"
    lost = "–" if channel.lost is None else f"{100.0 * channel.lost:.1f} %"
    numbers = (channel.low, channel.median, channel.high, channel.noise, channel.moves)
    shown = ("–" if value is None else f"{value:.4g}" for value in numbers)
    unit = short_unit(channel.unit) if channel.unit else "?"
    return bare(name), unit, rate, f"{channel.readings:,}", lost, *shown, f"{channel.swings:,}"


def _remarks(seen: Look) -> Iterator[str]:
    yield f"gaps in all channels at once: {_stretches(seen.gaps)}"
    for name, channel in seen.channels.items():
        if own := _own_gaps(channel, seen.gaps):
            yield f"{bare(name)} has gaps of its own: {_stretches(own)}"
        if channel.distinct == 1 and channel.readings > 1:
            yield f"{bare(name)} is {channel.low:.6g} throughout"
        if channel.stuck:
            yield f"{bare(name)} stands still: {_stretches(channel.stuck)}"
        if channel.clipped:
            yield f"{bare(name)} stands still at its highest or lowest value: {_stretches(channel.clipped)}"
    if seen.unread:
        yield f"no numbers: {', '.join(map(bare, seen.unread))}"


def _own_gaps(channel: Channel, in_all: Sequence[Stretch]) -> list[Stretch]:
    """Those that last longer, by more than a gap, than one that all channels have."""
    slack_s = WIDE * (channel.period_s or 0.0)
    begins_s = [every.begin_s for every in in_all]
    own = []
    for gap in channel.gaps:
        k = bisect.bisect_left(begins_s, gap.begin_s)
        longer_s = (begins_s[k] - gap.begin_s, gap.end_s - in_all[k].end_s) if k < len(in_all) else (np.inf,)
        if max(longer_s) > slack_s:
            own.append(gap)
    return own


def _stretches(stretches: Sequence[Stretch]) -> str:
    if not stretches:
        return "none"
    listed = ", ".join(
        f"{s.begin_s:.6g} to {s.end_s:.6g} s" + ("" if s.value is None else f" at {s.value:.6g}")
        for s in stretches[:MOST_TOLD]
    )
    rest = len(stretches) - MOST_TOLD
    seconds = sum(s.end_s - s.begin_s for s in stretches)
    return f"{listed}{f', and {rest} more' if rest > 0 else ''} ({seconds:.4g} s in all)"
