"""How honest the 95 % intervals are: per quantity and per operating regime."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from twinbench.bench.report.figures.looks import face, legend_handles, looks
from twinbench.bench.roster import ordered
from twinbench.bench.statistics.subject import Subject
from twinbench.common.style import FAINT, INK, PAGE_MM, canvas, styled

LONGEST_WORDS, LABEL_PT = 12, 7.0
"""Characters of a label in a line, and their size in points: as many and as large as fit below one of ten groups."""


@styled
def coverage_by_quantity(coverage: pd.DataFrame, subject: Subject) -> Figure:
    """How often the interval of each quantity held the truth.

    Args:
        coverage: what ``bench.statistics.coverage.coverage_table`` returns.
        subject: what is estimated.
    """
    everywhere = coverage[(coverage["regime"] == "all") & (coverage["quantity"] != "mean")]
    groups = {q.name: textwrap.fill(q.label, LONGEST_WORDS) for q in subject.quantities}
    return _grouped(everywhere, "quantity", groups)


@styled
def coverage_by_regime(coverage: pd.DataFrame) -> Figure:
    """Coverage in each operating regime, mean of all quantities.

    Args:
        coverage: what ``bench.statistics.coverage.coverage_table`` returns.
    """
    mean = coverage[(coverage["quantity"] == "mean") & (coverage["regime"] != "all")]
    return _grouped(mean, "regime", {regime: regime.replace("_", "\n") for regime in mean["regime"].unique()})


def _grouped(rows: pd.DataFrame, by: str, groups: Mapping[str, str]) -> Figure:
    """Points of all estimators, group by group, with the nominal level and the band in which an exact filter would lie.

    Args:
        rows: of ``coverage_table``, one per estimator and group.
        by: the column that holds the groups.
        groups: what each is called.
    """
    names, place = ordered(rows["estimator"].unique()), {group: i for i, group in enumerate(groups)}
    offsets = np.linspace(-0.38, 0.38, len(names)) if len(names) > 1 else np.zeros(1)
    figure = canvas(PAGE_MM, 80.0)
    axes = figure.subplots()
    axes.axhspan(rows["expected_low"].min(), rows["expected_high"].max(), color=FAINT, alpha=0.55, linewidth=0)
    axes.axhline(float(rows["expected_pct"].max()), color=INK, linewidth=0.9, linestyle="--")
    for offset, (name, look) in zip(offsets, looks(names).items(), strict=True):
        own = rows[rows["estimator"] == name]
        level = own["coverage_pct"].to_numpy(dtype=float)
        low, high = own[["low", "high"]].to_numpy(dtype=float).T
        axes.errorbar(
            own[by].map(place).to_numpy(dtype=float) + offset,
            level,
            yerr=np.nan_to_num([level - low, high - level]).clip(0),
            linestyle="none",
            linewidth=0.9,
            color=look.colour,
            marker=look.marker,
            markerfacecolor=face(name, look),
            markersize=3.8,
        )
    for edge in np.arange(len(groups) - 1) + 0.5:
        axes.axvline(edge, color=FAINT, linewidth=0.6)
    axes.set_xticks(range(len(groups)), list(groups.values()))
    axes.set_xlim(-0.5, len(groups) - 0.5)
    least = float(np.nanmin(rows[["coverage_pct", "low"]].to_numpy(dtype=float)))
    bottom = 5.0 * np.floor((least - 1.0) / 5.0)
    axes.set_ylim(bottom, 100.0 + (100.0 - bottom) / 30.0)  # room for half a marker
    axes.tick_params(axis="x", length=0, labelsize=LABEL_PT)
    axes.grid(visible=False, axis="x")
    axes.set_ylabel("share of time inside\nthe 95 % interval, %")
    figure.legend(handles=legend_handles(names), loc="outside lower center", ncols=4, columnspacing=1.6)
    return figure
