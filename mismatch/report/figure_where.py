"""Where the mismatch lives: over time, and over what drives the machine."""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure, FigureBase
from matplotlib.lines import Line2D

from twinbench.common.style import INK, MOST_POINTS, MUTED, PAGE_MM, PAPER, canvas, log_axis, styled, thin
from twinbench.mismatch.place import bracketed
from twinbench.mismatch.report.figure_fit import AFTER, BEFORE
from twinbench.mismatch.report.replays import Replay, level
from twinbench.mismatch.verdict import Verdict
from twinbench.mismatch.words import labelled, spoken, time_unit
from twinbench.physics.simulator import Array, Port, Simulator

MOST_RECORDINGS = 4
DRAWN_PIECES = 24
"""Pieces of a recording, over time."""
BINS = 8
"""Bins of an input, equally full."""
MOST_PANELS = 6
WIDE_AXIS = 8.0
"""Errors above so many times the noise are drawn on a logarithmic scale."""
BEFORE_POINTS = BEFORE | {"marker": "s", "markersize": 4, "markerfacecolor": PAPER}
AFTER_POINTS = AFTER | {"marker": "o", "markersize": 4}
LEVEL = "error / noise"


@styled
def over_time(learnt: Sequence[Replay], verdict: Verdict, sd: Array) -> Figure:
    """Course of the force at the first finding's port, if one can act there, above the error, per recording.

    Args:
        sd: (ny,) standard deviation of the noise of block means, in the outputs' units.
    """
    figure = canvas(PAGE_MM, 14.0 + 42.0 * (2 if verdict.located else 1))
    draw_over_time(figure, learnt, verdict, sd)
    return figure


def draw_over_time(figure: FigureBase, learnt: Sequence[Replay], verdict: Verdict, sd: Array) -> None:
    """As ``over_time``, into a figure or a part of one.

    Args:
        sd: (ny,) standard deviation of the noise of block means, in the outputs' units.
    """
    # The recordings in which it shows most, in their own order.
    order = sorted(range(len(learnt)), key=lambda r: -np.nan_to_num(level(learnt[r].before, sd)))[:MOST_RECORDINGS]
    located = verdict.located
    grid = figure.subplots(2 if located else 1, len(order), sharex="col", sharey="row", squeeze=False)
    for column, r in enumerate(sorted(order)):
        track = learnt[r].track
        scale, unit = time_unit(float(track.time_s[-1] - track.time_s[0]))
        _pieces(grid[-1, column], learnt[r], scale, sd)
        if located:
            axes, (time_s, force) = grid[0, column], located.force[r]
            drawn = thin(len(time_s), MOST_POINTS)
            axes.plot(time_s[drawn] / scale, force[drawn], color=INK, linewidth=0.9)
            axes.axhline(0.0, color=MUTED, linewidth=0.6)
        grid[0, column].set_title(track.name, loc="left")
        grid[-1, column].set_xlabel(f"time, {unit}")
        onsets = [o for f in verdict.findings for o in f.onsets if o.recording == track.name]
        for since_s in {o.since_s for o in onsets if o.since_s is not None}:
            for axes in grid[:, column]:
                axes.axvline(since_s / scale, color=INK, linewidth=1.2, linestyle=":")
    if located:
        port = located.port
        word = "force" if port.place in ("balance", "flux") else "offset"
        grid[0, 0].set_ylabel(f"{word} at\n{port},\n{_force_unit(verdict.diagnosis.simulator, port)}")
    grid[-1, 0].set_ylabel(LEVEL)
    _level_axis(grid[-1])
    figure.align_ylabels(grid[:, 0])
    _legend(figure, learnt)


def _pieces(axes: Axes, replay: Replay, scale: float, sd: Array) -> None:
    parts = np.array_split(np.arange(len(replay.before)), DRAWN_PIECES)
    middle = np.array([replay.track.block_time_s[p].mean() for p in parts]) / scale
    axes.axhline(1.0, color=MUTED, linewidth=0.8)
    axes.plot(middle, [level(replay.before[p], sd) for p in parts], **(BEFORE_POINTS | {"markersize": 2.5}))
    if replay.after is not None:
        axes.plot(middle, [level(replay.after[p], sd) for p in parts], **(AFTER_POINTS | {"markersize": 2.5}))


def _force_unit(simulator: Simulator, port: Port) -> str:
    unit = port.variable_of(simulator).unit
    return spoken(f"{bracketed(unit)}/s" if port.place == "balance" else unit)


