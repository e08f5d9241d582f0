"""One readable table, written as CSV, Markdown, LaTeX, HTML cells or plain text for a terminal."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import groupby
from textwrap import wrap
from typing import NamedTuple

import pandas as pd

MINUS = "−"


class Cell(NamedTuple):
    """What one cell says: the number, and in smaller type its interval and its multiple of the reference."""

    text: str
    interval: str = ""
    times: str = ""
    best: bool = False

    def line(self, best: str = "{}") -> str:
        """All of it on one line; the best of a column has its number set in ``best``."""
        text = best.format(self.text) if self.best else self.text
        return " ".join(part for part in (text, self.interval and f"[{self.interval}]", self.times) if part)


class Column(NamedTuple):
    """Head of a column: a short name with its unit, and the group of columns that it belongs to."""

    head: str
    group: str = ""


@dataclass(frozen=True)
class Table:
    """A table for people, and the full numbers behind it.

    Attributes:
        frame: the full numbers, one row per row of ``rows``; what the CSV holds.
        columns: heads of the readable columns, the row labels' first.
        rows: readable cells, as many as columns.
        notes: reservations and how to read it, printed below in every format.
        definitions: what each column is, printed below except on a terminal.
    """

    name: str
    title: str
    frame: pd.DataFrame
    columns: tuple[Column, ...]
    rows: tuple[tuple[Cell, ...], ...]
    notes: tuple[str, ...] = ()
    definitions: tuple[str, ...] = ()

    @property
    def groups(self) -> list[tuple[str, int]]:
        """Neighbouring columns of one group: its name, and how many they are."""
        return [(name, len(list(members))) for name, members in groupby(self.columns, key=lambda c: c.group)]


def number(value: float, digits: int = 3) -> str:
    """So many significant digits, no exponent; 0 below a millionth, a dash where there is no number."""
    if not math.isfinite(value):
        return "–"
    if value == 0.0:
        return "0"
    # Rounding first: 9.996 has two digits before the point once it is printed.
    rounded = float(f"{value:.{digits}g}")
    decimals = max(digits - 1 - math.floor(math.log10(abs(rounded))), 0)
    text = f"{rounded:,.{min(decimals, 6)}f}".replace("-", MINUS)
    return text if text.strip("−0.") else "0"


def span(low: float, high: float, to: bool = False) -> str:
    """A range: ``1.2–3.4``, or with a word where a bound is negative or ``to`` asks for it: ``−1.2 to 3.4``."""
    ends = [("∞" if end > 0 else f"{MINUS}∞") if math.isinf(end) else number(end) for end in (low, high)]
    return (" to " if to or low < 0 else "–").join(ends)


def to_csv(table: Table) -> str:
    """The full numbers, shortest text that gives the same float back."""
    return table.frame.to_csv(index=False, lineterminator="\n")


def to_markdown(table: Table) -> str:
    """GitHub's tables; the best of each column in bold."""
    lines = [f"## {table.title}", "", _markdown_row([_head(c) for c in table.columns])]
    lines.append(_markdown_row(["---"] + ["---:"] * (len(table.columns) - 1)))
    for row in table.rows:
        lines.append(_markdown_row([cell.line(best="**{}**") for cell in row]))
    return "\n".join([*lines, "", *(f"- {note}" for note in (*table.notes, *table.definitions))]) + "\n"


def to_tex(table: Table) -> str:
    """A booktabs tabular with the notes below it; needs ``\\usepackage{booktabs}``."""
    body = [" & ".join(_tex(_head(c)) for c in table.columns) + r" \\", r"\midrule"]
    for row in table.rows:
        escaped = [Cell(_tex(c.text), _tex(c.interval), _tex(c.times), c.best) for c in row]
        body.append(" & ".join(cell.line(best=r"\textbf{{{}}}") for cell in escaped) + r" \\")
    return "\n".join(
        [
            f"% {table.title}",
            rf"\begin{{tabular}}{{l{'r' * (len(table.columns) - 1)}}}",
            r"\toprule",
            *body,
            r"\bottomrule",
            r"\end{tabular}",
            "",
            *(rf"\par\footnotesize {_tex(note)}" for note in (*table.notes, *table.definitions)),
            "",
        ]
    )


def to_text(table: Table, width: int = 80) -> str:
    """Plain text for a terminal: blocks of columns that fit, intervals below the means, then the notes."""
    first = max(len(text) for text in [*(row[0].text for row in table.rows), table.columns[0].head])
    blocks: list[list[int]] = []
    room = 0
    for index in range(1, len(table.columns)):
        needed = _cell_width(table, index) + 2
        if not blocks or needed > room:
            blocks.append([])
            room = width - first
        blocks[-1].append(index)
        room -= needed
    lines = [table.title]
    for block in blocks:
        lines += ["", *_text_block(table, first, block)]
    return "\n".join([*lines, "", *_wrapped(table.notes, width)]) + "\n"


def _text_block(table: Table, first: int, block: Sequence[int]) -> list[str]:
    widths = {i: _cell_width(table, i) + 2 for i in block}
    groups = ""
    for group, members in groupby(block, key=lambda i: table.columns[i].group):
        span = sum(widths[i] for i in members) - 2
        groups += "  " + (f" {group} ".center(span, "·") if group else " " * span)
    heads = table.columns[0].head.ljust(first) + "".join(table.columns[i].head.rjust(widths[i]) for i in block)
    lines = [" " * first + groups, heads, "─" * len(heads)]
    for row in table.rows:
        lines.append(row[0].text.ljust(first) + "".join(_upper(row[i]).rjust(widths[i]) for i in block))
        if any(row[i].interval for i in block):
            lines.append(" " * first + "".join(row[i].interval.rjust(widths[i]) for i in block))
    return [line.rstrip() for line in lines if line.strip()]


def _cell_width(table: Table, index: int) -> int:
    column = table.columns[index]
    texts = [column.head, *(text for row in table.rows for text in (_upper(row[index]), row[index].interval))]
    # A group's name needs room even over one column.
    alone = sum(c.group == column.group for c in table.columns) == 1
    return max(len(text) for text in [*texts, f" {column.group} " if alone and column.group else ""])


def _upper(cell: Cell) -> str:
    return f"{cell.text}{'*' if cell.best else ''} {cell.times}".strip()


def _wrapped(notes: Sequence[str], width: int) -> list[str]:
    return [line for note in notes for line in wrap(note, width, initial_indent="- ", subsequent_indent="  ")]


def _head(column: Column) -> str:
    return f"{column.group}: {column.head}" if column.group else column.head


def _markdown_row(cells: Sequence[str]) -> str:
    return "| " + " | ".join(cell.replace("|", r"\|") for cell in cells) + " |"


_TEX = {
    "\\": r"\textbackslash{}", "&": r"\&", "%": r"\%", "$": r"\$", "#": r"\#", "_": r"\_", "{": r"\{", "}": r"\}",
    "~": r"\textasciitilde{}", "^": r"\textasciicircum{}", "×": r"$\times$", "–": "--", "−": "$-$", "µ": r"$\mu$",
    "°": r"$^\circ$", "∞": r"$\infty$", "±": r"$\pm$", "<": "$<$", ">": "$>$", "≤": r"$\le$", "≥": r"$\ge$",
}  # fmt: skip


def _tex(text: str) -> str:
    return "".join(_TEX.get(character, character) for character in text)
