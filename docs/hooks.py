"""What the site needs beside its pages: help, fields of the schemas, files outside docs/, and formulas as MathML."""

from __future__ import annotations

import argparse
import html
import json
import os
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from latex2mathml.converter import convert
from mkdocs.structure.files import File, Files, InclusionLevel

from twinbench.bench.cli.main import build_parser
from twinbench.bench.cli.schema import SCHEMAS

FIELDS = re.compile(r"<!-- the fields of (\w+) -->")
HELP = "<!-- the help of every command -->"
WIDTH = "80"
"""Columns of the help, as argparse reads them."""
OUTSIDE = re.compile(r"\[([^]]*)\]\((\.\./[^)\s#]+)[^)]*\)")
"""A link that leads out of its page's folder: its text and its target."""
FORMULA = re.compile(r'<(span|div) class="arithmatex">\\([(\[])(.*?)\\[)\]]</\1>', re.DOTALL)


def on_files(files: Files, config: Any) -> Files:
    """Pictures and examples that pages show from outside docs/ go to the site as well."""
    docs = Path(config.docs_dir)
    for page in files.documentation_pages():
        for _, target in OUTSIDE.findall(page.content_string):
            place = Path(os.path.normpath(docs / Path(page.src_uri).parent / target))
            if not _is_taken(place, docs):
                continue
            source, where = os.path.relpath(place, docs), place.relative_to(docs.parent).as_posix()
            if files.get_file_from_path(source) is None:
                file = File(
                    source,
                    str(docs),
                    config.site_dir,
                    config.use_directory_urls,
                    dest_uri=where,
                    inclusion=InclusionLevel.INCLUDED,
                )
                files.append(file)
    return files


def on_page_markdown(markdown: str, page: Any, config: Any, files: Files) -> str:
    """Help and fields in their places; of links to folders and pages that the site does not hold, the text."""
    docs = Path(config.docs_dir)
    here = docs / Path(page.file.src_uri).parent

    def kept(link: re.Match[str]) -> str:
        place = Path(os.path.normpath(here / link[2]))
        left_out = place.exists() and not place.is_relative_to(docs) and not _is_taken(place, docs)
        return link[1] if left_out else link[0]  # what is nowhere stays, for mkdocs to complain of

    told = FIELDS.sub(lambda mark: fields_table(mark[1]), OUTSIDE.sub(kept, markdown))
    return told.replace(HELP, commands_help() if HELP in told else "")


def on_page_content(html: str, page: Any, config: Any, files: Files) -> str:
    """Formulas as MathML, which browsers show by themselves."""
    return FORMULA.sub(_formula, html)


def _is_taken(place: Path, docs: Path) -> bool:
    """Is it a file of the repository, outside docs/, that is no page? Pages and folders there are not of the site."""
    return place.is_file() and place.suffix != ".md" and not place.is_relative_to(docs)


def commands_help() -> str:
    """A heading for every command, and below it what its ``--help`` says."""
    before, os.environ["COLUMNS"] = os.environ.get("COLUMNS"), WIDTH
    try:
        parser = build_parser()
        commands = next(a.choices for a in parser._actions if isinstance(a, argparse._SubParsersAction))
        parsers = {"twinbench": parser} | {f"twinbench {name}": command for name, command in commands.items()}
        return "\n".join(f"## {name}\n\n```text\n{p.format_help()}```\n" for name, p in parsers.items())
    finally:
        os.environ.pop("COLUMNS") if before is None else os.environ.update(COLUMNS=before)


def fields_table(name: str) -> str:
    """A row for every field of a published schema: where it stands, of what type it is, what it is."""
    schema = json.loads(SCHEMAS[name].read_text(encoding="utf-8"))
    rows = [f"| `{where}` | {kind} | {says} |" for where, kind, says in _fields(schema, schema, "")]
    return "\n".join(["| field | type | what it is |", "|---|---|---|", *rows])


def _fields(schema: dict[str, Any], part: dict[str, Any], where: str) -> Iterator[tuple[str, str, str]]:
    for name, field in part.get("properties", {}).items():
        here, inner = f"{where}.{name}".lstrip("."), _resolved(schema, field)
        yield here, _kind(schema, field), field["description"]
        yield from _inside(schema, inner, here)


def _inside(schema: dict[str, Any], part: dict[str, Any], where: str) -> Iterator[tuple[str, str, str]]:
    """The fields of an object, or of what a list, a table or a choice holds."""
    yield from _fields(schema, part, where)
    for key, mark in (("items", "[]"), ("additionalProperties", ".*")):
        if key in part:
            yield from _inside(schema, _resolved(schema, part[key]), where + mark)
    for one in (*part.get("anyOf", ()), *part.get("oneOf", ())):
        yield from _inside(schema, _resolved(schema, one), where)


def _resolved(schema: dict[str, Any], part: dict[str, Any]) -> dict[str, Any]:
    return schema["$defs"][part["$ref"].rpartition("/")[2]] if "$ref" in part else part


def _kind(schema: dict[str, Any], field: dict[str, Any]) -> str:
    """A field's type in words; the words themselves where it may hold few."""
    inner = _resolved(schema, field)
    if "enum" in inner:
        return ", ".join(f"`{word}`" for word in inner["enum"])
    if "anyOf" in inner:
        return " or ".join(_kind(schema, one) for one in inner["anyOf"])
    kinds = inner["type"] if isinstance(inner["type"], list) else [inner["type"]]
    return " or ".join(kinds)


def _formula(match: re.Match[str]) -> str:
    return convert(html.unescape(match[3]), display="block" if match[2] == "[" else "inline")
