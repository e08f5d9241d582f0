"""A run's manifest, read back and checked: somebody may have had it in an editor, or a disk has lost a part of it."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from twinbench.common.errors import BadInput

NUMBER = (int, float)
SHAPE: dict[str, Any] = {
    "command": str, "profile": {}, "seeds": [int], "estimators": [str], "ablations": [str], "specs": {"*": str},
    "code": {"*": str}, "made": {"*": {"estimates": [str], "takes": [[str]]}}, "data_key": str,
    "estimates_keys": [str], "versions": {"*": str}, "machine": {}, "wall_s": {"*": NUMBER}, "robustness": bool,
    "scenes": {"recordings": str, "takes": [[str]]}, "subject": {"machine": str, "says": str, "period_s": NUMBER},
}  # fmt: skip
"""What the fields that are read must be, where they are there; ``*`` stands for every key, a list's entry for each."""
SAID = {str: "text", int: "a whole number", bool: "true or false", NUMBER: "a number"}
LONGEST_QUOTE = 60


def read_manifest(path: Path) -> dict[str, Any]:
    """The manifest of a run.

    Raises:
        BadInput: it is missing, not JSON, or a field of it is not what a run writes.
    """
    try:
        manifest = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise unusable(path, error.strerror or str(error)) from error
    except (ValueError, RecursionError) as error:
        raise unusable(path, f"not JSON: {error}") from error
    if not isinstance(manifest, dict):
        raise unusable(path, "holds no table of fields")
    if wrong := _wrong(manifest, SHAPE, ""):
        raise unusable(path, wrong)
    return manifest


def unusable(path: Path, why: str) -> BadInput:
    """The refusal of a file that a run wrote and that is not so any more."""
    return BadInput(f"cannot use {path}: {why}; run `twinbench run --out {path.parent}` again")


def _wrong(value: Any, shape: Any, where: str) -> str:
    """What is not of its shape, in words; empty if all is."""
    if isinstance(shape, dict):
        if not isinstance(value, dict):
            return f"{where} is {_quoted(value)}, must be a table"
        inside = [(f"{where}.{key}".strip("."), v, shape.get("*", shape.get(key))) for key, v in value.items()]
        return next((said for name, v, s in inside if s is not None and (said := _wrong(v, s, name))), "")
    if isinstance(shape, list):
        if not isinstance(value, list):
            return f"{where} is {_quoted(value)}, must be a list"
        return next((said for v in value if (said := _wrong(v, shape[0], f"an entry of {where}"))), "")
    fits = isinstance(value, shape) and (shape is bool or not isinstance(value, bool))
    return "" if fits else f"{where} is {_quoted(value)}, must be {SAID[shape]}"


def _quoted(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= LONGEST_QUOTE else text[:LONGEST_QUOTE] + "..."
