"""What is likeliest: the ports by probability, the explanations by what they gain."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import FuncFormatter, MaxNLocator

from twinbench.common.style import BLUE, INK, MUTED, PAGE_MM, PAPER, canvas, styled
from twinbench.mismatch.diagnosis import Diagnosis
from twinbench.mismatch.report.ranking import CHOSEN, REFUSED, RIVAL, TRIED, ranking
from twinbench.physics.simulator import Port

MOST_BARS = 12
NAME_LENGTH = 64
HEIGHT = 0.62
LOOKS: dict[str, dict[str, Any]] = {
    CHOSEN: {"facecolor": BLUE, "edgecolor": BLUE},
    REFUSED: {"facecolor": PAPER, "edgecolor": BLUE, "hatch": "xxxx"},
    RIVAL: {"facecolor": PAPER, "edgecolor": BLUE, "hatch": "////"},
    TRIED: {"facecolor": "#aab4bd", "edgecolor": "#aab4bd"},
}


@styled
def ports(shares: Sequence[tuple[Port, float]]) -> Figure:
    """One bar per port, likeliest on top."""
    figure = canvas(PAGE_MM, 14.0 + 6.5 * len(shares))
    axes = figure.subplots()
    places = _bars(axes, [str(port) for port, _ in shares], [100.0 * p for _, p in shares], [CHOSEN] * len(shares))
    for y, (_, p) in zip(places, shares, strict=True):
        _label(axes, y, 100.0 * p, f"{100.0 * p:.0f} %")
    axes.set_xlim(0.0, 112.0)
    axes.set_xticks(range(0, 101, 20))
    axes.set_xlabel("probability, %")
    return figure


@styled
def explanations(d: Diagnosis) -> Figure:
    """One bar per explanation, best on top, and the gain that it had to pass; none that only adds to the accepted."""
    ranked = [e for e in ranking(d) if not (d.chosen and set(e.names) > set(d.chosen.names))][:MOST_BARS]
    figure = canvas(PAGE_MM, 20.0 + 6.5 * len(ranked))
    axes = figure.subplots()
    # Noise may have a set lose a little; a bar to the left would say nothing.
    gains = [max(e.gain, 0.0) for e in ranked]
    places = _bars(axes, [_short(e.names) for e in ranked], gains, [e.standing for e in ranked])
    widest = max([e.gain for e in ranked] + [e.needed for e in ranked])
    for y, e in zip(places, ranked, strict=True):
        axes.plot([e.needed] * 2, [y - 0.7 * HEIGHT, y + 0.7 * HEIGHT], color=INK, linewidth=1.6)
        _label(axes, y, max(e.gain, e.needed), f"{e.gain:,.0f}")
    axes.set_xlim(0.0, 1.18 * widest)
    axes.xaxis.set_major_locator(MaxNLocator(5))
    axes.xaxis.set_major_formatter(FuncFormatter(lambda v, _: f"{v:,.10g}"))
    axes.set_xlabel("gain, log-likelihood units (twice)")
    there = [standing for standing in LOOKS if any(e.standing == standing for e in ranked)]
    handles: list[Patch | Line2D] = [Patch(linewidth=0.8, label=standing, **LOOKS[standing]) for standing in there]
    handles.append(Line2D([], [], color=INK, linewidth=1.6, label="gain that it had to pass"))
    figure.legend(handles=handles, loc="outside lower center", ncols=4, columnspacing=1.6)
    return figure


def _bars(axes: Axes, names: Sequence[str], values: Sequence[float], looks: Sequence[str]) -> list[float]:
    """Horizontal bars from the top down; returns the heights at which they stand."""
    places = [float(len(names) - 1 - k) for k in range(len(names))]
    for y, value, look in zip(places, values, looks, strict=True):
        axes.barh(y, value, height=HEIGHT, linewidth=0.8, **LOOKS[look])
    axes.set_yticks(places, names)
    axes.set_ylim(-0.6, len(names) - 0.4)
    axes.grid(visible=False, axis="y")
    axes.tick_params(axis="y", length=0)
    return places


def _label(axes: Axes, y: float, x: float, text: str) -> None:
    axes.annotate(text, (x, y), xytext=(4, 0), textcoords="offset points", va="center", color=MUTED)


def _short(names: Sequence[str]) -> str:
    """The names joined; where they are too many, how many more there are."""
    text = " + ".join(names)
    if len(text) <= NAME_LENGTH:
        return text
    shown = next(k for k in range(len(names), -1, -1) if len(" + ".join(names[:k])) <= NAME_LENGTH - 12)
    return f"{' + '.join(names[:shown])} + {len(names) - shown} more" if shown else text[: NAME_LENGTH - 1] + "…"
