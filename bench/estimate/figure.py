"""One recording of a user: what ``twinbench estimate`` draws."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from twinbench.common.style import (
    BLUE,
    FAINT,
    INK,
    MOST_POINTS,
    MUTED,
    PAGE_MM,
    PAPER,
    VERMILION,
    ZERO_C_K,
    canvas,
    png,
    styled,
    svg,
    thin,
)
from twinbench.machines.coordinates import Array
from twinbench.machines.machine import Machine

KINDS = {"used": "#9ecae1", "outside training": "#E69F00", "rejected": VERMILION, "missing": FAINT}
"""What becomes of a reading, and its colour, told apart by the colour-blind, too."""
MOST_BINS = 300
DRAWN_IN = {"K": ("°C", 1.0, -ZERO_C_K), "kg/s": ("g/s", 1e3, 0.0)}
"""Units that readings are drawn in instead of their own: what they are multiplied by, and then shifted by."""
COLUMNS = 3
HEIGHT_MM, STRIP = 38.5, 0.9
"""Of a row of panels, and of the strip below them in such rows."""


@dataclass(frozen=True)
class Readings:
    """What was read and what became of it. N ticks.

    Attributes:
        machine: of which.
        time_s: (N,) seconds.
        measured: (N, nu + ny) in the channels' units; NaN means missing.
        accepted: (N, nu + ny) bool, used by the estimator.
        every: (nu + ny,) ticks between two readings as the recording goes; 0: the channel is not there.
        low: (nu + ny,) where the training range begins, in the channels' units.
        high: (nu + ny,) where it ends, likewise.
        warning: stands over the figure where the estimate is not usable.
    """

    machine: Machine
    time_s: Array
    measured: Array
    accepted: np.ndarray
    every: tuple[int, ...]
    low: Array
    high: Array
    warning: str = ""

    def binned(self) -> tuple[Array, np.ndarray]:
        """Edges (K + 1,) in seconds, and of each bin (K, nu + ny) which of KINDS most of its readings are."""
        n = len(self.time_s)
        edges = np.unique(np.linspace(0, n, min(n // max(*self.every, 1) + 1, MOST_BINS) + 1).astype(int))
        there = ~np.isnan(self.measured)
        outside = there & ((self.measured < self.low) | (self.measured > self.high))
        expected = np.diff(edges)[:, None] / np.maximum(self.every, 1)
        read, far, used = (np.add.reduceat(a.astype(int), edges[:-1]) for a in (there, outside, self.accepted & there))
        kinds = np.select([2 * read < expected, 2 * used < read, 2 * far > read], [3, 2, 1], 0)
        ends = np.minimum(edges, n - 1)
        return self.time_s[ends], kinds

    def gaps(self) -> list[tuple[float, float]]:
        """Begin and end, in seconds, of the times without any reading that are long enough to be seen."""
        read = np.flatnonzero(~np.isnan(self.measured).all(axis=1))
        ends = self.time_s[np.unique(np.concatenate([[0], read, [len(self.time_s) - 1]]))]
        least = max((ends[-1] - ends[0]) / MOST_BINS, 2 * max(self.every) * self.machine.sample_period_s)
        long = np.flatnonzero(np.diff(ends) > least)
        return [(float(ends[i]), float(ends[i + 1])) for i in long]


def estimate_figure(time_s: Array, mean: Array, low: Array, high: Array, readings: Readings, path: Path) -> None:
    """Draw estimates with 95 % bands over one recording into ``path``, a .png or an .svg.

    Args:
        time_s: (M,) seconds.
        mean: (M, n + nh) in the quantities' units.
        low: (M, n + nh) likewise, where the 95 % band begins.
        high: (M, n + nh) likewise, where it ends.
    """
    figure = recording_estimates(time_s, mean, low, high, readings)
    path.write_bytes(svg(figure).encode() if path.suffix == ".svg" else png(figure))


@styled
def recording_estimates(time_s: Array, mean: Array, low: Array, high: Array, readings: Readings) -> Figure:
    """Outputs against readings on top, the health parameters, and which readings were used; as
    ``estimate_figure``.

    Args:
        time_s: (M,) seconds.
        mean: (M, n + nh) in the quantities' units.
        low: (M, n + nh) likewise, where the 95 % band begins.
        high: (M, n + nh) likewise, where it ends.
    """
    keep = thin(len(time_s), MOST_POINTS)
    minutes = time_s[keep] / 60.0
    bands = [np.asarray(a[keep], dtype=float) for a in (mean, low, high)]
    machine = readings.machine
    panels = len(machine.outputs) + len(machine.health) + 1
    height = -(-panels // COLUMNS)
    figure = canvas(PAGE_MM, HEIGHT_MM * (height + STRIP))
    rows = figure.add_gridspec(height + 1, COLUMNS, height_ratios=(*(1.0,) * height, STRIP))
    first = figure.add_subplot(rows[0, 0])
    places = [divmod(i, COLUMNS) for i in range(1, panels)]
    grid = [first, *(figure.add_subplot(rows[i, j], sharex=first) for i, j in places)]

    for i, (axes, name) in enumerate(zip(grid, machine.outputs, strict=False)):
        unit = machine.variables[name].unit
        text, scale, shift = DRAWN_IN.get(unit, (machine.axis_label(name).rpartition(", ")[2], 1.0, 0.0))
        _dots(axes, readings, machine.channels.index(name), scale, shift)
        _band(axes, minutes, *(_reading(machine, b, bands[0])[:, i] * scale + shift for b in bands))
        axes.set_title(f"{machine.label(name)}, {text}", loc="left")
    for i, name in enumerate(machine.health_names):
        axes, column = grid[len(machine.outputs) + i], len(machine.estimated) + i
        _band(axes, minutes, *(b[:, column] for b in bands))
        axes.axhline(machine.coordinates.healthy[i], color=INK, linewidth=0.7, linestyle=":")
        axes.set_title(machine.axis_label(name), loc="left")
    for axes in grid[:-1]:
        for begin, end in readings.gaps():
            axes.axvspan(begin / 60.0, end / 60.0, color=FAINT, linewidth=0, alpha=0.7)
    first.set_xlim(minutes[0], minutes[-1] if minutes[-1] > minutes[0] else minutes[0] + 1.0)
    _legend(grid[-1])
    _strip(figure.add_subplot(rows[height, :], sharex=first), readings)
    figure.supxlabel("time, min", fontsize=8)
    if readings.warning:
        figure.suptitle(readings.warning, fontsize=9, color=VERMILION, x=0.01, ha="left", weight="bold")
    return figure


def _dots(axes: Axes, readings: Readings, channel: int, scale: float, shift: float) -> None:
    """Readings that were used, and on top of them those that were not; the view is that of the former if there are."""
    values, used = readings.measured[:, channel] * scale + shift, readings.accepted[:, channel]
    minutes = readings.time_s / 60.0
    for which, colour, marker, size in ((used, MUTED, ".", 1.6), (~used & ~np.isnan(values), VERMILION, "x", 2.6)):
        some = np.flatnonzero(which)[thin(int(which.sum()), MOST_POINTS)] if which.any() else []
        axes.plot(minutes[some], values[some], marker, color=colour, markersize=size, alpha=0.7, markeredgewidth=0.6)


def _strip(axes: Axes, readings: Readings) -> None:
    """Each channel over time: used, rejected, outside training or missing, whichever most of a bin's readings are."""
    edges, kinds = readings.binned()
    channels = readings.machine.channels
    axes.pcolormesh(
        edges / 60.0,
        np.arange(len(channels) + 1),
        kinds.T,
        cmap=ListedColormap(list(KINDS.values())),
        vmin=-0.5,
        vmax=len(KINDS) - 0.5,
    )
    axes.set_yticks(np.arange(len(channels)) + 0.5, [readings.machine.label(c) for c in channels])
    axes.invert_yaxis()
    axes.grid(visible=False)
    axes.tick_params(left=False)
    axes.hlines(np.arange(1, len(channels)), *axes.get_xlim(), color=PAPER, linewidth=1.5)
    axes.set_title("what became of the readings", loc="left")
    axes.legend(
        handles=[Patch(color=colour, linewidth=0, label=kind) for kind, colour in KINDS.items()],
        loc="lower right",
        bbox_to_anchor=(1.0, 1.0),
        ncols=len(KINDS),
        borderpad=0.0,
        handlelength=1.4,
    )


