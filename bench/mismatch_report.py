"""What ``twinbench mismatch`` found, as a file for programs and a page for people."""

from __future__ import annotations

import json
import math
import re
from pathlib import Path
from typing import Any

import numpy as np

from bench.figures.mismatch import draw
from bench.mismatch_tables import build_listings, sizes
from bench.page import render, write_bytes, write_figures
from bench.store import write_text
from mismatch.verdict import Finding, Verdict


def write(verdict: Verdict, out: Path) -> None:
    """Write ``verdict.json``, ``figures/`` and ``report.html`` into a folder.

    Raises:
        CannotWrite: the folder cannot be written to.
    """
    write_text(out / "verdict.json", to_json(verdict) + "\n")
    figures = write_figures(out / "figures", draw(verdict))
    write_bytes(out / "report.html", _html(verdict, figures).encode())


def to_json(verdict: Verdict) -> str:
    """``verdict.json``: strict JSON, with null for what is no finite number."""
    return json.dumps(_plain(verdict.to_dict()), indent=2, allow_nan=False, ensure_ascii=False)


def _plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, np.ndarray | np.generic):
        return _plain(value.tolist())
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


def _html(verdict: Verdict, figures: list[dict[str, Any]]) -> str:
    d = verdict.diagnosis
    headline, answer = _headed(verdict.says)
    return render(
        "mismatch.html.j2",
        simulator=d.simulator,
        verdict=verdict,
        headline=headline,
        answer=answer,
        findings=[(f, _facts(f), sizes(f)) for f in verdict.findings],
        figures=figures,
        listings=build_listings(verdict),
        remarks=d.remarks,
        provenance=_provenance(verdict),
    )


def _headed(says: str) -> tuple[str, list[str]]:
    """The first clause of the verdict for the large type, and the rest as paragraphs."""
    head, *rest = re.split(r"[:;] |\.(?: (?=[A-Z])|$)", says, maxsplit=1)
    answer = rest[0].strip() if rest else ""
    if answer.split(" ")[0].isalpha():  # else it is a number or a name
        answer = answer[:1].upper() + answer[1:]
    return head, [answer] if answer else []


def _facts(f: Finding) -> list[tuple[str, str]]:
    """A finding's fields as pairs to read; what it does not know is left out."""
    pairs = [
        ("kind", f.kind),
        ("term", f.term),
        ("port", f.port),
        ("probability", f"{f.probability:.2f}" if f.mechanism else ""),
        ("since", f"about {f.since_s:.0f} s" if f.since_s is not None else ""),
        ("where", f.regime),
        ("cannot be told from", ", ".join(f.indistinguishable_from)),
    ]
    return [(name, text) for name, text in pairs if text]


def _provenance(verdict: Verdict) -> list[tuple[str, str]]:
    d = verdict.diagnosis

    def named(tracks: Any) -> str:
        return ", ".join(f"{t.name} ({len(t.time_s):,} samples, {t.time_s[-1] - t.time_s[0]:,.0f} s)" for t in tracks)

    pairs = [
        ("simulator", f"{d.simulator.name}: {d.simulator.says}"),
        ("learnt from", named(d.tracks)),
        ("held out", named(d.held)),
        ("looked for", f"{len(d.machine.candidates)} mechanisms and faults"),
        ("threshold", f"{d.threshold:.3g} log-likelihood units (twice) per effect"),
        ("also written", "verdict.json, model.toml (the mended simulator), figures/"),
    ]
    return [(name, text) for name, text in pairs if text]
