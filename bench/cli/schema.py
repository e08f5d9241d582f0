"""``twinbench schema``: what the files hold that programs read."""

from __future__ import annotations

import argparse
from pathlib import Path

SAYS = "print the JSON Schema of a file that programs read"
EXAMPLE = """twinbench schema verdict > verdict.schema.json

verdict is of verdict.json, which mismatch writes; design is of design.json, which design writes; fleet is of
fleet.json, which fleet writes; summary is of NAME.summary.json, which estimate writes.
Each is a JSON Schema of draft 2020-12."""
ROOT = Path(__file__).parents[2]
SCHEMAS = {
    "verdict": ROOT / "mismatch" / "report" / "verdict.schema.json",
    "design": ROOT / "mismatch" / "design" / "design.schema.json",
    "fleet": ROOT / "mismatch" / "fleet" / "fleet.schema.json",
    "summary": ROOT / "bench" / "estimate" / "summary.schema.json",
}
"""Where each lies, beside what writes the file."""


def add_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("file", choices=tuple(SCHEMAS), help="of which file")


def run(a: argparse.Namespace) -> int:
    """The exit status."""
    print(SCHEMAS[a.file].read_text(encoding="utf-8"), end="", file=a.stdout)
    return 0
