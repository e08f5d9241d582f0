"""Fig. 6: pressure error under noise and dropout (a), calibration beyond the envelope (b); and after sensor faults."""

from __future__ import annotations

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from seaborn import heatmap

from twinbench.bench.report.table_formats import number
from twinbench.bench.roster import ABLATION, PROPOSED, is_ablation, label, ordered
from twinbench.bench.statistics.subject import PAPERS
from twinbench.common.style import COLUMN_MM, INK, MUTED, PAGE_MM, canvas, styled
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
    """Health error from a minute after sensor faults on, estimators down, kinds of fault across.

    Of each kind it is the mean over the sensors that have it, one at a time. ``none`` is the same time without a fault.
    """
    names = [n for n in ordered(table["estimator"].unique()) if not is_ablation(n)]
    kinds = list(dict.fromkeys(PAPERS.kind_and_sensor(f.name)[0] for f in FAULTS))
    means = {n: _means(table, n, "health_after_fault_pct") for n in names}
    by_kind = {n: of.groupby(lambda condition: PAPERS.kind_and_sensor(condition)[0]).mean() for n, of in means.items()}
    values = pd.DataFrame({label(n): of.reindex([UNDISTURBED.name, *kinds]) for n, of in by_kind.items()}).T
    figure = canvas(PAGE_MM, 6.0 * len(names) + 34.0)
    axes = figure.subplots()
    axes.grid(visible=False)
    heatmap(
        values,
        cmap="cividis_r",
        annot=values.map(lambda v: number(v, 2) if np.isfinite(v) else "–"),
        fmt="",
        annot_kws={"fontsize": 7},
        cbar_kws={"label": "health error, % of a life"},
        ax=axes,
    )
    axes.axvline(1.0, color=INK, linewidth=1.2)
    axes.tick_params(axis="x", rotation=45)
    for tick in axes.get_xticklabels():
        tick.set(ha="right", rotation_mode="anchor")
    axes.set(xlabel="", ylabel="")
    return figure
