"""Figures of the suite: power beside the ideal observer's, and how far stated probabilities can be trusted."""

from __future__ import annotations

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from twinbench.common.style import BLUE, COLUMN_MM, INK, MUTED, PAGE_MM, VERMILION, canvas, log_axis, styled
from twinbench.proof.concealed.gates import wilson

_KINDS = {"tuned": (BLUE, "o"), "untuned": (VERMILION, "s"), "random": ("#009E73", "^")}
"""Colour and marker of the kinds of machines."""


@styled
def power_figure(curves: pd.DataFrame) -> Figure:
    """Right names or classes over the distance from "no effect", pooled over effects, by kind of machine.

    Args:
        curves: ``power.csv`` of one engine.
    """
    figure = canvas(PAGE_MM, 62.0)
    axes = figure.subplots()
    pooled = curves[curves["machine"] == "all"]
    for kind, (colour, marker) in _KINDS.items():
        own = pooled[pooled["kind"] == kind].sort_values("distance")
        if len(own):
            label = f"{kind} machines, {own['cases'].sum()} cases"
            axes.plot(own["distance"], own["right"], color=colour, marker=marker, markersize=3, label=label)
            axes.plot(own["distance"], own["ideal"], color=colour, linestyle="--")
    log_axis(axes, pooled["distance"].to_numpy(dtype=float), axis="x")
    axes.set_ylim(-0.02, 1.02)
    axes.set_xlabel('distance from "no effect", noise sds')
    axes.set_ylabel("right name or class, rate")
    if len(pooled):
        axes.plot([], [], color=INK, linestyle="--", label="ideal observer of these")
        figure.legend(loc="outside right center")
    return figure


@styled
def reliability_figure(bins: pd.DataFrame) -> Figure:
    """The rate of right single names over the probability that was stated for them, with 95 % intervals (Wilson).

    Args:
        bins: ``reliability.csv`` of one engine.
    """
    figure = canvas(COLUMN_MM, COLUMN_MM)
    axes = figure.subplots()
    axes.plot([0.0, 1.0], [0.0, 1.0], color=MUTED, linestyle=":")
    right = bins["right"].to_numpy(dtype=float)
    bounds = np.array([wilson(r * n, n) for r, n in zip(right, bins["cases"], strict=True)]).reshape(-1, 2)
    off = np.abs(bounds - right[:, None]).T
    axes.errorbar(bins["stated"], right, yerr=off, color=INK, marker="o", markersize=3, linestyle="")
    # Only what is likely is said: on axes from nothing on, all of it lies in a corner.
    shown = np.concatenate((bins["stated"], bounds[:, 0], [0.9]))
    least = float(np.floor(10.0 * shown.min()) / 10.0)
    margin = 0.02 * (1.0 - least)
    axes.set_xlim(least - margin, 1.0 + margin)
    axes.set_ylim(least - margin, 1.0 + margin)
    axes.set_xlabel("stated probability")
    axes.set_ylabel("right, rate")
    return figure
