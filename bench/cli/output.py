"""What commands print: one JSON value for programs, tables and file names for people."""

from __future__ import annotations

import argparse
import json
import shlex
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any


def tell(a: argparse.Namespace, value: Any) -> None:
    """One JSON value on stdout."""
    print(json.dumps(value, indent=2, allow_nan=False), file=a.stdout)


def tell_files(a: argparse.Namespace, paths: Sequence[Path]) -> None:
    """The files that were written, a line each."""
    if a.json:
        tell(a, {"files": [str(path) for path in paths]})
    else:
        print("\n".join(map(str, paths)))


def rows_of(frame: Any) -> list[dict[str, Any]]:
    """A table as records; null where there is no number."""
    return list(json.loads(frame.to_json(orient="records", double_precision=15)))


def failed_cells(outcomes: Any) -> list[dict[str, Any]]:
    """Cells that failed, as records."""
    return [
        {"estimator": o.cell.estimator, "seed": o.cell.seed, "stage": o.stage, "reason": o.reason} for o in outcomes
    ]


def command_line() -> str:
    """The command as it was typed, for a manifest."""
    return "twinbench " + shlex.join(sys.argv[1:])