@styled
def over_regime(shown: Sequence[Replay], verdict: Verdict, sd: Array) -> Figure:
    """Error over each input, and over each output that a named regime bounds.

    Args:
        sd: (ny,) standard deviation of the noise of block means, in the outputs' units.
    """
    simulator = verdict.diagnosis.simulator
    names = [v.name for v in (*simulator.inputs, *simulator.outputs)]
    bounds = [bound for f in verdict.findings for bound in regime_bounds(f.regime, names)]
    named = {name for name, _ in bounds}
    n = len(simulator.inputs)
    wanted = [i for i in range(n) if simulator.inputs[i].name in named]
    wanted += [i for i in range(n) if i not in wanted]
    wanted += [n + i for i, v in enumerate(simulator.outputs) if v.name in named]
    wanted = sorted(wanted[:MOST_PANELS])
    over = np.concatenate([np.concatenate((r.track.u[r.track.starts], r.track.means), axis=1) for r in shown])
    before = np.concatenate([r.before for r in shown])
    after = np.concatenate([r.before if r.after is None else r.after for r in shown])
    columns = min(3, len(wanted))
    rows = -(-len(wanted) // columns)
    figure = canvas(PAGE_MM, 14.0 + 46.0 * rows)
    grid = figure.subplots(rows, columns, sharey=True, squeeze=False).ravel()
    for axes, i in zip(grid, wanted, strict=False):
        v = (*simulator.inputs, *simulator.outputs)[i]
        groups = equally_full(over[:, i])
        middle = [float(np.median(over[g, i])) for g in groups]
        axes.axhline(1.0, color=MUTED, linewidth=0.8)
        axes.plot(middle, [level(before[g], sd) for g in groups], **BEFORE_POINTS)
        if shown[0].after is not None:
            axes.plot(middle, [level(after[g], sd) for g in groups], **AFTER_POINTS)
        for name, value in bounds:
            if name == v.name:
                axes.axvline(value, color=INK, linewidth=1.2, linestyle=":")
        axes.set_xlabel(labelled(v.name, v.unit))
        axes.tick_params(labelleft=True)
    for axes in grid[len(wanted) :]:
        axes.set_visible(False)
    for axes in grid[::columns]:
        axes.set_ylabel(LEVEL)
    _level_axis(grid)
    _legend(figure, shown)
    return figure


def regime_bounds(regime: str, names: Sequence[str]) -> list[tuple[str, float]]:
    """The names and thresholds in a regime's words: ``a > 1.5 and b <= 3``."""
    any_of = "|".join(re.escape(name) for name in sorted(names, key=len, reverse=True))
    return [(name, float(value)) for name, value in re.findall(rf"({any_of}) (?:<=|>) (\S+)", regime)]


def equally_full(values: Array, bins: int = BINS) -> list[np.ndarray]:
    """Indices of the finite values, sorted into bins of about the same number; equal values stay together.

    Args:
        values: (n,) in any unit; NaN means missing.
        bins: at most so many.
    """
    finite = values[np.isfinite(values)]
    distinct = np.unique(finite)
    if len(distinct) <= bins:
        return [np.flatnonzero(values == value) for value in distinct]
    edges = np.unique(np.quantile(finite, np.linspace(0.0, 1.0, bins + 1)[1:-1]))
    place = np.where(np.isfinite(values), np.digitize(values, edges), -1)
    return [np.flatnonzero(place == k) for k in range(len(edges) + 1) if (place == k).any()]


def _level_axis(panels: np.ndarray) -> None:
    """The shared scale of panels: from zero, or logarithmic where the noise would be too small to see."""
    ends = np.array([end for axes in panels for end in (axes.dataLim.y0, axes.dataLim.y1)])
    ends = ends[np.isfinite(ends)]
    if len(ends) and ends.max() > WIDE_AXIS:
        log_axis(panels[0], ends)
    else:
        panels[0].set_ylim(0.0, 1.1 * max(1.1, *ends))


def _legend(figure: FigureBase, shown: Sequence[Replay]) -> None:
    both = shown[0].after is not None
    handles = [Line2D([], [], label="before, calibrated" if both else "calibrated", **BEFORE_POINTS)]
    if both:
        handles.append(Line2D([], [], label="after", **AFTER_POINTS))
    handles.append(Line2D([], [], color=MUTED, linewidth=0.8, label="nothing but noise"))
    figure.legend(handles=handles, loc="outside lower center", ncols=3, columnspacing=1.6)
