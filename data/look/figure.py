"""A recording drawn: every channel over time, with its gaps and the stretches in which it stands still."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from twinbench.common.shown import bare
from twinbench.common.style import BLUE, FAINT, MOST_POINTS, PAGE_MM, VERMILION, canvas, styled
from twinbench.data.look.channel import Channel
from twinbench.data.look.whole import Look
from twinbench.data.units import short_unit
from twinbench.machines.coordinates import Array

MOST_DRAWN = 40
"""Channels of a figure: a page of more is no longer looked at."""
ORANGE = "#E69F00"
"""Another of Okabe and Ito's colours."""
_ROW_MM = 18.0


@styled
def look_figure(seen: Look) -> Figure:
    """One panel below the other, of the first ``MOST_DRAWN`` channels, on one axis of time."""
    names = list(seen.channels)[:MOST_DRAWN]
    figure = canvas(PAGE_MM, _ROW_MM * (len(names) + 1))
    rows = figure.subplots(max(len(names), 1), 1, sharex=True, squeeze=False)[:, 0]
    for k, (axes, name) in enumerate(zip(rows, names, strict=False)):
        _panel(axes, seen.time_s, seen.values[:, k], name, seen.channels[name])
    rows[-1].set_xlabel(f"time, s{f', from {seen.begins}' if seen.begins else ''}")
    marks = (("no reading", FAINT), ("stands still", ORANGE), ("at its highest or lowest", VERMILION))
    handles = [Patch(color=colour, alpha=0.6, linewidth=0, label=label) for label, colour in marks]
    figure.legend(handles=handles, loc="outside upper right", ncols=len(marks))
    figure.suptitle(bare(seen.name), x=0.01, ha="left", fontsize=9)
    return figure


def _panel(axes: Axes, time_s: Array, values: Array, name: str, channel: Channel) -> None:
    keep = _outline(values)
    axes.plot(time_s[keep], values[keep], color=BLUE, linewidth=0.7, marker=".", markersize=1.2)
    for stretches, colour in ((channel.gaps, FAINT), (channel.stuck, ORANGE), (channel.clipped, VERMILION)):
        for stretch in stretches:
            axes.axvspan(stretch.begin_s, stretch.end_s, color=colour, alpha=0.6, linewidth=0, zorder=0)
    axes.set_title(f"{bare(name)}, {short_unit(bare(channel.unit))}" if channel.unit else bare(name), loc="left")


def _outline(values: Array) -> np.ndarray:
    """Indices of some ``MOST_POINTS`` readings, the lowest and the highest of each stretch: spikes are to be seen.

    Args:
        values: (N,) in any unit; NaN where missing.
    """
    read = np.flatnonzero(~np.isnan(values))
    if len(read) <= MOST_POINTS:
        return read
    parts = np.array_split(read, MOST_POINTS // 2)
    return np.sort([part[pick(values[part])] for part in parts for pick in (np.argmin, np.argmax)])
