"""What ``twinbench mismatch`` found, as files for programs and a page for people: the findings first, then the page."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from textwrap import fill
from typing import Any

from twinbench.common.documents import to_json
from twinbench.common.errors import BadInput
from twinbench.common.page import render, write_bytes, write_figures
from twinbench.common.store import write_text
from twinbench.mismatch.findings import Finding
from twinbench.mismatch.report.figures import draw, failed
from twinbench.mismatch.report.tables import build_listings, sizes
from twinbench.mismatch.verdict import Verdict
from twinbench.mismatch.words import listed, probable, typeset

OPENING = "fit_held_out"
"""The figure that the page begins with: before and after on what was held out."""
_WHOLE: dict[str, Any] = {"break_long_words": False, "break_on_hyphens": False}  # names of channels


def write_findings(document: Mapping[str, Any], model: str, out: Path) -> None:
    """Write ``verdict.json``, which holds ``document``, and ``model.toml`` into a folder.

    Raises:
        CannotWrite: the folder cannot be written to.
    """
    write_text(out / "verdict.json", to_json(document) + "\n")
    write_text(out / "model.toml", model)


def write_page(verdict: Verdict, out: Path) -> None:
    """Draw ``figures/`` and write ``report.html`` into a folder; a figure that fails is said to be missing.

    Raises:
        CannotWrite: the folder cannot be written to.
    """
    figures = []
    for drawing in draw(verdict):
        try:
            figures += write_figures(out / "figures", [drawing])
        except BadInput:
            raise
        except Exception as error:
            figures += write_figures(out / "figures", [drawing._replace(figure=None, missing=failed(error))])
    write_bytes(out / "report.html", _html(verdict, figures).encode())


def to_text(verdict: Verdict, width: int = 80) -> str:
    """The verdict for a terminal: the sentence, then its points."""
    points = [fill(p, width, initial_indent="- ", subsequent_indent="  ", **_WHOLE) for p in verdict.points]
    return "\n".join([fill(verdict.says, width, **_WHOLE), "", *points, ""])


def _html(verdict: Verdict, figures: list[dict[str, Any]]) -> str:
    d = verdict.diagnosis
    return render(
        Path(__file__).parent / "templates" / "mismatch.html.j2",
        simulator=d.simulator,
        verdict=verdict,
        headline=verdict.says.rstrip("."),
        findings=[(f, _facts(f), sizes(f)) for f in verdict.findings],
        opening=next(f for f in figures if f["name"] == OPENING),
        figures=[f for f in figures if f["name"] != OPENING],
        listings=build_listings(verdict),
        remarks=d.remarks,
        provenance=_provenance(verdict),
    )


def _facts(f: Finding) -> list[tuple[str, str]]:
    """A finding's fields as pairs to read; what it does not know is left out."""
    pairs = [
        ("kind", f.kind),
        ("term", typeset(f.term)),
        ("port", str(f.port or "")),
        ("probability", probable(f.probability) if f.probability is not None else ""),
        ("where", typeset(f.regime)),
        ("may also be", listed(f.names[1:]) if len(f.names) > 1 else ""),
    ]
    return [(name, text) for name, text in pairs if text]


def _provenance(verdict: Verdict) -> list[tuple[str, str]]:
    d = verdict.diagnosis

    def named(tracks: Any) -> str:
        return ", ".join(f"{t.name} ({len(t.time_s):,} samples, {t.time_s[-1] - t.time_s[0]:,.0f} s)" for t in tracks)

    joined = {"held": "held from one sample to the next", "linear": "joined by lines between samples"}
    pairs = [
        ("simulator", f"{d.simulator.name}: {d.simulator.says}"),
        ("learnt from", named(d.tracks)),
        ("held out", named(d.held)),
        ("inputs", joined[d.joined.inputs]),
        ("looked for", f"{len(d.machine.candidates)} mechanisms and faults"),
        ("also written", "verdict.json, model.toml (the mended simulator), report.pdf (one page), figures/"),
    ]
    return [(name, text) for name, text in pairs if text]
