"""What every report has: its tables as files, and what made its numbers."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from twinbench.bench.report.table_formats import Table, to_csv, to_markdown, to_tex
from twinbench.bench.results import Results
from twinbench.bench.roster import UNRANKED, is_ablation, label, ordered
from twinbench.common.page import render, write_bytes

FORMATS = {"csv": to_csv, "md": to_markdown, "tex": to_tex}


def write_tables(out: Path, tables: Iterable[Table]) -> None:
    """Each table in every format."""
    for table in tables:
        for suffix, text in FORMATS.items():
            write_bytes(out / "tables" / f"{table.name}.{suffix}", text(table).encode())


def bullets(*paragraphs: str) -> str:
    """Paragraphs as a Markdown list."""
    return "".join(f"- {paragraph}\n" for paragraph in paragraphs)


def write_page(
    results: Results,
    says: tuple[str, Sequence[str], Sequence[str]],
    notes: Sequence[str],
    tables: Sequence[Table],
    figures: Sequence[dict[str, Any]],
) -> None:
    """Write ``report.html``.

    Args:
        says: the headline, the answer, and how sure that is.
        notes: what the page says at its top, and does not say again below the first table.
    """
    headline, answer, certainty = says
    page = render(
        Path(__file__).parent / "templates" / "report.html.j2",
        headline=headline,
        answer=answer,
        certainty=certainty,
        machine=results.subject.says or results.subject.machine,
        profile=profile_of(results),
        references=[label(name) for name in UNRANKED],
        tables=[replace(tables[0], notes=tuple(n for n in tables[0].notes if n not in notes)), *tables[1:]],
        figures=figures,
        failures=[(label(row[0]), *row[1:]) for row in results.failed_cells.to_numpy().tolist()],
        provenance=provenance_of(results.manifest),
    )
    write_bytes(results.out / "report.html", page.encode())


def profile_of(results: Results) -> str:
    """The name of the profile that was run."""
    return str((results.manifest.get("profile") or {}).get("name", "without a name"))


def provenance_of(manifest: dict[str, Any]) -> list[tuple[str, str]]:
    """What made these numbers, as pairs to read; what the manifest does not say is left out."""
    commit = manifest.get("commit")
    if commit and manifest.get("uncommitted_changes"):
        commit = f"{commit}, with uncommitted changes"
    machine, walls = manifest.get("machine") or {}, manifest.get("wall_s") or {}
    pairs = [
        ("command", manifest.get("command")),
        *_makers(manifest),
        ("profile", (manifest.get("profile") or {}).get("name")),
        ("commit", commit),
        ("seeds", _joined(manifest.get("seeds"))),
        ("python", manifest.get("python")),
        ("versions", _joined(f"{name} {version}" for name, version in (manifest.get("versions") or {}).items())),
        ("machine", _joined(f"{key} {value}" for key, value in machine.items() if value is not None)),
        ("wall time", _joined(f"{stage} {seconds:.0f} s" for stage, seconds in walls.items())),
    ]
    return [(name, str(value)) for name, value in pairs if value]


def _makers(manifest: dict[str, Any]) -> list[tuple[str, str]]:
    """Whose rows another command, commit or processor made than the last run's, as pairs to read."""
    made: dict[tuple[Any, ...], list[str]] = {}
    for name, by in manifest.get("made", {}).items():
        made.setdefault((by["command"], by["commit"], by["processor"]), []).append(name)
    if len(made) < 2:
        return []
    return [
        (
            f"rows of {_joined(map(label, whole))}{f' and {parts} ablations' if parts else ''}",
            f"{command}; commit {commit}; on {processor}",
        )
        for (command, commit, processor), names in made.items()
        for whole in [[name for name in ordered(names) if not is_ablation(name)]]
        for parts in [len(names) - len(whole)]
    ]


def _joined(values: Any) -> str:
    return ", ".join(str(value) for value in values or ())
