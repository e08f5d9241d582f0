"""Measured against simulated over one recording, before and after, whole and close."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure, FigureBase
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from twinbench.common.style import BLUE, FAINT, INK, MOST_POINTS, MUTED, PAGE_MM, VERMILION, canvas, styled, thin
from twinbench.mismatch.report.replays import Replay, window
from twinbench.mismatch.spikes import Spike
from twinbench.mismatch.words import labelled, spoken, time_unit
from twinbench.physics.simulator import Array, Variable

WINDOW_SHARE = 16
"""The window shows one in so many of the blocks, but not fewer than ``WINDOW_BLOCKS_LEAST``."""
WINDOW_BLOCKS_LEAST = 40
MEASURED: dict[str, Any] = {
    "color": "#aab4bd",
    "linewidth": 3.2,
    "marker": "o",
    "markersize": 3.2,
    "markeredgewidth": 0,
}
"""A broad road below the simulated lines; the markers show readings that stand alone between gaps."""
BEFORE: dict[str, Any] = {"color": VERMILION, "linestyle": (0, (3.5, 1.2)), "linewidth": 1.1}
AFTER: dict[str, Any] = {"color": BLUE, "linestyle": "-", "linewidth": 1.1}
ERROR_BEFORE: dict[str, Any] = BEFORE | {"linestyle": "-", "linewidth": 1.5}
ERROR_AFTER: dict[str, Any] = AFTER | {"linewidth": 0.8}
"""Errors are noisy: dashes would be lost in them, so the widths tell them apart without colour."""
SPIKE: dict[str, Any] = {
    "color": INK, "linestyle": "none", "marker": "x", "markersize": 5, "markeredgewidth": 1.3, "zorder": 4,
}  # fmt: skip


@styled
def fit_over_time(
    replay: Replay, channels: Sequence[int], outputs: Sequence[Variable], sd: Array, spikes: Sequence[Spike] = ()
) -> Figure:
    """Two rows per channel, the readings and the errors; the whole recording left, a window of it right.

    Args:
        sd: (ny,) standard deviation of the noise of block means, in the outputs' units.
        spikes: readings that were taken out, of any recording and channel.
    """
    figure = canvas(PAGE_MM, 12.0 + 62.0 * len(channels))
    draw_fit(figure, replay, channels, outputs, sd, spikes)
    return figure


def draw_fit(
    figure: FigureBase,
    replay: Replay,
    channels: Sequence[int],
    outputs: Sequence[Variable],
    sd: Array,
    spikes: Sequence[Spike] = (),
) -> None:
    """As ``fit_over_time``, into a figure or a part of one.

    Args:
        sd: (ny,) standard deviation of the noise of block means, in the outputs' units.
    """
    grid = figure.subplots(
        2 * len(channels),
        2,
        sharex="col",
        squeeze=False,
        gridspec_kw={"width_ratios": (1.7, 1.0), "height_ratios": (1.25, 1.0) * len(channels)},
    )
    scale, unit = time_unit(float(replay.track.time_s[-1] - replay.track.time_s[0]))
    time = replay.track.block_time_s / scale
    close = window(replay, channels[0], max(WINDOW_BLOCKS_LEAST, len(time) // WINDOW_SHARE))
    whole = thin(len(time), MOST_POINTS)
    drawn = {outputs[c].name for c in channels}
    mine = [s for s in spikes if s.recording == replay.track.name and s.channel in drawn]
    for row, channel in enumerate(channels):
        v = outputs[channel]
        for column, rows in enumerate((whole, np.arange(len(time))[close])):
            top, bottom = grid[2 * row, column], grid[2 * row + 1, column]
            _readings(top, replay, channel, rows, time)
            _spikes(top, [(s.time_s / scale, s.value) for s in mine if s.channel == v.name], time[rows])
            _errors(bottom, replay, channel, rows, time, float(sd[channel]))
        for axes in grid[2 * row : 2 * row + 2, 0]:
            axes.axvspan(time[close][0], time[close][-1], color=FAINT, alpha=0.55, linewidth=0, zorder=0)
        grid[2 * row, 0].set_title(v.name, loc="left")
        grid[2 * row, 0].set_ylabel(spoken(v.unit))
        grid[2 * row + 1, 0].set_ylabel(labelled("error", v.unit))
    for axes, rows in zip(grid[-1], (whole, np.arange(len(time))[close]), strict=True):
        axes.set_xlabel(f"time in {replay.track.name}, {unit}")
        axes.set_xlim(time[rows[0]], time[rows[-1]])
    figure.align_ylabels(grid[:, 0])
    handles = _handles(replay.after is not None, bool(mine))
    figure.legend(handles=handles, loc="outside lower center", ncols=min(len(handles), 4), columnspacing=1.6)


def _readings(axes: Axes, replay: Replay, channel: int, rows: Array, time: Array) -> None:
    measured = replay.track.means[:, channel]
    axes.plot(time[rows], measured[rows], **MEASURED)
    axes.plot(time[rows], (measured - replay.before[:, channel])[rows], **BEFORE)
    if replay.after is not None:
        axes.plot(time[rows], (measured - replay.after[:, channel])[rows], **AFTER)


def _spikes(axes: Axes, spikes: Sequence[tuple[float, float]], time: Array) -> None:
    """Readings that were taken out, at the edge of the panel where they lie beyond what it shows."""
    low, high = axes.get_ylim()
    for at, value in spikes:
        if time[0] <= at <= time[-1]:
            axes.plot(at, np.clip(value, low, high), clip_on=False, **SPIKE)
    axes.set_ylim(low, high)


def _errors(axes: Axes, replay: Replay, channel: int, rows: Array, time: Array, sd: float) -> None:
    axes.axhspan(-2.0 * sd, 2.0 * sd, color=MUTED, alpha=0.25, linewidth=0, zorder=0.5)
    axes.plot(time[rows], replay.before[rows, channel], **ERROR_BEFORE)
    if replay.after is not None:
        axes.plot(time[rows], replay.after[rows, channel], **ERROR_AFTER)


def _handles(both: bool, spikes: bool) -> list[Line2D | Patch]:
    handles: list[Line2D | Patch] = [
        Line2D([], [], label="measured", **MEASURED),
        Line2D([], [], label="simulator before, calibrated" if both else "simulator, calibrated", **BEFORE),
    ]
    if both:
        handles.append(Line2D([], [], label="simulator after", **AFTER))
    if spikes:
        handles.append(Line2D([], [], label="taken out as a spike", **SPIKE))
    return [*handles, Patch(color=MUTED, alpha=0.25, linewidth=0, label="noise, ±2 SD")]
