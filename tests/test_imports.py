"""Tests stand alone: what they share is in helper modules, and what they test has a public name."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

HERE = Path(__file__).parent


def imported(source: str) -> list[str]:
    """Every module, and every name out of one, with dots."""
    found = []
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            found += [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            found += [f"{node.module or ''}.{alias.name}" for alias in node.names]
    return found


def wrong(name: str) -> bool:
    """Does a name lead through something private, or into a module of tests?"""
    parts = name.split(".")
    private = any(part.startswith("_") and not part.startswith("__") for part in parts)
    return private or any(part.startswith("test_") for part in parts)


@pytest.mark.parametrize("path", sorted(HERE.rglob("*.py")), ids=lambda path: str(path.relative_to(HERE)))
def test_no_private_name_and_no_other_test_is_imported(path: Path) -> None:
    assert [name for name in imported(path.read_text(encoding="utf-8")) if wrong(name)] == []


@pytest.mark.parametrize(
    ("source", "names"),
    [
        ("import os._x", ["os._x"]),
        ("from a.b import _c, d", ["a.b._c"]),
        ("def f():\n    from test_a import b", ["test_a.b"]),
        ("from . import test_a", [".test_a"]),
        ("from __future__ import annotations\nfrom a import test", []),
    ],
)
def test_such_imports_are_seen(source: str, names: list[str]) -> None:
    assert [name for name in imported(source) if wrong(name)] == names
