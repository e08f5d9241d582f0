"""One recording of a user: what ``twinbench estimate`` draws."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from bench.figures.style import INK, MUTED, PAGE_MM, canvas, png, styled, svg, thin
from bench.roster import axis_label
from data.batch import CHANNELS, ESTIMATED, HEALTH, OUTPUTS, Array
from methods.observe import observe
from physics.health import HEALTHY

MOST_POINTS = 1500
ZERO_C_K = 273.15
BLUE = "#0072B2"
READINGS = (
    ("discharge pressure, bar", 1.0, 0.0),
    ("discharge temperature, °C", 1.0, -ZERO_C_K),
    ("mass flow, g/s", 1e3, 0.0),
)


def estimate_figure(time_s: Array, mean: Array, low: Array, high: Array, measured: Array, path: Path) -> None:
    """Draw estimates with 95 % bands over one recording into ``path``, a .png or an .svg.

    Args:
        time_s: (M,) mean, low, high: (M, 10), order ESTIMATED, physical units.
        measured: (M, 7), order CHANNELS; NaN where missing.
    """
    figure = recording_estimates(time_s, mean, low, high, measured)
    path.write_bytes(svg(figure).encode() if path.suffix == ".svg" else png(figure))


@styled
def recording_estimates(time_s: Array, mean: Array, low: Array, high: Array, measured: Array) -> Figure:
    """Outputs against measurements on top, the five health parameters beneath; as ``estimate_figure``."""
    keep = thin(len(time_s), MOST_POINTS)
    minutes = time_s[keep] / 60.0
    bands = [np.asarray(a[keep], dtype=float) for a in (mean, low, high)]
    figure = canvas(PAGE_MM, 118.0)
    grid = figure.subplots(3, 3, sharex=True).ravel()

    for axes, channel, (text, scale, shift) in zip(grid, range(len(OUTPUTS)), READINGS, strict=False):
        dots = measured[keep, CHANNELS.index(OUTPUTS[channel])]
        axes.plot(minutes, dots * scale + shift, ".", color=MUTED, markersize=1.6, alpha=0.6)
        _band(axes, minutes, *(_reading(b, bands[0])[:, channel] * scale + shift for b in bands))
        axes.set_title(text, loc="left")
    for axes, name in zip(grid[len(OUTPUTS) :], HEALTH, strict=False):
        _band(axes, minutes, *(b[:, ESTIMATED.index(name)] for b in bands))
        axes.axhline(HEALTHY[HEALTH.index(name)], color=INK, linewidth=0.7, linestyle=":")
        axes.set_title(axis_label(name), loc="left")
    for axes in grid:
        axes.tick_params(labelbottom=True)
    figure.supxlabel("time, min", fontsize=8)
    grid[0].set_xlim(minutes[0], minutes[-1] if minutes[-1] > minutes[0] else minutes[0] + 1.0)
    grid[-1].set_axis_off()
    grid[-1].legend(
        handles=[
            Line2D([], [], color=MUTED, marker=".", markersize=4, linestyle="none", label="measured"),
            Line2D([], [], color=BLUE, linewidth=1.2, label="estimate"),
            Patch(color=BLUE, alpha=0.25, linewidth=0, label="95 % band"),
            Line2D([], [], color=INK, linewidth=0.7, linestyle=":", label="healthy"),
        ],
        loc="center",
    )
    return figure


def _reading(bound: Array, mean: Array) -> Array:
    """Sensor readings (M, 3) of a bound (M, 10), at the mean sensor bias.

    Gas temperature and bias err against each other, so adding up their bounds would be too wide.
    """
    settled = bound.copy()
    bias = ESTIMATED.index("T_bias_K")
    settled[:, bias] = mean[:, bias]
    return observe(settled)


def _band(axes: Axes, minutes: Array, mean: Array, low: Array, high: Array) -> None:
    axes.fill_between(minutes, low, high, color=BLUE, alpha=0.25, linewidth=0)
    axes.plot(minutes, mean, color=BLUE, linewidth=1.2)
