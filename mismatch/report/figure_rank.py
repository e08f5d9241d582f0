"""What is likeliest: the ports by probability, the hypotheses by their evidence."""

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
from twinbench.mismatch.naming.answer import PLAIN
from twinbench.mismatch.report.hypotheses import ABSENT, CHOSEN, REFUSED, TRIED, hypotheses
from twinbench.mismatch.words import number
from twinbench.physics.simulator import Port

MOST_BARS = 12
NAME_LENGTH = 64
LIKELIEST = "A"
"""What the likeliest set is called where its names are too many to be told again in each line."""
HEIGHT = 0.62
LOOKS: dict[str, dict[str, Any]] = {
    CHOSEN: {"facecolor": BLUE, "edgecolor": BLUE},
    REFUSED: {"facecolor": PAPER, "edgecolor": BLUE, "hatch": "xxxx"},
    ABSENT: {"facecolor": INK, "edgecolor": INK},
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
def evidence(d: Diagnosis) -> Figure:
    """One bar per hypothesis, likeliest on top: what it gains over nothing, and twenty to one below the likeliest."""
    ranked = hypotheses(d)[:MOST_BARS]
    figure = canvas(PAGE_MM, 20.0 + 6.5 * len(ranked))
    axes = figure.subplots()
    # What is less likely than nothing has no bar: one to the left would say no more.
    gains = [max(h.gain, 0.0) for h in ranked]
    places = _bars(axes, labels([h.names for h in ranked]), gains, [h.standing for h in ranked])
    for y, gain, text in zip(places, gains, _gains([h.gain for h in ranked]), strict=True):
        _label(axes, y, gain, text)
    axes.axvline(max(gains) - PLAIN, color=MUTED, linewidth=0.8, linestyle=":")
    axes.set_xlim(0.0, 1.25 * max(*gains, PLAIN))
    axes.xaxis.set_major_locator(MaxNLocator(5))
    axes.xaxis.set_major_formatter(FuncFormatter(lambda v, _: f"{v:,.10g}"))
    axes.set_xlabel("evidence over nothing, nats")
    there = [standing for standing in LOOKS if standing != ABSENT and any(h.standing == standing for h in ranked)]
    handles: list[Patch | Line2D] = [Patch(linewidth=0.8, label=standing, **LOOKS[standing]) for standing in there]
    handles.append(
        Line2D([], [], color=MUTED, linewidth=0.8, linestyle=":", label="twenty times less likely than the likeliest")
    )
    figure.legend(handles=handles, loc="outside lower center", ncols=3, columnspacing=1.6)
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


def _gains(gains: Sequence[float]) -> list[str]:
    """What the likeliest gains, and how far the others lie behind it: large numbers that differ little read alike."""
    return [number(gains[0]), *(f"{number(gains[0] - gain)} behind" for gain in gains[1:])]


def _label(axes: Axes, y: float, x: float, text: str) -> None:
    axes.annotate(text, (x, y), xytext=(4, 0), textcoords="offset points", va="center", color=MUTED)


def labels(sets: Sequence[Sequence[str]]) -> list[str]:
    """What each set of names is called; where the first is too long for that, others by what they have beside it.

    A label that two sets share has its place in the ranking behind it.
    """
    first, long = sets[0], len(" + ".join(sets[0])) > NAME_LENGTH
    found = [f"{LIKELIEST}: {_short(first)}" if long else _short(first)]
    for names in sets[1:]:
        less, more = ([n for n in some if n not in other] for some, other in ((first, names), (names, first)))
        told = [(word, some) for word, some in (("less", less), ("with", more)) if some]
        if long and len(less) < len(first):
            found.append(f"{LIKELIEST} {', '.join(f'{word} {_short(some, len(told))}' for word, some in told)}")
        else:
            found.append(_short(names))
    return [f"{text} ({k})" if found.count(text) > 1 else text for k, text in enumerate(found, 1)]


def _short(names: Sequence[str], parts: int = 1) -> str:
    """The names joined, in one of so many parts of a line; where they are too many, how many more there are."""
    text, length = " + ".join(names), NAME_LENGTH // parts
    if len(text) <= length:
        return text
    shown = next(k for k in range(len(names), -1, -1) if len(" + ".join(names[:k])) <= length - 12)
    if shown:
        return f"{' + '.join(names[:shown])} + {len(names) - shown} more"
    return f"{len(names)} effects" if len(names) > 1 else text[: length - 1] + "…"
