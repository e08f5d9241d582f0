"""Estimates over time on test sequences: states (Fig. 3) and health parameters (Fig. 4)."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from twinbench.bench.report.evidence import Example
from twinbench.bench.report.figures.looks import legend_handles, line_of, looks
from twinbench.bench.roster import PROPOSED, REFERENCE, TRIVIAL, label, ordered
from twinbench.bench.statistics.subject import PAPERS, Subject
from twinbench.common.style import INK, MOST_POINTS, MUTED, PAGE_MM, ZERO_C_K, canvas, styled, thin
from twinbench.data.batch import Array
from twinbench.machines.compressor import COMPRESSOR, ESTIMATED

STATE_PANELS = (("pressure", "bar", "bar"), ("temperature", "°C", "K"), ("mass flow", "g/s", "g/s"))
LONGEST_LABEL = 28
"""Characters of an axis label in a line: as many as fit beside a panel."""
TRUTH_STYLE: dict[str, Any] = {"color": "#aab4bd", "linewidth": 4.0, "solid_capstyle": "round"}
"""A broad road below the estimates, so that it shows where they leave it."""


def states(estimated: Array) -> Array:
    """(M, 3) discharge pressure in bar, gas temperature in degC, mass flow in g/s from (M, 10).

    Args:
        estimated: (M, 10) in the quantities' units, order ESTIMATED.
    """
    healthy_sensor = estimated.copy()
    healthy_sensor[..., ESTIMATED.index("T_bias_K")] = 0.0
    return COMPRESSOR.observe(healthy_sensor) * [1.0, 1.0, 1e3] - [0.0, ZERO_C_K, 0.0]


def _banded(names: list[str]) -> str:
    """Whose band is drawn: the proposed method's if it ran, else the last one's."""
    return PROPOSED if PROPOSED in names else names[-1]


@styled
def state_trajectories(example: Example) -> Figure:
    """Fig. 3 on one test sequence: truth and estimates on the left, estimate minus truth on the right."""
    # The prior's states are a mean over all training: beside others they would only stretch the axes.
    everyone = ordered(example.tracks)
    names = [n for n in everyone if n not in TRIVIAL] or everyone[:1]
    keep = thin(len(example.time_s), MOST_POINTS)
    minutes, true = example.time_s[keep] / 60.0, states(example.truth[keep])
    figure = canvas(PAGE_MM, 128.0)
    panels = figure.subplots(3, 2, sharex=True)
    banded = _banded(names)
    for name, look in looks(names).items():
        track = example.tracks[name]
        mean, low, high = (states(np.asarray(a[keep], dtype=float)) for a in (track.mean, track.low, track.high))
        width = 1.3 if name in (REFERENCE, banded) else 0.8
        for row in range(3):
            left, right = panels[row]
            style = {"linewidth": width, **line_of(name, look, names.index(name), len(names), len(keep))}
            left.plot(minutes, mean[:, row], **style)
            right.plot(minutes, mean[:, row] - true[:, row], **style)
            if name == banded:
                right.fill_between(
                    minutes,
                    low[:, row] - true[:, row],
                    high[:, row] - true[:, row],
                    color=look.colour,
                    alpha=0.25,
                    linewidth=0,
                )
    for row, (quantity, unit, error_unit) in enumerate(STATE_PANELS):
        left, right = panels[row]
        left.plot(minutes, true[:, row], zorder=1.5, **TRUTH_STYLE)
        left.set_ylabel(f"{quantity}, {unit}")
        right.set_ylabel(f"error, {error_unit}")
        right.axhline(0, color=INK, linewidth=0.6)
    _finish(figure, panels, example.sequence, names, minutes)
    return figure


@styled
def parameter_tracking(panels: Mapping[str, Example], subject: Subject = PAPERS) -> Figure:
    """Fig. 4: each kind of degradation on one test sequence that has it, by health parameter.

    Args:
        panels: by name of the parameter.
        subject: what is estimated.
    """
    figure = canvas(PAGE_MM, 22.0 + 52.0 * ((len(panels) + 1) // 2))
    grid = figure.subplots((len(panels) + 1) // 2, 2, squeeze=False).ravel()
    everyone: set[str] = set()
    for axes, (parameter, example) in zip(grid, panels.items(), strict=False):
        everyone |= set(example.tracks)
        track_panel(axes, parameter, example, subject)
        axes.set_title(example.sequence, color=MUTED, loc="right")
        axes.set_xlabel("time, min")
    for axes in grid[len(panels) :]:
        axes.set_visible(False)
    legend(figure, ordered(everyone))
    return figure


def track_panel(axes: Axes, parameter: str, example: Example, subject: Subject = PAPERS) -> None:
    """One health parameter of one sequence: truth, everybody's estimate, one band.

    Args:
        axes: to draw in.
        parameter: its name.
        example: the sequence.
        subject: what is estimated.
    """
    column = [quantity.name for quantity in subject.quantities].index(parameter)
    keep = thin(len(example.time_s), MOST_POINTS)
    minutes = example.time_s[keep] / 60.0
    names = ordered(example.tracks)
    banded = _banded(names)
    true = example.truth[keep, column]
    for name, look in looks(names).items():
        mean, low, high = (np.asarray(a[keep, column], dtype=float) for a in example.tracks[name])
        axes.plot(
            minutes,
            mean,
            linewidth=1.3 if name in (REFERENCE, banded) else 0.8,
            **line_of(name, look, names.index(name), len(names), len(keep)),
        )
        if name == banded:
            axes.fill_between(minutes, low, high, color=look.colour, alpha=0.25, linewidth=0)
    axes.plot(minutes, true, zorder=1.5, **TRUTH_STYLE)
    axes.set_ylabel(textwrap.fill(subject.quantities[column].axis_label, LONGEST_LABEL))
    axes.set_xlim(minutes[0], minutes[-1])


def _finish(figure: Figure, panels: np.ndarray, sequence: str, names: list[str], minutes: Array) -> None:
    for axes in panels[-1]:
        axes.set_xlabel(f"time in {sequence}, min")
        axes.set_xlim(minutes[0], minutes[-1])
    panels[0, 0].set_title("trajectory")
    panels[0, 1].set_title("estimate − truth")
    figure.align_ylabels(panels)
    legend(figure, names)


def legend(figure: Figure, names: list[str]) -> None:
    """Below the figure: truth, the estimators, whose band is drawn."""
    banded = _banded(names)
    handles = [
        Line2D([], [], label="truth", **TRUTH_STYLE),
        *legend_handles(names, line=True),
        Patch(color=looks(names)[banded].colour, alpha=0.22, linewidth=0, label=f"{label(banded)}, 95 %"),
    ]
    figure.legend(handles=handles, loc="outside lower center", ncols=4, columnspacing=1.4)
