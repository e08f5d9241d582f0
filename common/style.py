"""What all figures share: page sizes, type, colours, axes and file formats."""

from __future__ import annotations

import io
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure
from matplotlib.layout_engine import PlaceHolderLayoutEngine
from matplotlib.ticker import FixedLocator, FuncFormatter, NullFormatter

INCH_MM = 25.4
COLUMN_MM = 89.0
PAGE_MM = 183.0
MOST_POINTS = 800
"""Points of a line: more cannot be told apart at page width."""
PNG_DPI = 200
ZERO_C_K = 273.15
"""0 °C on the axes of those who think in °C."""

INK = "#1b1f24"
MUTED = "#6b7580"
FAINT = "#c9d0d6"
PAPER = "#ffffff"
BLUE = "#0072B2"
VERMILION = "#D55E00"
"""Two of Okabe and Ito's colours, which also the colour-blind tell apart."""

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
    # Text of a PDF that can be searched and copied.
    "pdf.fonttype": 42,
    # Names are users': a channel called $x_ must not be read as a formula.
    "text.parse_math": False,
}
styled = matplotlib.rc_context(RC)
"""Decorator of every drawing function: the house style, without touching the user's settings."""


def canvas(width_mm: float, height_mm: float) -> Figure:
    """An empty figure of that printed size whose parts do not overlap."""
    figure = Figure(figsize=(width_mm / INCH_MM, height_mm / INCH_MM), layout="constrained")
    figure.get_layout_engine().set(w_pad=0.04, h_pad=0.04)  # type: ignore[union-attr, call-arg]
    return figure


def log_axis(axes: Axes, values: np.ndarray, axis: str = "y") -> None:
    """A logarithmic axis around the positive values, labelled with plain numbers.

    Args:
        values: what is drawn, of any shape, in any unit; positive ones count.
    """
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
    if _settled(figure):
        before = figure.dpi
        figure.set_dpi(PNG_DPI)
        FigureCanvasAgg(figure).print_png(buffer)
        figure.set_dpi(before)
    else:
        figure.savefig(buffer, format="png", dpi=PNG_DPI)
    return buffer.getvalue()


@styled
def svg(figure: Figure) -> str:
    """The figure as SVG text; equal figures give equal text."""
    buffer = io.StringIO()
    about = {"Date": None, "Creator": None}
    if _settled(figure):
        before = figure.dpi
        FigureCanvasSVG(figure).print_svg(buffer, metadata=about)
        figure.set_dpi(before)
    else:
        figure.savefig(buffer, format="svg", metadata=about)
    return buffer.getvalue()


def _settled(figure: Figure) -> bool:
    """Does it need no layout any more? To print it then takes half of what ``savefig`` takes, which draws twice."""
    return isinstance(figure.get_layout_engine(), PlaceHolderLayoutEngine)


@styled
def pdf(figure: Figure, title: str) -> bytes:
    """The figure as a PDF of one page; equal figures give equal bytes."""
    buffer = io.BytesIO()
    figure.savefig(buffer, format="pdf", metadata={"Title": title, "Creator": "Twinbench", "CreationDate": None})
    return buffer.getvalue()
