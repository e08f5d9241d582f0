"""Fig. 5: how the estimators compare: errors with intervals (a), mean ranks (b), error distributions (c)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from seaborn import violinplot

from twinbench.bench.report.figures.looks import face, legend_handles, looks
from twinbench.bench.roster import PROPOSED, REFERENCE, label, ordered
from twinbench.bench.statistics.summary import Summary
from twinbench.common.style import COLUMN_MM, FAINT, INK, MUTED, PAGE_MM, PAPER, canvas, log_axis, styled, thin

RANKS_IN_FULL = 10
"""Up to so many ranks each has its number on the line; beyond, every second one or fewer, so that they stay apart."""
LEAST_SHOWN_PCT = 0.01
"""Smaller parameter errors are drawn as this: no maintenance decision hangs on a hundredth of a per cent."""


@styled
def error_bars(summary: Summary) -> Figure:
    """Fig. 5a: state errors of all estimators with 95 % intervals; the reference as a line in each group."""
    names, subject = list(summary.estimators), summary.subject
    groups = [o.says.removesuffix(" in degC").replace(" ", "\n", 1) for o in subject.outputs]
    asked = {"filtered state": subject.state_errors, "60 s open loop": subject.forecast_errors}
    figure = canvas(PAGE_MM, 72.0)
    panels = figure.subplots(1, len(asked), sharey=True)
    shown = [m for metrics in asked.values() for m in metrics]
    for axes, (title, metrics) in zip(panels, asked.items(), strict=True):
        for group, metric in enumerate(metrics):
            _group(axes, group, names, summary, metric)
        axes.set_xticks(range(len(groups)), groups)
        axes.set_xlim(-0.5, len(groups) - 0.5)
        axes.tick_params(axis="x", length=0)
        axes.grid(visible=False, axis="x")
        axes.set_title(title)
        for edge in np.arange(len(groups) - 1) + 0.5:
            axes.axvline(edge, color=FAINT, linewidth=0.6)
    log_axis(panels[0], np.array([v for m in shown for e in names for v in summary.value(e, m)[:3]]))
    panels[0].set_ylabel("RMSE, % of mean level")
    drawn = [e for e in names if any(summary.value(e, m).mean > 0 for m in shown)]
    figure.legend(handles=legend_handles(drawn), loc="outside lower center", ncols=4, columnspacing=1.6)
    return figure


def _group(axes: Axes, group: int, names: list[str], summary: Summary, metric: str) -> None:
    offsets = np.linspace(-0.34, 0.34, len(names)) if len(names) > 1 else np.zeros(1)
    for offset, (name, look) in zip(offsets, looks(names).items(), strict=True):
        mean, low, high = summary.value(name, metric)[:3]
        if not mean > 0:
            continue
        # An interval may be unknown (one sequence) or reach below zero, which a log axis cannot show.
        spread = np.nan_to_num([[mean - max(low, 1e-3 * mean)], [high - mean]]).clip(0)
        axes.errorbar(
            group + offset,
            mean,
            yerr=spread,
            color=look.colour,
            marker=look.marker,
            markersize=5,
            markerfacecolor=face(name, look),
            linewidth=1.2,
            capsize=2,
            capthick=0.9,
        )
        if name == REFERENCE:
            axes.hlines(mean, group - 0.44, group + 0.44, color=INK, linewidth=0.7, linestyles="--", zorder=1)


@styled
def critical_difference(
    mean_ranks: Mapping[str, float], cliques: Sequence[Sequence[str]], cd: float, says: str
) -> Figure:
    """Fig. 5b: mean ranks on a line, best on the left; bars join estimators that cannot be told apart.

    After J. Demsar, Statistical comparisons of classifiers over multiple data sets, JMLR 7 (2006).

    Args:
        mean_ranks: mean rank over the sequences; 1 is best.
        cliques: groups of estimators without a significant difference.
        cd: Nemenyi's critical difference, drawn as a ruler; NaN: no ruler.
        says: what was ranked and which test made the groups, printed below.
    """
    names = sorted(mean_ranks, key=lambda n: (mean_ranks[n], n))
    left, right = names[: (len(names) + 1) // 2], names[(len(names) + 1) // 2 :][::-1]
    bars = sorted((sorted(mean_ranks[n] for n in clique) for clique in cliques if len(clique) > 1), key=lambda r: r[0])
    first_row = 0.75 + 0.35 * len(bars)
    depth = first_row + 0.75 * max(len(left), 1)
    top = max(len(names), 2)
    margin = 0.35 * (top - 1) / 2

    figure = canvas(COLUMN_MM * 1.5, 22.0 + 7.5 * depth)
    axes = figure.subplots()
    axes.set_axis_off()
    axes.set_xlim(1 - margin - 0.45, top + margin + 0.45)
    axes.set_ylim(depth + 0.9, -1.4)
    axes.hlines(0, 1, top, color=INK, linewidth=0.9)
    for rank in range(1, top + 1):
        axes.vlines(rank, -0.12, 0, color=INK, linewidth=0.9)
    for rank in range(1, top + 1, 1 + (top - 1) // RANKS_IN_FULL):
        axes.text(rank, -0.2, str(rank), ha="center", va="bottom")
    if np.isfinite(cd) and cd <= top - 1:
        axes.hlines(-1.0, 1, 1 + cd, color=INK, linewidth=0.9)
        axes.vlines([1, 1 + cd], -1.1, -0.9, color=INK, linewidth=0.9)
        axes.text(1 + cd + 0.08, -1.0, f"critical difference {cd:.2f}", ha="left", va="center")
    for row, ranks in enumerate(bars):
        axes.hlines(0.4 + 0.35 * row, ranks[0] - 0.05, ranks[-1] + 0.05, color=FAINT, linewidth=4, zorder=1)
    look = looks(names)
    for side, members in ((-1, left), (1, right)):
        end = 1 - margin if side < 0 else top + margin
        for row, name in enumerate(members):
            y = first_row + 0.75 * row
            axes.plot([mean_ranks[name]] * 2 + [end], [0, y, y], color=look[name].colour, linewidth=1.1)
            axes.plot(mean_ranks[name], 0, look[name].marker, color=look[name].colour, markersize=5, clip_on=False)
            weight = "bold" if name == PROPOSED else "normal"
            axes.text(
                end + 0.08 * side,
                y,
                f"{label(name)}  {mean_ranks[name]:.2f}",
                ha="right" if side < 0 else "left",
                va="center",
                weight=weight,
            )
    axes.text((1 + top) / 2, depth + 0.55, says, color=MUTED, ha="center", va="center")
    return figure


@styled
def parameter_violins(samples: Mapping[str, np.ndarray], per_sequence: Mapping[str, np.ndarray]) -> Figure:
    """Fig. 5c: distribution of the mean relative parameter error over all test time.

    Args:
        samples: (n,) per estimator, the four-parameter mean relative error in % at every stored instant.
        per_sequence: (S,) per estimator, the time mean of each sequence in %, drawn as dots.
    """
    names = [n for n in ordered(samples) if np.isfinite(samples[n]).any()]
    drawn = {n: np.clip(samples[n][np.isfinite(samples[n])], LEAST_SHOWN_PCT, None) for n in names}
    figure = canvas(COLUMN_MM * 1.25, 16.0 + 9.5 * max(len(names), 1))
    axes = figure.subplots()
    violinplot(
        {n: _thinned(v) for n, v in drawn.items()},
        palette=[look.colour for look in looks(names).values()],
        order=names,
        orient="h",
        log_scale=True,
        density_norm="width",
        width=0.84,
        cut=0,
        inner=None,
        linewidth=0.7,
        alpha=0.45,
        ax=axes,
    )
    for row, name in enumerate(names):
        p5, q1, median, q3, p95 = np.quantile(drawn[name], [0.05, 0.25, 0.5, 0.75, 0.95])
        if name == REFERENCE:
            axes.axvline(median, color=INK, linewidth=0.7, linestyle="--", zorder=0.5)
        axes.hlines(row, p5, p95, color=INK, linewidth=0.8)
        axes.barh(row, q3 - q1, left=q1, height=0.16, color=INK)
        axes.plot(median, row, "o", markersize=3.6, markerfacecolor=PAPER, markeredgecolor=INK, markeredgewidth=0.8)
        dots = per_sequence.get(name, np.empty(0))
        axes.plot(dots, np.full(dots.size, row + 0.3), "|", color=INK, markersize=5, markeredgewidth=0.8)
    log_axis(axes, np.concatenate([np.quantile(v, [0.005, 0.995]) for v in drawn.values()] or [np.ones(1)]), "x")
    axes.set_yticks(range(len(names)), [label(n) for n in names])
    axes.set_ylim(len(names) - 0.4, -0.6)
    axes.tick_params(axis="y", length=0)
    axes.grid(visible=False, axis="y")
    axes.set_xlabel("mean relative parameter error, %")
    return figure


def _thinned(values: np.ndarray) -> np.ndarray:
    """At most 3,000 of the values, as many as a density needs; without two in a thousand at either end, hairs."""
    ordinary = np.sort(values)[values.size // 500 : values.size - values.size // 500]
    return ordinary[thin(ordinary.size, 3000)]
