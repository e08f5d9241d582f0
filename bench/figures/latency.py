"""How long one update takes."""

from __future__ import annotations

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from bench.figures.style import INK, MUTED, PAGE_MM, canvas, face, log_axis, looks, styled
from bench.roster import label, ordered
from data.batch import SAMPLE_PERIOD_S

PERCENTILES = ("p50_us", "p95_us", "p99_us", "max_us")


@styled
def latency_percentiles(latency: pd.DataFrame) -> Figure:
    """Median, 95th and 99th percentile and maximum of one update, against the 20 Hz sample period.

    Args:
        latency: columns estimator, mode, implementation, window, p50_us, p95_us, p99_us, max_us.
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
    period_us = 1e6 * SAMPLE_PERIOD_S
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
        Line2D([], [], color=INK, linewidth=0.9, linestyle="--", label="sample period, 50 ms"),
    ]
    figure.legend(handles=handles, loc="outside lower center", ncols=4, columnspacing=1.4)
    return figure


def _sorted(latency: pd.DataFrame) -> pd.DataFrame:
    place = {name: i for i, name in enumerate(ordered(latency["estimator"]))}
    keyed = latency.assign(place=latency["estimator"].map(place))
    return keyed.sort_values(["place", "mode", "implementation", "window"]).reset_index(drop=True)


def _names(rows: pd.DataFrame) -> list[str]:
    """The estimator, and whatever of mode, implementation and window tells its rows apart."""
    varying = [c for c in ("mode", "implementation", "window") if rows[c].nunique() > 1]
    return [
        ", ".join([label(row["estimator"]), *(str(row[c]) if c != "window" else f"window {row[c]}" for c in varying)])
        for _, row in rows.iterrows()
    ]
