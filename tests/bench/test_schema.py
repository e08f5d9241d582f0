"""The published schemas: printed as they are, said field by field, and strict on every one of them."""

from __future__ import annotations

import copy
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from helpers.documents import BY_NO_COMMAND, check, closed, described, validator
from helpers.prose import ROOT, sentences
from helpers.tiny_run import twinbench
from jsonschema import Draft202012Validator

from twinbench.bench.cli.schema import SCHEMAS
from twinbench.bench.estimate.apply import SUMMARY_VERSION
from twinbench.bench.estimate.quality import LACKS, PRIOR, SELDOM, UNLIKE, USABLE
from twinbench.common.store import write_text
from twinbench.mismatch.design.write import DESIGN_VERSION, OUTLOOKS
from twinbench.mismatch.fleet.verdict import CONSISTENT, FLEET_VERSION, NAMED, UNNAMED
from twinbench.mismatch.verdict import VERDICT_VERSION, VERDICTS

VERSIONS = {
    "verdict": VERDICT_VERSION, "design": DESIGN_VERSION, "fleet": FLEET_VERSION, "summary": SUMMARY_VERSION,
}  # fmt: skip
WORDS = {
    "verdict": VERDICTS,
    "design": OUTLOOKS,
    "fleet": (CONSISTENT, NAMED, UNNAMED),
    "summary": (USABLE, UNLIKE, PRIOR, SELDOM, LACKS),
}
LONGEST_WORDS = 35


def schema_of(name: str) -> dict[str, Any]:
    return dict(json.loads(SCHEMAS[name].read_text(encoding="utf-8")))


def resolved(schema: dict[str, Any], part: dict[str, Any]) -> dict[str, Any]:
    """A part of a schema, or what it refers to."""
    while "$ref" in part:
        part = schema["$defs"][part["$ref"].rpartition("/")[2]]
    return part


def filled(schema: dict[str, Any], part: dict[str, Any]) -> Any:
    """A document that has every field there is, made from the schema alone."""
    part = resolved(schema, part)
    if "anyOf" in part:
        return filled(schema, part["anyOf"][0])
    if "const" in part or "enum" in part:
        return part.get("const", part.get("enum", [None])[0])
    kind = part["type"] if isinstance(part["type"], str) else part["type"][0]
    if kind == "object":
        named = {name: filled(schema, field) for name, field in part.get("properties", {}).items()}
        return named or {"any": filled(schema, part["additionalProperties"])}
    if kind == "array":
        each = resolved(schema, part["items"]).get("oneOf", [part["items"]])
        return [filled(schema, item) for item in each] * part.get("minItems", 1)
    return {"string": "0" * 64, "number": 0.5, "integer": 1, "boolean": True}[kind]


def spoilt(document: Any, where: str = "") -> Iterator[tuple[str, Any]]:
    """The document with one field gone, or of another type, for each of them."""
    places = document.items() if isinstance(document, dict) else enumerate(document)
    for key, value in list(places):
        here, changes = f"{where}.{key}", [("mistyped", ["no"] if isinstance(value, dict) else {"no": "no"})]
        if isinstance(value, dict | list):
            changes += spoilt(value, here)
        for says, wrong in changes:
            changed = copy.copy(document)
            changed[key] = wrong
            yield says if says.startswith(here) else f"{here} {says}", changed
        if isinstance(document, dict) and key != "any":
            yield f"{here} missing", {k: v for k, v in document.items() if k != key}


@pytest.mark.parametrize("name", SCHEMAS)
def test_the_command_prints_the_file_and_nothing_else(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    for more in ((), ("--json",)):
        assert twinbench("schema", name, *more) == 0
        assert capsys.readouterr() == (SCHEMAS[name].read_text(encoding="utf-8"), "")


@pytest.mark.parametrize("name", SCHEMAS)
def test_every_field_may_neither_lack_nor_be_of_another_type(name: str) -> None:
    schema = schema_of(name)
    document = filled(schema, schema)
    check(name, document)
    open_to_more = Draft202012Validator(schema)
    cases = dict(spoilt(document))
    assert len(cases) > 1.5 * len(list(described(schema)))
    assert [says for says, wrong in cases.items() if open_to_more.is_valid(wrong)] == []


@pytest.mark.parametrize("name", SCHEMAS)
def test_later_fields_are_passed_over_and_the_suite_would_see_one_that_is_not_described(name: str) -> None:
    schema = schema_of(name)
    more = {**filled(schema, schema), "later": 1}
    assert Draft202012Validator(schema).is_valid(more)
    assert not validator(name).is_valid(more)
    assert all("additionalProperties" in part for part in _objects(closed(schema)))


def _objects(part: Any) -> Iterator[dict[str, Any]]:
    if isinstance(part, dict):
        if part.get("type") == "object":
            yield part
        for inside in part.values():
            yield from _objects(inside)
    elif isinstance(part, list):
        for inside in part:
            yield from _objects(inside)


@pytest.mark.parametrize("name", SCHEMAS)
def test_the_schema_is_the_products_own_version_and_knows_its_words(name: str) -> None:
    schema = schema_of(name)
    assert schema["$schema"] == "https://json-schema.org/draft/2020-12/schema"
    assert schema["$id"] == f"urn:twinbench:schema:{name}:{VERSIONS[name]}"
    assert schema["properties"]["schema_version"]["const"] == VERSIONS[name]
    assert sorted(schema["properties"]["verdict"]["enum"]) == sorted(WORDS[name])


@pytest.mark.parametrize("name", SCHEMAS)
def test_every_field_is_described_in_one_sentence(name: str) -> None:
    for where, says in described(schema_of(name)):
        assert says.endswith("."), where
        assert len(sentences(says)) == 1, where
        assert len(says.split()) <= LONGEST_WORDS, where


def test_a_document_that_breaks_its_schema_fails_the_test_that_makes_it(tmp_path: Path) -> None:
    with pytest.raises(AssertionError, match="'verdict' is a required property"):
        write_text(tmp_path / "verdict.json", "{}")
    with pytest.raises(AssertionError, match="NaN is not JSON"):
        write_text(tmp_path / "day.summary.json", '{"seconds": NaN}')


def test_verdicts_on_real_recordings_keep_the_schema() -> None:
    """Those of results/ come from the engine as a library, and from before the fields that are added here."""
    files = sorted((ROOT / "results" / "real_recordings").glob("*/verdict.json"))
    assert len(files) == 5
    for path in files:
        verdict = json.loads(path.read_text(encoding="utf-8"))
        findings = [{"history": None, **finding} for finding in verdict["findings"]]
        check(
            "verdict",
            {"schema_version": VERDICT_VERSION, "not_asked": "", **verdict, "findings": findings, **BY_NO_COMMAND},
        )
