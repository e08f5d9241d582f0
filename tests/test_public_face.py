"""The public face says what it is: a docstring on every name, and of every array its shape and its unit.

The docstrings are read as the site reads them, by griffe.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import griffe
import pytest
from helpers.site_code import site_code

import twinbench
from twinbench.bench.cli.main import COMMANDS

ROOT = Path(__file__).parents[1]
ARRAY = re.compile(r"\b(ndarray|NDArray|ArrayLike|Tensor|Array)\b")
DIMENSION = r"(?:\.\.\.|\w+(?: [+*-] \w+)*)"
SIZES = rf"\({DIMENSION},(?: {DIMENSION}(?:, {DIMENSION})*)?\)"
SHAPE = re.compile(rf"{SIZES}|\bone per \w|\bany shape\b|\blikewise\b")
UNIT = re.compile(
    r"\bunits?\b|\bdimensionless\b|\bseconds\b|(?<![\w'’])(s|ms|us|bar|K|kg/s|rpm)\b|\bper cent\b|%|\bbool\b"
    r"|\b(positions|ticks|samples|shares|standardised|whitened|ranks|flags|scratch|bytes)\b|\blikewise\b"
)
"""Words of a unit, or of what plainly has none."""


@cache
def package() -> griffe.Module:
    loader = griffe.GriffeLoader(
        search_paths=[ROOT],
        docstring_parser=griffe.Parser.google,
        docstring_options={"warn_missing_types": False},
        allow_inspection=False,
    )
    loaded = loader.load("twinbench")
    assert isinstance(loaded, griffe.Module)
    loader.resolve_aliases()
    return loaded


def modules(of: griffe.Module) -> Iterator[griffe.Module]:
    """Those of a package, in all its rooms."""
    for one in of.modules.values():
        if not one.is_alias:
            yield one
            yield from modules(one)


def own(parent: griffe.Object) -> Iterator[griffe.Object]:
    """What is public and defined there."""
    for name, member in parent.members.items():
        if not name.startswith("_") and not member.is_alias and not member.is_module:
            yield member


def docstrings(member: griffe.Object) -> Iterator[griffe.Docstring]:
    """Its own, and those of what it overrides."""
    if member.docstring is not None:
        yield member.docstring
    if isinstance(member.parent, griffe.Class):
        for base in member.parent.mro():
            if member.name in base.members and (above := base.members[member.name].docstring) is not None:
                yield above


def told(member: griffe.Object, kind: str) -> dict[str, str]:
    """By name, what docstrings say of its parameters or attributes."""
    found: dict[str, str] = {}
    for text in docstrings(member):
        entries = (entry for section in text.parsed if section.kind.value == kind for entry in section.value)
        found = {entry.name: entry.description for entry in entries} | found
    return found


def arrays(member: griffe.Object) -> Iterator[tuple[str, str]]:
    """The arrays that a function takes, or a class holds: each one's name, and what is said of it."""
    if isinstance(member, griffe.Function):
        known = told(member, "parameters")
        for parameter in member.parameters:
            if _is_array(parameter.annotation):
                yield f"{member.path}({parameter.name})", known.get(parameter.name, "")
    elif isinstance(member, griffe.Class):
        known = told(member, "attributes")
        for field in own(member):
            if isinstance(field, griffe.Attribute) and "property" not in field.labels and _is_array(field.annotation):
                yield field.path, known.get(field.name, "") or (field.docstring.value if field.docstring else "")
            elif isinstance(field, griffe.Function):
                yield from arrays(field)
        if "dataclass" not in member.labels and isinstance(init := member.members.get("__init__"), griffe.Function):
            known |= told(init, "parameters") | told(member, "parameters")
            for parameter in init.parameters:
                if _is_array(parameter.annotation):
                    yield f"{member.path}({parameter.name})", known.get(parameter.name, "")


def _is_array(annotation: object) -> bool:
    return ARRAY.search(str(annotation).partition("Callable")[0]) is not None


def complaint(says: str) -> str:
    """What is missing of what is said of an array."""
    if not says:
        return "no word"
    if not SHAPE.search(says):
        return f"no shape: {says}"
    return "" if UNIT.search(re.sub(SIZES, "", says)) else f"no unit: {says}"


@pytest.mark.parametrize("name", twinbench.__all__)
def test_every_public_name_says_what_it_is(name: str) -> None:
    target = package()[name].final_target
    assert target.docstring is not None, target.path
    if isinstance(target, griffe.Class):
        known = told(target, "attributes")
        for member in own(target):
            said = any(docstrings(member)) or member.name in known
            assert said, f"{member.path}: tell it in the docstring"


def test_the_reference_shows_every_public_name_where_it_is_defined() -> None:
    page = (ROOT / "docs" / "api" / "twinbench.md").read_text(encoding="utf-8")
    shown = re.findall(r"^::: (\S+)$", page, re.MULTILINE)
    assert sorted(shown) == sorted(package()[name].final_target.path for name in twinbench.__all__)


def test_the_reference_shows_the_help_of_every_command() -> None:
    hooks = site_code("hooks")
    assert hooks.HELP in (ROOT / "docs" / "api" / "commands.md").read_text(encoding="utf-8")
    headings = re.findall(r"^## (.*)$", hooks.commands_help(), re.MULTILINE)
    assert headings == ["twinbench", *(f"twinbench {name}" for name in COMMANDS)]


@pytest.mark.parametrize("name", ["Simulator", "Term", "Series"])
def test_every_equation_that_a_user_writes_states_its_shapes_and_units(name: str) -> None:
    target = package()[name].final_target
    known = told(target, "attributes")
    equations = [m.name for m in own(target) if m.is_attribute and re.search("Equation|Callable", str(m.annotation))]
    assert equations
    assert {equation: complaint(known.get(equation, "")) for equation in equations} == dict.fromkeys(equations, "")


def test_every_array_states_its_shape_and_unit() -> None:
    found = [(name, complaint(says)) for module in modules(package()) for m in own(module) for name, says in arrays(m)]
    assert len(found) > 500, "of all rooms"
    missing = [f"{name}: {what}" for name, what in found if what]
    assert not missing, "\n".join(missing)


@pytest.mark.parametrize(
    ("says", "wrong"),
    [
        ("", "no word"),
        ("measured minus predicted", "no shape"),
        ("what was read (see above), in bar", "no shape"),
        ("what was read (now, not before), in bar", "no shape"),
        ("(n, 4) of the machine's inputs", "no unit"),
        ("(K,) of all", "no unit"),
        ("(B, L, 4), the inputs in the channels' units", ""),
        ("(2n + 1,) dimensionless weights", ""),
        ("one per recording, in K", ""),
    ],
)
def test_what_is_not_told_would_be_noticed(says: str, wrong: str) -> None:
    assert complaint(says).startswith(wrong)
    assert bool(complaint(says)) == bool(wrong)
