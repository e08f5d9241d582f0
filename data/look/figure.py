"""A recording drawn: every channel over time, with its gaps and the stretches in which it stands still."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from twinbench.common.shown import bare
from twinbench.common.style import BLUE, FAINT, MOST_POINTS, PAGE_MM, canvas, styled
from twinbench.data.look.channel import Channel
from twinbench.data.look.whole import Look
from twinbench.data.units import short_unit
from twinbench.machines.coordinates import Array

MOST_CHANNELS = 40
"""Channels of a figure: a page of more is no longer looked at."""
PALE_ORANGE, PALE_RED = "#F3CF85", "#E79F6B"
"""Okabe and Ito's orange and vermilion behind a line of theirs, which has to stay legible."""
MARKS = (("stands still", PALE_ORANGE), ("stands still at its highest or lowest", PALE_RED), ("no reading", FAINT))
"""What a stretch is marked by; the later ones cover the earlier ones."""
_ROW_MM = 18.0


@styled
def look_figure(seen: Look) -> Figure:
    """One panel below the other, of the first ``MOST_CHANNELS`` channels, on one axis of time."""
    names = list(seen.channels)[:MOST_CHANNELS]
    count = max(len(names), 1)
    figure = canvas(PAGE_MM, _ROW_MM * (count + 1))
    rows = figure.subplots(count, 1, sharex=True, squeeze=False)[:, 0]
    for k, (axes, name) in enumerate(zip(rows, names, strict=False)):
        _panel(axes, seen.time_s, seen.values[:, k], name, seen.channels[name])
    rows[-1].set_xlabel(f"time, s{f' (first row {seen.begins})' if seen.begins else ''}")
    handles = [Patch(color=colour, linewidth=0, label=label) for label, colour in MARKS]
    figure.legend(handles=handles, loc="outside upper right", ncols=len(MARKS))
    some = f", {MOST_CHANNELS} of {len(seen.channels)} channels" if len(names) < len(seen.channels) else ""
    figure.suptitle(f"{bare(seen.name)}{some}", x=0.01, ha="left", fontsize=9)
    return figure


def _panel(axes: Axes, time_s: Array, values: Array, name: str, channel: Channel) -> None:
    read = np.flatnonzero(~np.isnan(values))
    keep = read[_outline(values[read])]
    breaks = np.searchsorted(time_s[keep], [gap.begin_s for gap in channel.gaps], side="right")
    dots = "." if len(keep) == len(read) else ""  # some of the readings only would look like gaps
    drawn = (np.insert(series[keep], breaks, np.nan) for series in (time_s, values))
    axes.margins(x=0.01)
    axes.plot(*drawn, color=BLUE, linewidth=0.7, markersize=1.5, marker=dots)
    for stretches, (_, colour) in zip((channel.stuck, channel.clipped, channel.gaps), MARKS, strict=True):
        spans = [(stretch.begin_s, stretch.end_s - stretch.begin_s) for stretch in stretches]
        axes.broken_barh(spans, (0.0, 1.0), transform=axes.get_xaxis_transform(), color=colour, linewidth=0.5, zorder=0)
    unit = f", {short_unit(bare(channel.unit))}" if channel.unit else ""
    axes.set_title(f"{bare(name)}{unit}{'' if len(read) else ': no reading'}", loc="left")


def _outline(values: Array) -> np.ndarray:
    """Indices of the first, the lowest, the highest and the last reading of each of ``MOST_POINTS`` parts.

    So steps stay upright and spikes are seen.

    Args:
        values: (n,) in any unit, none missing.
    """
    if len(values) <= MOST_POINTS:
        return np.arange(len(values))
    parts = np.array_split(np.arange(len(values)), MOST_POINTS)
    return np.unique([(p[0], p[np.argmin(values[p])], p[np.argmax(values[p])], p[-1]) for p in parts])
