"""A fleet drawn: the size of each effect on every machine, and how sizes went on each of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from twinbench.common.style import BLUE, FAINT, MUTED, PAGE_MM, VERMILION, canvas, styled
from twinbench.mismatch.fleet.evidence import likeliest
from twinbench.mismatch.fleet.verdict import Fleet
from twinbench.mismatch.mixture import Z90
from twinbench.mismatch.words import labelled

IN_A_ROW = 5
"""Machines side by side."""


@styled
def sizes_by_machine(fleet: Fleet, names: Sequence[str]) -> Figure:
    """One panel for each effect: its size on every machine with a 90 % interval, and the fleet's mean and scatter."""
    figure = canvas(PAGE_MM, 16.0 + 40.0 * len(names))
    grid = figure.subplots(len(names), 1, sharex=True, squeeze=False)[:, 0]
    shared = {c.name: c for c in fleet.common}
    odd = {o.machine for o in fleet.odd}
    for axes, name in zip(grid, names, strict=True):
        if name in shared:
            mean, scatter = shared[name].size.mean, shared[name].size.scatter
            axes.axhline(mean, color=MUTED, linewidth=0.8)
            axes.axhspan(mean - Z90 * scatter, mean + Z90 * scatter, color=FAINT, alpha=0.6, linewidth=0)
        for at, (machine, said) in enumerate(fleet.machines.items()):
            one = likeliest(said.known, name)
            if one is not None:
                size = one.sizes[name]
                color = VERMILION if machine in odd else BLUE
                axes.errorbar(at, size.mean, Z90 * size.sd, color=color, marker="o", markersize=4, linewidth=1.2)
        axes.set_title(name, loc="left")
        axes.set_ylabel(labelled("size", _unit(fleet, name)))
    grid[-1].set_xticks(range(len(fleet.machines)), list(fleet.machines), rotation=90)
    grid[-1].set_xlim(-0.7, len(fleet.machines) - 0.3)
    return figure


def _unit(fleet: Fleet, name: str) -> str:
    return next(said.units[name] for said in fleet.machines.values() if name in said.units)


@styled
def histories(fleet: Fleet, name: str) -> Figure:
    """Small multiples: an effect's size over time on each machine, in the recordings that were learnt from."""
    many = len(fleet.machines)
    columns = min(many, IN_A_ROW)
    rows = -(-many // columns)
    figure = canvas(PAGE_MM, 14.0 + 30.0 * rows)
    grid = figure.subplots(rows, columns, sharey=True, squeeze=False).ravel()
    odd = {o.machine for o in fleet.odd}
    figure.supxlabel("time, each from its first recording's beginning to its last one's end", fontsize="medium")
    figure.supylabel(labelled("size", _unit(fleet, name)), fontsize="medium")
    for axes, (machine, said) in zip(grid, fleet.machines.items(), strict=False):
        axes.set_title(machine, loc="left", color=VERMILION if machine in odd else MUTED)
        _history(axes, said.document["findings"], name, VERMILION if machine in odd else BLUE)
    for axes in grid[many:]:
        axes.set_visible(False)
    return figure


def _history(axes: Axes, findings: Sequence[Mapping[str, Any]], name: str, color: str) -> None:
    told = [f["history"] for f in findings if f["history"] and name in (f["mechanism"], f["best"])]
    axes.set_xticks([])
    if not told:
        axes.text(0.5, 0.5, "not found", ha="center", va="center", transform=axes.transAxes, color=MUTED)
        return
    points = told[0]["points"]
    at = np.arange(len(points))
    low, size, high = (np.array([p[end] for p in points]) for end in ("low", "size", "high"))
    axes.fill_between(at, low, high, color=color, alpha=0.2, linewidth=0)
    axes.plot(at, size, color=color, linewidth=1.2)
