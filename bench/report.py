"""Tables, figures and the report of a run, from what it left in its folder. May be run again at any time."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import jinja2
from markupsafe import Markup

from bench.evidence import Evidence, gather
from bench.figures import draw
from bench.figures.style import FAINT, INK, MUTED, PAPER, png, settle, svg
from bench.results import Results, load_results
from bench.roster import FLOOR, label
from bench.store import write_atomically
from bench.summary import Summary, summarise
from bench.table_formats import Table, to_csv, to_markdown, to_tex
from bench.tables import build_tables
from bench.words import answer, certainty, headline

FORMATS = {"csv": to_csv, "md": to_markdown, "tex": to_tex}
THEMED = {INK: "var(--ink)", MUTED: "var(--muted)", FAINT: "var(--rule)", PAPER: "var(--paper)"}
"""Colours of the figures that follow the reader's light or dark setting; the estimators' own do not."""


def write_report(out: Path) -> Table:
    """Write ``tables/``, ``figures/`` and ``report.html`` from ``scores.csv`` and its neighbours.

    Returns:
        The comparison of the estimators, for a terminal.

    Raises:
        BadInput: the folder holds no run, or cannot be written to.
    """
    results = load_results(out)
    summary = summarise(results.scores, results.failures)
    evidence = _evidence(results)
    tables = build_tables(summary, evidence.coverage, results.latency)
    for table in tables:
        for suffix, text in FORMATS.items():
            _write(out / "tables" / f"{table.name}.{suffix}", text(table).encode())
    figures = _write_figures(out / "figures", results, summary, evidence)
    _write(out / "report.html", _html(results, summary, tables, figures).encode())
    return tables[0]


def _evidence(results: Results) -> Evidence:
    truth = results.truth()
    return Evidence() if truth is None else gather(results.estimates(), truth, results.failures)


def _write_figures(folder: Path, results: Results, summary: Summary, evidence: Evidence) -> list[dict[str, Any]]:
    """Write each figure twice and return what the report shows of it."""
    shown = []
    for name, caption, figure, missing in draw(summary, evidence, results.latency):
        files = {suffix: folder / f"{name}.{suffix}" for suffix in ("png", "svg")}
        if figure is None:
            for path in files.values():
                path.unlink(missing_ok=True)
            shown.append({"name": name, "caption": caption, "svg": None, "missing": missing})
            continue
        settle(figure)
        drawn = svg(figure)
        _write(files["png"], png(figure))
        _write(files["svg"], drawn.encode())
        shown.append({"name": name, "caption": caption, "svg": Markup(inline_svg(drawn, name)), "missing": ""})
    return shown


def inline_svg(drawn: str, name: str) -> str:
    """An SVG file's text made fit to stand in an HTML page: no prologue, names of its own, themed colours."""
    drawn = drawn[drawn.index("<svg") :]
    drawn = re.sub(r"<metadata>.*?</metadata>", "", drawn, flags=re.DOTALL)
    drawn = re.sub(r'\b(id=")', rf"\g<1>{name}-", drawn)
    drawn = re.sub(r'((?:xlink:href="|url\()#)', rf"\g<1>{name}-", drawn)
    for colour, themed in THEMED.items():
        drawn = drawn.replace(colour, themed)
    # Sized by the page, not by the paper.
    width = re.search(r'\bwidth="([\d.]+)pt"', drawn)
    drawn = re.sub(r'\b(?:width|height)="[\d.]+pt" ?', "", drawn, count=2)
    size = f'style="width: {float(width.group(1)) * 4 / 3:.0f}px" ' if width else ""
    return drawn.replace("<svg ", f'<svg {size}role="img" aria-labelledby="{name}-caption" ', 1)


def _html(results: Results, summary: Summary, tables: list[Table], figures: list[dict[str, Any]]) -> str:
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(Path(__file__).parent / "templates"),
        autoescape=True, trim_blocks=True, lstrip_blocks=True, undefined=jinja2.StrictUndefined,
    )  # fmt: skip
    return environment.get_template("report.html.j2").render(
        headline=headline(summary),
        answer=answer(summary),
        certainty=certainty(summary),
        floor=label(FLOOR),
        tables=tables,
        figures=figures,
        failures=[(label(row[0]), *row[1:]) for row in results.failed_cells.to_numpy().tolist()],
        provenance=_provenance(results.manifest),
    )


def _provenance(manifest: dict[str, Any]) -> list[tuple[str, str]]:
    """What made these numbers, as pairs to read; what the manifest does not say is left out."""
    commit = manifest.get("commit")
    if commit and manifest.get("uncommitted_changes"):
        commit = f"{commit}, with uncommitted changes"
    machine, walls = manifest.get("machine") or {}, manifest.get("wall_s") or {}
    pairs = [
        ("command", manifest.get("command")),
        ("profile", (manifest.get("profile") or {}).get("name")),
        ("commit", commit),
        ("seeds", _joined(manifest.get("seeds"))),
        ("python", manifest.get("python")),
        ("versions", _joined(f"{name} {version}" for name, version in (manifest.get("versions") or {}).items())),
        ("machine", _joined(f"{key} {value}" for key, value in machine.items() if value is not None)),
        ("wall time", _joined(f"{stage} {seconds:.0f} s" for stage, seconds in walls.items())),
    ]
    return [(name, str(value)) for name, value in pairs if value]


def _joined(values: Any) -> str:
    return ", ".join(str(value) for value in values or ())


def _write(path: Path, content: bytes) -> None:
    def fill(beside: Path) -> None:
        beside.write_bytes(content)

    write_atomically(path, fill)
