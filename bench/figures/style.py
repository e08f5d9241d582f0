"""What all figures share: page sizes, type, and one colour and marker per estimator."""

from __future__ import annotations

import io
from typing import Any, NamedTuple

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import FixedLocator, FuncFormatter, NullFormatter

from bench.roster import LABELS, PRIOR, REFERENCE, label, ordered

INCH_MM = 25.4
COLUMN_MM = 89.0
PAGE_MM = 183.0

INK = "#1b1f24"
MUTED = "#6b7580"
FAINT = "#c9d0d6"
PAPER = "#ffffff"

MARKERS = 8
"""Along each line: enough to follow it where lines cross, few enough to see it."""

RC: dict[Any, Any] = {
    "font.family": "DejaVu Sans",
    "font.size": 8,
    "axes.labelsize": 8,
    "axes.titlesize": 8.5,
    "xtick.labelsize": 8,
    "ytick.labelsize": 8,
    "legend.fontsize": 8,
    "text.color": INK,
    "axes.edgecolor": MUTED,
    "axes.labelcolor": INK,
    "xtick.color": MUTED,
    "ytick.color": MUTED,
    "xtick.labelcolor": INK,
    "ytick.labelcolor": INK,
    "axes.linewidth": 0.6,
    "xtick.major.width": 0.6,
    "ytick.major.width": 0.6,
    "xtick.minor.width": 0.4,
    "ytick.minor.width": 0.4,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": FAINT,
    "grid.linewidth": 0.4,
    "legend.frameon": False,
    "figure.facecolor": PAPER,
    "axes.facecolor": "none",
    "svg.hashsalt": "twinbench",
    # Names are users': a channel called $x_ must not be read as a formula.
    "text.parse_math": False,
}
styled = matplotlib.rc_context(RC)
"""Decorator of every drawing function: the house style, without touching the user's settings."""


class Look(NamedTuple):
    """How one estimator is drawn."""

    colour: str
    marker: str


# Okabe and Ito's colour-blind-safe palette; the oracle in ink and the prior in grey because they are there to compare
# with; the mended filter as far as can be from all of them, the nominal one above all.
_LOOKS = {
    "oracle": Look(INK, "D"),
    "always_prior": Look("#5C5C5C", "*"),
    "nominal_ekf": Look("#E69F00", "s"),
    "nominal_ekf_mended": Look("#5A3CE0", "P"),
    "gru_kf": Look("#56B4E9", "^"),
    "lstm_rls": Look("#009E73", "v"),
    "deeponet": Look("#CC79A7", "X"),
    "pinn_ukf": Look("#0072B2", "p"),
    "deeponet_kalman": Look("#D55E00", "o"),
}
_SPARE = (Look("#8C6D31", "<"), Look("#7F7F7F", ">"), Look("#882255", "h"), Look("#44AA99", "d"))


def looks(names: list[str]) -> dict[str, Look]:
    """One look per estimator: fixed for the benchmark's own, spare ones in turn for any others."""
    others = [n for n in ordered(names) if n not in LABELS]
    spare = {n: _SPARE[i % len(_SPARE)] for i, n in enumerate(others)}
    return {n: _LOOKS[n] if n in LABELS else spare[n] for n in ordered(names)}


def canvas(width_mm: float, height_mm: float) -> Figure:
    """An empty figure of that printed size whose parts do not overlap."""
    figure = Figure(figsize=(width_mm / INCH_MM, height_mm / INCH_MM), layout="constrained")
    figure.get_layout_engine().set(w_pad=0.04, h_pad=0.04)  # type: ignore[union-attr, call-arg]
    return figure


def legend_handles(names: list[str], line: bool = False) -> list[Line2D]:
    """Legend entries in the fixed order: markers, or lines for trajectories."""
    handles = []
    for name, look in looks(names).items():
        style: dict[str, Any] = (
            {"linewidth": 1.6, "linestyle": line_style(name), "markersize": 4} if line
            else {"linestyle": "none", "markersize": 5}
        )
        style |= {"marker": look.marker, "markerfacecolor": face(name, look)}
        handles.append(Line2D([], [], color=look.colour, label=label(name), **style))
    return handles


def face(name: str, look: Look) -> str:
    """Marker fill: the reference's is hollow wherever estimators are drawn as markers."""
    return PAPER if name == REFERENCE else look.colour


def line_style(name: str) -> str:
    """Dashed for the reference and dotted for the prior, wherever estimators are drawn as lines."""
    return {REFERENCE: "--", PRIOR: ":"}.get(name, "-")


def line_of(name: str, look: Look, place: int, several: int, points: int) -> dict[str, Any]:
    """How an estimator's line is drawn: a marker now and then, each line's elsewhere, so that none needs colour."""
    every = max(points // MARKERS, 1)
    return {
        "color": look.colour, "linestyle": line_style(name), "marker": look.marker, "markersize": 3.6,
        "markerfacecolor": face(name, look), "markevery": (place * every // max(several, 1), every),
    }  # fmt: skip


def log_axis(axes: Axes, values: np.ndarray, axis: str = "y") -> None:
    """A logarithmic axis around the positive values, labelled with plain numbers."""
    positive = values[np.isfinite(values) & (values > 0)]
    low, high = (positive.min() / 1.4, positive.max() * 1.4) if positive.size else (0.1, 10.0)
    target = axes.yaxis if axis == "y" else axes.xaxis
    (axes.set_yscale if axis == "y" else axes.set_xscale)("log")
    (axes.set_ylim if axis == "y" else axes.set_xlim)(low, high)
    decades = np.log10(high / low)
    target.set_major_locator(
        FixedLocator(
            [
                digit * 10.0**power
                for power in range(int(np.floor(np.log10(low))), int(np.ceil(np.log10(high))))
                for digit in _digits(decades)
                if low <= digit * 10.0**power <= high
            ]
        )
    )
    target.set_major_formatter(FuncFormatter(lambda v, _: f"{v:,.10g}"))
    target.set_minor_formatter(NullFormatter())


def _digits(decades: float) -> tuple[float, ...]:
    """What is labelled within a decade: a handful of ticks in all."""
    if decades < 0.7:
        return (1, 1.5, 2, 3, 4, 5, 7)
    return (1, 2, 5) if decades < 1.6 else (1, 3) if decades < 2.6 else (1,)


def thin(count: int, most: int) -> np.ndarray:
    """Indices that keep at most ``most`` of ``count`` points, first and last among them."""
    return np.unique(np.linspace(0, count - 1, min(count, most)).round().astype(int))


@styled
def settle(figure: Figure) -> None:
    """Lay the figure out once for all formats: each would do it again, and it takes longer than drawing."""
    figure.draw_without_rendering()
    figure.set_layout_engine("none")


@styled
def png(figure: Figure) -> bytes:
    """The figure at 200 dpi; equal figures give equal bytes."""
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=200)
    return buffer.getvalue()


@styled
def svg(figure: Figure) -> str:
    """The figure as SVG text; equal figures give equal text."""
    buffer = io.StringIO()
    figure.savefig(buffer, format="svg", metadata={"Date": None, "Creator": None})
    return buffer.getvalue()
