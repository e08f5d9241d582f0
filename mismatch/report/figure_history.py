"""How large effects were over time."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from twinbench.common.style import BLUE, FAINT, PAGE_MM, canvas, styled
from twinbench.mismatch.findings import Finding
from twinbench.mismatch.history.history import History
from twinbench.mismatch.words import labelled, probable, time_unit


@styled
def sizes_over_time(findings: Sequence[Finding]) -> Figure:
    """One panel for each finding that has a history."""
    told = [(f.mechanism or f.best, f.history) for f in findings if f.history]
    figure = canvas(PAGE_MM, 10.0 + 46.0 * len(told))
    grid = figure.subplots(len(told), 1, squeeze=False)[:, 0]
    for axes, (name, history) in zip(grid, told, strict=True):
        draw_history(axes, history)
        axes.set_title(
            f"{name}: {history.likeliest}, probability {probable(history.odds[history.likeliest])}", loc="left"
        )
    return figure


def draw_history(axes: Axes, history: History) -> None:
    """A size with its interval, recording by recording."""
    axis = history.axis
    scale, unit = time_unit(axis.span_s)
    for r, name in enumerate(axis.names):
        mine = np.flatnonzero(axis.of == r)
        time = axis.along_s[mine] / scale
        size, low, high = (np.array([getattr(history.points[q], end) for q in mine]) for end in ("size", "low", "high"))
        axes.fill_between(time, low, high, color=BLUE, alpha=0.2, linewidth=0)
        axes.plot(time, size, color=BLUE, linewidth=1.2)
        axes.axvline(time[0], color=FAINT, linewidth=0.8)
        axes.annotate(name, (time[0], 1.0), (2, -2), ("data", "axes fraction"), "offset points", va="top", fontsize=7)
    axes.set_xlabel(f"time, {unit}" if axis.clock else f"time, recordings one after the other, {unit}")
    axes.set_ylabel(labelled("size", history.size.unit))
