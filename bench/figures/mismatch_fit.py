"""Measured against simulated over one recording, before and after, whole and close."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from bench.figures.style import FAINT, MUTED, PAGE_MM, canvas, styled, thin
from bench.replays import Replay, window
from physics.simulator import Array, Variable

MOST_POINTS = 800
"""Points per line: more cannot be told apart at page width."""
CLOSE = 16
"""The window shows one in so many of the blocks, but not fewer than ``LEAST``."""
LEAST = 40
MEASURED: dict[str, Any] = {
    "color": "#aab4bd", "linewidth": 3.2, "marker": "o", "markersize": 3.2, "markeredgewidth": 0,
}  # fmt: skip
"""A broad road below the simulated lines; the markers show readings that stand alone between gaps."""
BEFORE: dict[str, Any] = {"color": "#D55E00", "linestyle": (0, (3.5, 1.2)), "linewidth": 1.1}
AFTER: dict[str, Any] = {"color": "#0072B2", "linestyle": "-", "linewidth": 1.1}
ERROR_BEFORE: dict[str, Any] = BEFORE | {"linestyle": "-", "linewidth": 1.5}
ERROR_AFTER: dict[str, Any] = AFTER | {"linewidth": 0.8}
"""Errors are noisy: dashes would be lost in them, so the widths tell them apart without colour."""


@styled
def fit_over_time(replay: Replay, channels: Sequence[int], outputs: Sequence[Variable], sd: Array) -> Figure:
    """Two rows per channel, the readings and the errors; the whole recording left, a window of it right."""
    figure = canvas(PAGE_MM, 12.0 + 62.0 * len(channels))
    grid = figure.subplots(
        2 * len(channels), 2, sharex="col", squeeze=False,
        gridspec_kw={"width_ratios": (1.7, 1.0), "height_ratios": (1.25, 1.0) * len(channels)},
    )  # fmt: skip
    scale, unit = time_unit(float(replay.track.time_s[-1] - replay.track.time_s[0]))
    time = replay.track.block_time_s / scale
    close = window(replay, channels[0], max(LEAST, len(time) // CLOSE))
    whole = thin(len(time), MOST_POINTS)
    for row, channel in enumerate(channels):
        v = outputs[channel]
        for column, rows in enumerate((whole, np.arange(len(time))[close])):
            top, bottom = grid[2 * row, column], grid[2 * row + 1, column]
            _readings(top, replay, channel, rows, time)
            _errors(bottom, replay, channel, rows, time, float(sd[channel]))
        for axes in grid[2 * row : 2 * row + 2, 0]:
            axes.axvspan(time[close][0], time[close][-1], color=FAINT, alpha=0.55, linewidth=0, zorder=0)
        grid[2 * row, 0].set_title(v.name, loc="left")
        grid[2 * row, 0].set_ylabel(v.unit)
        grid[2 * row + 1, 0].set_ylabel(f"error, {v.unit}")
    for axes, rows in zip(grid[-1], (whole, np.arange(len(time))[close]), strict=True):
        axes.set_xlabel(f"time in {replay.track.name}, {unit}")
        axes.set_xlim(time[rows[0]], time[rows[-1]])
    figure.align_ylabels(grid[:, 0])
    figure.legend(handles=_handles(replay.after is not None), loc="outside lower center", ncols=4, columnspacing=1.6)
    return figure


def _readings(axes: Axes, replay: Replay, channel: int, rows: Array, time: Array) -> None:
    measured = replay.track.means[:, channel]
    axes.plot(time[rows], measured[rows], **MEASURED)
    axes.plot(time[rows], (measured - replay.before[:, channel])[rows], **BEFORE)
    if replay.after is not None:
        axes.plot(time[rows], (measured - replay.after[:, channel])[rows], **AFTER)


def _errors(axes: Axes, replay: Replay, channel: int, rows: Array, time: Array, sd: float) -> None:
    axes.axhspan(-2.0 * sd, 2.0 * sd, color=MUTED, alpha=0.25, linewidth=0, zorder=0.5)
    axes.plot(time[rows], replay.before[rows, channel], **ERROR_BEFORE)
    if replay.after is not None:
        axes.plot(time[rows], replay.after[rows, channel], **ERROR_AFTER)


def _handles(both: bool) -> list[Line2D | Patch]:
    handles: list[Line2D | Patch] = [
        Line2D([], [], label="measured", **MEASURED),
        Line2D([], [], label="simulator before, calibrated" if both else "simulator, calibrated", **BEFORE),
    ]
    if both:
        handles.append(Line2D([], [], label="simulator after", **AFTER))
    return [*handles, Patch(color=MUTED, alpha=0.25, linewidth=0, label="error where it learnt, ±2 rms")]


def time_unit(duration_s: float) -> tuple[float, str]:
    """Seconds in the unit that suits a recording of that length, and the unit."""
    return (86400.0, "d") if duration_s > 2e5 else (3600.0, "h") if duration_s > 10800.0 else (1.0, "s")
