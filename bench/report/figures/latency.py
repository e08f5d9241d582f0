"""How long one update takes, and what it buys (Fig. 7c)."""

from __future__ import annotations

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from twinbench.bench.report.figures.looks import face, legend_handles, looks
from twinbench.bench.report.main_table import quickest
from twinbench.bench.roster import PROPOSED, UNRANKED, label, ordered
from twinbench.bench.statistics.summary import LIFE, Summary
from twinbench.common.style import COLUMN_MM, INK, MUTED, PAGE_MM, canvas, log_axis, styled

PERCENTILES = ("p50_us", "p95_us", "p99_us", "max_us")


@styled
def latency_percentiles(latency: pd.DataFrame, period_s: float) -> Figure:
    """Median, 95th and 99th percentile and maximum of one update, against the sample period.

    Args:
        latency: columns estimator, mode, implementation, window, p50_us, p95_us, p99_us, max_us.
        period_s: the machine's sample period.
    """
    rows = _sorted(latency)
    look = looks(list(rows["estimator"]))
    figure = canvas(PAGE_MM * 0.8, 24.0 + 6.5 * len(rows))
    axes = figure.subplots()
    times_us = rows[list(PERCENTILES)].to_numpy(dtype=float)
    for y, (name, (p50, p95, p99, largest)) in enumerate(zip(rows["estimator"], times_us, strict=True)):
        colour, marker = look[name]
        axes.hlines(y, p50, p99, color=colour, linewidth=3.2, alpha=0.45)
        axes.hlines(y, p99, largest, color=colour, linewidth=0.8)
        axes.plot(p50, y, marker, color=colour, markerfacecolor=face(name, look[name]), markersize=5)
        axes.plot([p95, p99], [y, y], "|", color=colour, markersize=8, markeredgewidth=1.2)
        axes.plot(largest, y, ".", color=colour, markersize=4)
    period_us = 1e6 * period_s
    axes.axvline(period_us, color=INK, linewidth=0.9, linestyle="--")
    log_axis(axes, np.append(times_us.ravel(), period_us), "x")
    axes.set_yticks(range(len(rows)), _names(rows))
    axes.set_ylim(len(rows) - 0.4, -0.6)
    axes.tick_params(axis="y", length=0)
    axes.grid(visible=False, axis="y")
    axes.set_xlabel("time of one update, µs")
    handles = [
        Line2D([], [], color=MUTED, marker="o", markersize=5, linestyle="none", label="median"),
        Line2D([], [], color=MUTED, marker="|", markersize=8, linestyle="none", label="95th and 99th percentile"),
        Line2D([], [], color=MUTED, marker=".", markersize=4, linestyle="none", label="maximum"),
        Line2D([], [], color=INK, linewidth=0.9, linestyle="--", label=f"sample period, {1e3 * period_s:g} ms"),
    ]
    figure.legend(handles=handles, loc="outside lower center", ncols=4, columnspacing=1.4)
    return figure


@styled
def decomposition(stages: dict[str, float]) -> Figure:
    """Fig. 7a: microseconds of each stage of an update."""
    figure = canvas(COLUMN_MM, 0.5 * COLUMN_MM)
    axes = figure.subplots()
    names, times_us = list(stages), list(stages.values())
    bars = axes.barh(names, times_us, color=looks([PROPOSED])[PROPOSED].colour, height=0.6)
    axes.bar_label(bars, fmt="%.1f", padding=3)
    axes.invert_yaxis()
    axes.set_xlim(0.0, 1.15 * max(times_us))
    axes.tick_params(axis="y", length=0)
    axes.grid(visible=False, axis="y")
    axes.set_xlabel(f"time in one update, µs (in all {sum(times_us):.0f})")
    return figure


@styled
def window_lengths(latency: pd.DataFrame) -> Figure:
    """Fig. 7b: time of an update by the length of the window.

    Args:
        latency: columns window, p50_us, p95_us, p99_us, of one form in one mode.
    """
    rows = latency.sort_values("window")
    figure = canvas(COLUMN_MM, 0.6 * COLUMN_MM)
    axes = figure.subplots()
    places, colour = range(len(rows)), looks([PROPOSED])[PROPOSED].colour
    axes.vlines(places, rows["p50_us"], rows["p99_us"], color=colour, linewidth=3.2, alpha=0.45)
    axes.plot(places, rows["p50_us"], "o", color=colour, markersize=5, label="median")
    axes.plot(places, rows["p95_us"], "_", color=colour, markersize=9, label="95th percentile")
    axes.plot(places, rows["p99_us"], "_", color=colour, markersize=9, markeredgewidth=2.0, label="99th percentile")
    axes.set_xticks(places, [str(window) for window in rows["window"]])
    axes.set_ylim(0.0, 1.15 * rows["p99_us"].max())
    axes.set_xlabel("samples in the window")
    axes.set_ylabel("time of one update, µs")
    figure.legend(loc="outside lower center", ncols=3)
    return figure


@styled
def accuracy_and_time(summary: Summary, latency: pd.DataFrame) -> Figure:
    """Fig. 7c: error against the time of one update; a line joins those that none other beats in both."""
    times = quickest(latency, "p50_us")
    names = [n for n in summary.estimators if n in times]
    asked = {"mean filtered error, %": summary.subject.state_errors, "error of health, % of life": (LIFE,)}
    figure = canvas(PAGE_MM, 0.85 * COLUMN_MM)
    for axes, (says, metrics) in zip(figure.subplots(1, len(asked)), asked.items(), strict=True):
        points = {n: (times[n], float(np.mean([summary.value(n, m).mean for m in metrics]))) for n in names}
        points = {n: at for n, at in points.items() if np.isfinite(at).all()}
        front = pareto({n: at for n, at in points.items() if n not in UNRANKED})
        axes.plot(*zip(*(points[n] for n in front), strict=True), color=MUTED, linewidth=0.8, linestyle="--")
        for name, look in looks(list(points)).items():
            axes.plot(*points[name], look.marker, color=look.colour, markerfacecolor=face(name, look), markersize=6)
        for axis, values in (("x", [x for x, _ in points.values()]), ("y", [y for _, y in points.values()])):
            log_axis(axes, np.array(values), axis)
        axes.set_xlabel("median time of one update, µs")
        axes.set_ylabel(says)
    figure.legend(handles=legend_handles(names), loc="outside lower center", ncols=4, columnspacing=1.6)
    return figure


def pareto(points: dict[str, tuple[float, float]]) -> list[str]:
    """Who is beaten by nobody both in the first and in the second, in order of the first."""
    front: list[str] = []
    for name in sorted(points, key=lambda n: points[n]):
        if not front or points[name][1] < points[front[-1]][1]:
            front.append(name)
    return front


def _sorted(latency: pd.DataFrame) -> pd.DataFrame:
    place = {name: i for i, name in enumerate(ordered(latency["estimator"]))}
    keyed = latency.assign(place=latency["estimator"].map(place))
    return keyed.sort_values(["place", "mode", "implementation", "window"]).reset_index(drop=True)


def _names(rows: pd.DataFrame) -> list[str]:
    """The estimator, and whatever of mode, implementation and window tells its rows apart."""
    varying = [c for c in ("mode", "implementation") if rows[c].nunique() > 1]
    several = rows.duplicated(["estimator", *varying], keep=False)
    names = [", ".join([label(row["estimator"]), *(str(row[c]) for c in varying)]) for _, row in rows.iterrows()]
    return [
        f"{name}, window {window}" if more else name
        for name, window, more in zip(names, rows["window"], several, strict=True)
    ]
