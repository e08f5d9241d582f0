"""A verdict on one sheet of paper: the sentence, the findings, the fit on what was held out, and when it differs."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from textwrap import wrap
from typing import Any, NamedTuple

from matplotlib.figure import Figure, SubFigure

from twinbench.common.page import write_bytes
from twinbench.common.style import INCH_MM, INK, MUTED, PAGE_MM, pdf, styled
from twinbench.mismatch.findings import Finding
from twinbench.mismatch.report.figure_fit import draw_fit
from twinbench.mismatch.report.figure_where import draw_over_time
from twinbench.mismatch.report.figures import failed
from twinbench.mismatch.report.replays import most_telling, replays
from twinbench.mismatch.verdict import Verdict
from twinbench.mismatch.words import probable

A4_MM = (210.0, 297.0)
TOP_MM, BOTTOM_MM = 12.0, 16.0
"""Margins; what made the sheet stands in the lower one. The others are half of what a page's figures leave of A4."""
TEXT_MM = 130.0
"""Height that text may take; the rest of the sheet is the figures'."""
MM_PER_PT = INCH_MM / 72.0
LETTER = 0.6
"""Mean width of a letter over the size of its type: a little more than DejaVu Sans has."""
LEADING = 1.35
"""Height of a line over the size of its type."""
HEADLINE_LINES = 10
"""Of the sentence; the rest of a longer one is left to the report."""
COLUMNS_MM = {"finding": 58.0, "kind": 26.0, "where": 38.0, "size, 90 % interval": 47.0, "probability": 14.0}
"""Widths of the table's columns."""
TITLE: dict[str, Any] = {"x": 0.0, "ha": "left", "size": 9, "weight": "bold"}


class Line(NamedTuple):
    """One line of text: its size in points, and pieces of it, each from how many mm of the left on."""

    size: float
    pieces: Sequence[tuple[float, str]]
    look: Mapping[str, Any] = {}


def write_sheet(verdict: Verdict, made: Mapping[str, Any], out: Path) -> None:
    """Write ``report.pdf`` into a folder; figures that fail are said to be missing.

    Args:
        made: the provenance of the verdict, as ``verdict.json`` holds it.

    Raises:
        CannotWrite: the folder cannot be written to.
    """
    try:
        drawn = pdf(sheet(verdict, made), verdict.says)
    except Exception as error:
        drawn = pdf(sheet(verdict, made, failed(error)), verdict.says)
    write_bytes(out / "report.pdf", drawn)


@styled
def sheet(verdict: Verdict, made: Mapping[str, Any], missing: str = "") -> Figure:
    """The sheet, A4.

    Args:
        made: the provenance of the verdict, as ``verdict.json`` holds it.
        missing: why there are no figures; empty if there are.
    """
    width, height = A4_MM
    figure = Figure(figsize=(width / INCH_MM, height / INCH_MM), layout="constrained")
    room = height - TOP_MM - BOTTOM_MM
    rect = ((1.0 - PAGE_MM / width) / 2.0, BOTTOM_MM / height, PAGE_MM / width, room / height)
    figure.get_layout_engine().set(w_pad=0.04, h_pad=0.04, rect=rect)  # type: ignore[union-attr, call-arg]
    lines = _lines(verdict)
    if missing:
        lines += [Line(8.0, [(0.0, text)]) for text in _wrapped(f"Not drawn: {missing}", PAGE_MM, 8.0)]
    text_mm = _write(figure, lines, TOP_MM)
    _write(figure, _footer(verdict, made), height - 0.75 * BOTTOM_MM)
    if not missing:
        heights = (text_mm, *[0.5 * (room - text_mm)] * 2)
        _, middle, bottom = figure.subfigures(3, 1, squeeze=False, height_ratios=heights).ravel()
        _draw(verdict, middle, bottom)
    return figure


