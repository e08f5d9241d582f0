"""The code in docs/ by which the site is built; it is no package."""

from __future__ import annotations

import importlib.util
from types import ModuleType

from helpers.prose import ROOT


def site_code(name: str) -> ModuleType:
    """A module of docs/."""
    spec = importlib.util.spec_from_file_location(name, ROOT / "docs" / f"{name}.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module
