"""How honest the 95 % intervals are: per quantity and per operating regime."""

from __future__ import annotations

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from twinbench.bench.report.figures.looks import face, legend_handles, looks
from twinbench.bench.roster import label, ordered
from twinbench.bench.statistics.subject import Subject
from twinbench.common.style import FAINT, INK, MUTED, PAGE_MM, canvas, styled


@styled
def coverage_by_quantity(coverage: pd.DataFrame, subject: Subject) -> Figure:
    """One panel per estimator, one row per estimated quantity: how often the interval held the truth.

    Args:
        coverage: what ``bench.statistics.coverage.coverage_table`` returns.
        subject: what is estimated.
    """
    everywhere = coverage[(coverage["regime"] == "all") & (coverage["quantity"] != "mean")]
    names = ordered(everywhere["estimator"].unique())
    rows = {quantity.name: row for row, quantity in enumerate(subject.quantities)}
    figure = canvas(PAGE_MM, 74.0)
    panels = figure.subplots(1, len(names), sharex=True, sharey=True, squeeze=False)[0]
    for axes, (name, look) in zip(panels, looks(names).items(), strict=True):
        own = everywhere[everywhere["estimator"] == name]
        _expected(axes, own, "x")
        mean, spread = _points(own)
        axes.errorbar(
            mean,
            own["quantity"].map(rows).to_numpy(dtype=float),
            xerr=spread,
            linestyle="none",
            linewidth=1.0,
            color=look.colour,
            marker=look.marker,
            markerfacecolor=face(name, look),
            markersize=3.8,
        )
        axes.set_title(label(name).replace(" ", "\n", 1).replace("-", "-\n", 1), fontsize=8)
        axes.set_xlim(-4, 104)
        axes.set_xticks([0, 50, 95], ["0", "50", "95"])
        axes.axhline(len(rows) - len(subject.health) - 0.5, color=MUTED, linewidth=0.5)
        axes.tick_params(axis="y", length=0)
    panels[0].set_yticks(range(len(rows)), [quantity.label for quantity in subject.quantities])
    panels[0].set_ylim(len(rows) - 0.5, -0.5)
    figure.supxlabel("share of time inside the 95 % interval, %", fontsize=8)
    return figure


@styled
def coverage_by_regime(coverage: pd.DataFrame) -> Figure:
    """Coverage in each operating regime, mean of all quantities.

    Args:
        coverage: what ``bench.statistics.coverage.coverage_table`` returns.
    """
    mean = coverage[(coverage["quantity"] == "mean") & (coverage["regime"] != "all")]
    names = ordered(mean["estimator"].unique())
    regimes = list(mean["regime"].unique())
    offsets = np.linspace(-0.33, 0.33, len(names)) if len(names) > 1 else np.zeros(1)
    figure = canvas(PAGE_MM, 72.0)
    axes = figure.subplots()
    _expected(axes, mean, "y")
    for offset, (name, look) in zip(offsets, looks(names).items(), strict=True):
        own = mean[mean["estimator"] == name]
        place = own["regime"].map(regimes.index).to_numpy(dtype=float)
        level, spread = _points(own)
        axes.errorbar(
            place + offset,
            level,
            yerr=spread,
            linestyle="none",
            linewidth=0.9,
            color=look.colour,
            marker=look.marker,
            markerfacecolor=face(name, look),
            markersize=4.2,
        )
    for edge in np.arange(len(regimes) - 1) + 0.5:
        axes.axvline(edge, color=FAINT, linewidth=0.6)
    axes.set_xticks(range(len(regimes)), [regime.replace("_", "\n") for regime in regimes])
    axes.set_xlim(-0.5, len(regimes) - 0.5)
    least = float(np.nanmin(mean[["coverage_pct", "low"]].to_numpy(dtype=float)))
    axes.set_ylim(5.0 * np.floor((least - 1.0) / 5.0), 101.0)
    axes.tick_params(axis="x", length=0)
    axes.grid(visible=False, axis="x")
    axes.set_ylabel("share of time inside\nthe 95 % interval, %")
    figure.legend(handles=legend_handles(names), loc="outside lower center", ncols=4, columnspacing=1.6)
    return figure


def _points(rows: pd.DataFrame) -> tuple[np.ndarray, np.ndarray]:
    """Coverage (n,) and how far its interval reaches below and above (2, n), in per cent."""
    mean = rows["coverage_pct"].to_numpy(dtype=float)
    bounds = rows[["low", "high"]].to_numpy(dtype=float).T
    return mean, np.nan_to_num([mean - bounds[0], bounds[1] - mean]).clip(0)


def _expected(axes: Axes, rows: pd.DataFrame, axis: str) -> None:
    """The nominal level, and the band in which an exact filter would lie."""
    line, span = (axes.axvline, axes.axvspan) if axis == "x" else (axes.axhline, axes.axhspan)
    span(rows["expected_low"].min(), rows["expected_high"].max(), color=FAINT, alpha=0.55, linewidth=0)
    line(float(rows["expected_pct"].max()), color=INK, linewidth=0.9, linestyle="--")
