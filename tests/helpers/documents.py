"""What the product writes for programs, held against its published schemas by a validator of somebody else's."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path
from typing import Any

from jsonschema import Draft202012Validator

from twinbench.bench.cli.schema import SCHEMAS
from twinbench.common.documents import strict

ENDINGS = {"verdict.json": "verdict", "design.json": "design", "fleet.json": "fleet", ".summary.json": "summary"}
"""By how a file's name ends, whose schema it keeps."""
NOWHERE = {
    "time": "2026-01-01T00:00:00+00:00",
    "settings": {
        "simulator": "none", "catalogue": "", "map": [], "inputs": "auto", "leave_out": [], "prior": [],
        "measured": [], "seed": 0,
    },
    "files": [],
    "twinbench": "0.0.0",
    "commit": None,
    "uncommitted_changes": None,
    "python": "3",
    "versions": {},
    "machine": {"system": "", "processor": "", "cores": None, "load_1min": None},
}  # fmt: skip
"""Provenance of a verdict that no command made."""
BY_NO_COMMAND = {"recordings": [], "provenance": NOWHERE}
"""What a command adds to a verdict, of one that none made."""


@cache
def validator(name: str) -> Draft202012Validator:
    """Of a published schema, closed: what the suite writes may hold no field that the schema does not describe."""
    schema = json.loads(SCHEMAS[name].read_text(encoding="utf-8"))
    Draft202012Validator.check_schema(schema)
    return Draft202012Validator(closed(schema))


def closed(schema: Any) -> Any:
    """The same, but that objects with listed fields may hold no others."""
    if isinstance(schema, list):
        return [closed(part) for part in schema]
    if not isinstance(schema, dict):
        return schema
    shut = {key: closed(value) for key, value in schema.items()}
    return {**shut, "additionalProperties": False} if isinstance(shut.get("required"), list) else shut


def described(part: Any, where: str = "") -> Iterator[tuple[str, str]]:
    """Every field that a schema describes, and how."""
    if isinstance(part, dict):
        for name, field in part.get("properties", {}).items():
            yield f"{where}.{name}", field.get("description", "")
        for key, inside in part.items():
            yield from described(inside, f"{where}.{key}")
    elif isinstance(part, list):
        for inside in part:
            yield from described(inside, where)


def check(name: str, document: Any) -> None:
    """See that a document keeps its schema."""
    wrong = [f"{error.json_path}: {error.message[:200]}" for error in validator(name).iter_errors(document)]
    assert not wrong, f"{name}: " + "; ".join(wrong)


def check_file(path: Path) -> None:
    """See that a file is strict JSON and keeps its schema; nothing where it is no such document."""
    for ending, name in ENDINGS.items():
        if path.name.endswith(ending):
            check(name, json.loads(path.read_text(encoding="utf-8"), parse_constant=no_number))


def no_number(word: str) -> None:
    raise AssertionError(f"{word} is not JSON")


def check_verdict(verdict: Any) -> None:
    """See that a ``Verdict`` becomes what ``verdict.json`` may hold."""
    check("verdict", {**json.loads(json.dumps(strict(verdict.to_dict()), allow_nan=False)), **BY_NO_COMMAND})


def checking(write: Callable[[Path, Any], None]) -> Callable[[Path, Any], None]:
    """The writer of files, which holds each document against its schema at the moment when it is written."""

    def written(path: Path, content: Any) -> None:
        write(path, content)
        check_file(path)

    return written


def bare_verdict(word: str) -> dict[str, Any]:
    """The least that ``Verdict.to_dict`` gives."""
    return {
        "schema_version": 1, "verdict": word, "says": "Heat is lost.", "points": [], "findings": [], "parameters": {},
        "fit": [],
        "inputs": {
            "inputs": "held", "by": "default", "channel": "", "unit": "", "rmse_held": None, "rmse_linear": None,
        },
        "noisy_inputs": [], "spikes": [], "weighed": [], "unnamed": [], "inexact": [],
        "coloured": {"nats": 0.0, "channel": "T_out", "power": 1.0, "shortest_s": 1.0, "longest_s": 2.0},
        "unfollowed": [], "held_out": {"recordings": [], "worse": []},
        "self_check": {
            "decoys_named": 0, "decoys": 20, "named_again": 10, "each_again": [], "halves": 10, "power": [],
        },
        "more_data": "",
        "not_asked": "",
    }  # fmt: skip
