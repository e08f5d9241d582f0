"""The paper's Figs. 3, 4 and 6c as in the paper: load ramps, flow parity, wear, and innovations."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from matplotlib.ticker import NullFormatter
from scipy.stats import chi2

from twinbench.bench.report.evidence import CHANNELS_READ, Example
from twinbench.bench.report.figures.looks import MARKERS, looks
from twinbench.bench.report.figures.tracks import MOST_POINTS, STATE_PANELS, TRUTH_STYLE, legend, states, track_panel
from twinbench.bench.roster import PROPOSED, REFERENCE, label, ordered
from twinbench.bench.statistics.coverage import nis_median_ratio
from twinbench.common.style import COLUMN_MM, FAINT, INK, MUTED, PAGE_MM, canvas, styled, thin
from twinbench.data.batch import Array
from twinbench.data.scenes import RAMP_NAMES

NIS_PANELS = {"normal": "normal operation", "fouling": "after abrupt fouling", "bias": "after a sensor's bias"}
NIS_LIMITS = (0.03, 300.0)
RAMP_ERRORS = (0.03, 1.7)
"""What the paper reports at most, by column of ``states``."""
SHADES = ("#08306b", "#2171b5", "#6baed6", "#41ab5d", "#006d2c")
"""One per load ramp, told apart by lightness as well."""
MARKS = ("o", "s", "^", "D", "v")


@styled
def ramps(scenes: Mapping[str, Example], column: int) -> Figure:
    """Fig. 3a and b: one state over the load ramps, and what the proposed method and the reference make of it.

    Args:
        column: of ``states``: 0 pressure in bar, 1 temperature in degC.
    """
    quantity, unit, error_unit = STATE_PANELS[column]
    claimed = RAMP_ERRORS[column]
    figure = canvas(PAGE_MM, 66.0)
    left, right = figure.subplots(1, 2)
    shown = {name: scenes[name] for name in RAMP_NAMES if name in scenes}
    for name, example in shown.items():
        shade = SHADES[RAMP_NAMES.index(name)]
        keep = thin(len(example.time_s), MOST_POINTS)
        seconds, true = example.time_s[keep], states(example.truth[keep])[:, column]
        left.plot(seconds, true, zorder=1.5, **TRUTH_STYLE)
        tracked = {n: states(np.asarray(t.mean[keep], dtype=float))[:, column] for n, t in example.tracks.items()}
        if REFERENCE in tracked:
            right.plot(seconds, tracked[REFERENCE] - true, color=INK, linewidth=0.6, linestyle=":")
        if PROPOSED in tracked:
            marked = {
                "color": shade,
                "linewidth": 1.2,
                "marker": MARKS[RAMP_NAMES.index(name)],
                "markersize": 3.6,
                "markevery": max(len(keep) // MARKERS, 1),
            }
            left.plot(seconds, tracked[PROPOSED], **marked)
            right.plot(seconds, tracked[PROPOSED] - true, **marked)
    for bound in (-claimed, claimed):
        right.axhline(bound, color=MUTED, linewidth=0.8, linestyle="--")
    right.axhline(0.0, color=FAINT, linewidth=0.6)
    left.set_title("trajectory (truth: broad grey)")
    right.set_title(f"estimate − truth (dashed: ±{claimed:g} {error_unit}; dotted: oracle)")
    left.set_ylabel(f"{quantity}, {unit}")
    right.set_ylabel(f"error, {error_unit}")
    for axes in (left, right):
        axes.set_xlabel("time, s")
        axes.set_xlim(0.0, next(iter(shown.values())).time_s[-1])
    return figure


@styled
def flow_parity(flow: Array) -> Figure:
    """Fig. 3c: density of estimated against true mass flow.

    Args:
        flow: (2, n) true and estimated mass flow in kg/s.
    """
    figure = canvas(COLUMN_MM, 80.0)
    axes = figure.subplots()
    true, estimated = 1e3 * flow
    ends = [float(flow.min()) * 1e3, float(flow.max()) * 1e3]
    square = (ends[0], ends[1], ends[0], ends[1])
    drawn = axes.hexbin(true, estimated, gridsize=60, cmap="cividis_r", norm=LogNorm(), mincnt=1, extent=square)
    axes.plot(ends, ends, color=INK, linewidth=0.6, linestyle="--")
    axes.text(0.05, 0.93, f"R² = {r_squared(flow):.4f}", transform=axes.transAxes)
    axes.set_xlabel("true mass flow, g/s")
    axes.set_ylabel("estimated mass flow, g/s")
    axes.set_aspect("equal")
    bar = figure.colorbar(drawn, ax=axes, label=f"points of {flow.shape[1]:,}", shrink=0.8)
    bar.ax.yaxis.set_major_formatter("{x:,.0f}")
    bar.minorticks_off()
    return figure


def r_squared(flow: Array) -> float:
    """Share of the variance of the true flow, row 0, that the estimate, row 1, explains.

    Args:
        flow: (2, n) true and estimated, in kg/s.
    """
    true, estimated = flow
    return 1.0 - float(np.sum((estimated - true) ** 2) / np.sum((true - true.mean()) ** 2))


@styled
def wear(example: Example, parameter: str) -> Figure:
    """Fig. 4: one health parameter over one scene, everybody's estimate, with the band of the proposed method."""
    figure = canvas(PAGE_MM, 78.0)
    axes = figure.subplots()
    track_panel(axes, parameter, example)
    axes.set_xlabel("time, min")
    legend(figure, ordered(example.tracks))
    return figure


@styled
def innovations(nis: Mapping[str, Array]) -> Figure:
    """Fig. 6c: normalised innovations squared, with the chi-square density and its central 95 %.

    Args:
        nis: (n,) dimensionless, by scene.
    """
    figure = canvas(PAGE_MM, 60.0)
    panels = figure.subplots(1, len(NIS_PANELS), sharey=True)
    bins = np.geomspace(*NIS_LIMITS, 60)
    middle = np.sqrt(bins[1:] * bins[:-1])
    expected = np.diff(chi2.cdf(bins, CHANNELS_READ))
    band = chi2.ppf([0.025, 0.975], CHANNELS_READ)
    for axes, (name, title) in zip(panels, NIS_PANELS.items(), strict=True):
        axes.axvspan(*band, color=FAINT, alpha=0.5, linewidth=0)
        if name in nis:
            values = nis[name]
            counts, _ = np.histogram(np.clip(values, *NIS_LIMITS), bins)
            axes.stairs(counts / len(values), bins, fill=True, color=looks([PROPOSED])[PROPOSED].colour, alpha=0.7)
            ratio = nis_median_ratio(values, CHANNELS_READ)
            axes.text(0.03, 0.9, f"median × {ratio:.2f}", transform=axes.transAxes)
        axes.plot(middle, expected, color=INK, linewidth=1.0, linestyle="--")
        axes.set_xscale("log")
        axes.xaxis.set_major_formatter("{x:g}")
        axes.xaxis.set_minor_formatter(NullFormatter())
        axes.set_title(title)
        axes.set_xlabel("NIS, three channels")
    panels[0].set_ylabel("share of updates per bin")
    figure.suptitle(f"{label(PROPOSED)}; dashed: chi-square density, grey: its central 95 %", fontsize=8)
    return figure