def _legend(axes: Axes) -> None:
    axes.set_axis_off()
    axes.legend(
        handles=[
            Line2D([], [], color=MUTED, marker=".", markersize=4, linestyle="none", label="reading"),
            Line2D([], [], color=VERMILION, marker="x", markersize=4, linestyle="none", label="reading, rejected"),
            Line2D([], [], color=BLUE, linewidth=1.2, label="estimate"),
            Patch(color=BLUE, alpha=0.25, linewidth=0, label="95 % band"),
            Line2D([], [], color=INK, linewidth=0.7, linestyle=":", label="healthy"),
        ],
        loc="center",
    )


def _reading(machine: Machine, bound: Array, mean: Array) -> Array:
    """Sensor readings (M, ny) of a bound (M, n + nh), at the mean of each sensor's bias.

    A state and the bias of its sensor err against each other, so adding up their bounds would be too wide.
    """
    settled = bound.copy()
    for bias in (machine.quantities.index(r.bias) for r in machine.readings if r.bias):
        settled[:, bias] = mean[:, bias]
    return machine.observe(settled)


def _band(axes: Axes, minutes: Array, mean: Array, low: Array, high: Array) -> None:
    axes.fill_between(minutes, low, high, color=BLUE, alpha=0.25, linewidth=0)
    axes.plot(minutes, mean, color=BLUE, linewidth=1.2)