def _draw(verdict: Verdict, middle: SubFigure, bottom: SubFigure) -> None:
    """The fit in the middle, when it differs below."""
    d = verdict.diagnosis
    shown, sd = replays(d), d.noise_sd
    held = [r for r in shown if r.held_out] or shown
    replay, channels = most_telling(held, sd, most=1)
    if channels:
        which = "held out" if replay.held_out else "fitted"
        middle.suptitle(f"Measured and simulated, {which}: {replay.track.name}", **TITLE)
        draw_fit(middle, replay, channels, d.simulator.outputs, sd, d.spikes)
    bottom.suptitle("When they differ, in the recordings that were learnt from", **TITLE)
    draw_over_time(bottom, [r for r in shown if not r.held_out], verdict, sd)


def _lines(verdict: Verdict) -> list[Line]:
    """All text above the figures, cut where there is no room for more."""
    kicker = f"Where do the simulator {verdict.diagnosis.simulator.name} and its machine differ? Verdict: "
    lines = [Line(8.0, [(0.0, kicker + verdict.verdict)], {"color": MUTED})]
    headline = _wrapped(verdict.says, PAGE_MM, 11.0)
    if len(headline) > HEADLINE_LINES:
        headline = [*headline[: HEADLINE_LINES - 1], "…"]
    lines += [Line(11.0, [(0.0, text)], {"weight": "bold"}) for text in headline]
    lines.append(Line(7.5, []))
    if not verdict.findings:
        return [*lines, Line(8.0, [(0.0, "No effect had to be added.")]), Line(7.5, [])]
    lines.append(_row(COLUMNS_MM, {"color": MUTED}))
    for k, finding in enumerate(verdict.findings):
        rows = _rows(finding)
        if sum(map(_height, [*lines, *rows])) > TEXT_MM:
            lines.append(Line(7.5, [(0.0, f"and {len(verdict.findings) - k} more, which report.html has")]))
            break
        lines += rows
    return [*lines, Line(7.5, [])]


def _rows(f: Finding) -> list[Line]:
    """A finding's lines in the table."""
    best = f"without a name; {f.best} explains it best" if f.best else "without a name"
    cells = (
        " or ".join(f.names) or best,
        f.kind,
        f"{f.port or ''}" + (f", from {f.since_s:.0f} s on" if f.since_s is not None else ""),
        f.parameters[0].words() if f.parameters else "–",
        probable(f.probability),
    )
    columns = [_wrapped(cell, mm - 2.0, 7.5) for cell, mm in zip(cells, COLUMNS_MM.values(), strict=True)]
    deep = max(map(len, columns))
    each = (_row([column[k] if k < len(column) else "" for column in columns]) for k in range(deep))
    return [Line(2.0, []), *each]


def _row(cells: Iterable[str], look: Mapping[str, Any] | None = None) -> Line:
    starts = [sum([*COLUMNS_MM.values()][:k]) for k in range(len(COLUMNS_MM))]
    return Line(7.5, list(zip(starts, cells, strict=True)), look or {})


def _footer(verdict: Verdict, made: Mapping[str, Any]) -> list[Line]:
    d = verdict.diagnosis
    learnt, held = (", ".join(t.name for t in tracks) for tracks in (d.tracks, d.held))
    commit = f", commit {made['commit'][:12]}" if made["commit"] else ""
    said = _wrapped(f"Learnt from: {learnt}. Held out: {held or 'nothing'}.", PAGE_MM, 6.5)[:2]
    by = f"Twinbench {made['twinbench']}{commit}; {made['time']}. All numbers and the files' checksums: verdict.json."
    return [Line(6.5, [(0.0, text)], {"color": MUTED}) for text in (*said, by)]


def _wrapped(text: str, width_mm: float, size: float) -> list[str]:
    """Text in lines of a width."""
    return wrap(text, int(width_mm / (LETTER * size * MM_PER_PT)), break_on_hyphens=False) or [""]


def _height(line: Line) -> float:
    return LEADING * line.size * MM_PER_PT


def _write(figure: Figure, lines: Sequence[Line], from_mm: float) -> float:
    """Set lines one below the other, from so far below the top of the sheet; returns how high they are, in mm."""
    (width, height), below = A4_MM, from_mm
    for line in lines:
        for left, text in line.pieces:
            x, y = (0.5 * (width - PAGE_MM) + left) / width, 1.0 - below / height
            figure.text(x, y, text, size=line.size, va="top", **{"color": INK, **line.look})
        below += _height(line)
    return below - from_mm
