"""Fig. 6: pressure error under noise and dropout (a), calibration beyond the envelope (b); and after sensor faults."""

from __future__ import annotations

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from seaborn import heatmap

from twinbench.bench.report.figures.looks import face, legend_handles, looks
from twinbench.bench.roster import ABLATION, PROPOSED, is_ablation, label, ordered
from twinbench.bench.statistics.subject import PAPERS
from twinbench.common.style import COLUMN_MM, FAINT, INK, MUTED, PAGE_MM, canvas, styled
from twinbench.data.disturb import BEYOND, CONDITIONS, DROPOUT_LEVELS, FAULTS, NOISE_LEVELS, UNDISTURBED

RIGHT_PCT = 95.0
TREATMENTS = {
    "": ("trust and wider forecasts", "#D55E00", "o", "-"),
    "trust_alone": ("trust alone", "#0072B2", "s", "--"),
    "extrapolation_alone": ("wider forecasts alone", "#009E73", "^", "-."),
    "no_trust": ("neither", INK, "D", ":"),
}
"""By ablation: what is done with loads outside the training envelope, and how it is drawn."""


def _means(table: pd.DataFrame, estimator: str, metric: str) -> pd.Series:
    """Mean over sequences by condition."""
    rows = table[(table["estimator"] == estimator) & (table["metric"] == metric)]
    return rows.groupby("condition")["value"].mean()


@styled
def noise_and_dropout(table: pd.DataFrame) -> Figure:
    """Fig. 6a: the proposed method's pressure error, noise down, dropout across.

    Args:
        table: ``robustness.csv``.
    """
    means = _means(table, PROPOSED, "p_nrmse_pct")
    names = {(c.corruption.noise, c.corruption.dropout): c.name for c in CONDITIONS if c.group == "noise and dropout"}
    values = pd.DataFrame(
        [[means.get(names[n, d], np.nan) for d in DROPOUT_LEVELS] for n in NOISE_LEVELS],
        [f"{n:g} ×" for n in NOISE_LEVELS],
        [f"{d:.0%}" for d in DROPOUT_LEVELS],
    )
    figure = canvas(COLUMN_MM, 62.0)
    axes = figure.subplots()
    axes.grid(visible=False)
    heatmap(
        values,
        vmin=0.0,
        cmap="cividis_r",
        annot=values.map(lambda v: f"{v:.2f}" if np.isfinite(v) else "–"),
        fmt="",
        annot_kws={"fontsize": 7},
        cbar_kws={"label": "pressure error, %"},
        ax=axes,
    )
    axes.tick_params(axis="y", rotation=0)
    axes.set_xlabel("samples that are missing")
    axes.set_ylabel("sensor noise")
    return figure


@styled
def beyond_the_envelope(table: pd.DataFrame) -> Figure:
    """Fig. 6b: coverage and health error against how far loads reach beyond training, by treatment."""
    figure = canvas(PAGE_MM, 62.0)
    left, right = figure.subplots(1, 2)
    names = {c.beyond: c.name for c in CONDITIONS if c.group == "envelope"}
    for treatment, (says, colour, marker, line) in TREATMENTS.items():
        estimator = f"{PROPOSED}{ABLATION}{treatment}" if treatment else PROPOSED
        for axes, metric in ((left, "coverage95_pct"), (right, "health_life_pct")):
            means = _means(table, estimator, metric)
            values = [means.get(names[b], np.nan) for b in BEYOND]
            axes.plot(
                [100.0 * b for b in BEYOND],
                values,
                color=colour,
                marker=marker,
                linestyle=line,
                linewidth=1.4,
                markersize=4.5,
                label=says,
            )
    left.axhline(RIGHT_PCT, color=MUTED, linewidth=0.8, linestyle="--")
    left.set_ylabel("95 % interval holds, %")
    right.set_ylabel("health error, % of a life")
    for axes in (left, right):
        axes.set_xlabel("speeds and pressure ratios reach farther by, %")
    figure.legend(*left.get_legend_handles_labels(), loc="outside lower center", ncols=4)
    return figure


@styled
def after_faults(table: pd.DataFrame) -> Figure:
    """Health error from a minute after each sensor fault on, over that without the fault; 1 is recovered."""
    names = [n for n in ordered(table["estimator"].unique()) if not is_ablation(n)]
    figure = canvas(PAGE_MM, 6.0 * len(FAULTS) + 22.0)
    axes = figure.subplots()
    rows = np.arange(len(FAULTS))
    offsets = np.linspace(-0.32, 0.32, len(names)) if len(names) > 1 else np.zeros(1)
    for offset, (name, look) in zip(offsets, looks(names).items(), strict=True):
        means = _means(table, name, "health_after_fault_pct")
        share = np.array([means.get(f.name, np.nan) for f in FAULTS]) / means.get(UNDISTURBED.name, np.nan)
        axes.plot(
            share,
            rows + offset,
            linestyle="none",
            color=look.colour,
            marker=look.marker,
            markersize=4.5,
            markerfacecolor=face(name, look),
            label=label(name),
        )
    axes.axvline(1.0, color=INK, linewidth=0.8, linestyle="--")
    for edge in rows[:-1] + 0.5:
        axes.axhline(edge, color=FAINT, linewidth=0.6)
    axes.set_yticks(rows, [PAPERS.condition_label(f.name) for f in FAULTS])
    axes.set_ylim(len(FAULTS) - 0.5, -0.5)
    axes.grid(visible=False, axis="y")
    axes.set_xlabel("health error a minute after the fault, over that without it")
    figure.legend(handles=legend_handles(names), loc="outside lower center", ncols=4)
    return figure
