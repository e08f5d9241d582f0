"""Source made ready for numba, such that a later process finds the machine code of the first.

The source is kept as a file named after all that goes into it: its text and the content of each function that it
calls. A changed term, or a constant in it, makes another file, and what is kept of the old one is not looked at.
"""

from __future__ import annotations

import functools
import hashlib
import os
import sys
import tempfile
from collections.abc import Callable, Mapping
from pathlib import Path
from types import FunctionType, ModuleType
from typing import Any

import numpy as np
from numba.core import config

from twinbench.physics.fingerprint import Untold, fingerprint
from twinbench.physics.jit import jit


def executed(
    text: str, names: Mapping[str, Callable[..., Any]], module: str = __name__, file: str = "<composed>"
) -> dict[str, Any]:
    """What the source defines, calling functions by these names."""
    made = {"__name__": module, "np": np, "inf": np.inf, **names}
    exec(compile(text, file, "exec"), made)  # our own text: port numbers and parameter places, nothing a user wrote
    return made


@functools.cache
def native(text: str, called: tuple[tuple[str, Callable[..., Any]], ...]) -> dict[str, Any]:
    """What the source defines, calling compiled functions, itself not compiled yet.

    To the linker, symbols of one name are one, and machine code from the disk brings its own. So the module and the
    functions in it are named after their content; those whose content cannot be told are not kept.
    """
    try:
        told = {name: fingerprint(function) for name, function in called}
    except Untold:
        made = executed(text, {name: jit(function) for name, function in called})
    else:
        content = hashlib.sha256("\n".join((text, *(f"{k} {v}" for k, v in told.items()))).encode())
        module = f"twinbench_composed_{content.hexdigest()[:24]}"
        names = {name: _named(function, told[name]) for name, function in called}
        made = executed(text, names, module, _kept(module, text))
        sys.modules[module] = ModuleType(module)  # numba looks for it when it loads what is kept
    equations = ("rhs", "output", "flux", "balance")
    helpers = {name: f for name, f in made.items() if isinstance(f, FunctionType) and name not in equations}
    made.update({name: jit(f) for name, f in helpers.items()})
    return made


_NAMED: dict[str, Any] = {}
"""Compiled functions by fingerprint."""


def _named(function: Any, told: str) -> Any:
    """The function compiled under a name that no other content has."""
    if told not in _NAMED:
        if isinstance(function, FunctionType) and not hasattr(function, "native"):
            copy = FunctionType(
                function.__code__, function.__globals__, function.__name__, function.__defaults__, function.__closure__
            )
            copy.__module__, copy.__qualname__ = function.__module__, f"{function.__qualname__}_{told[:24]}"
            function = copy
        _NAMED[told] = jit(function)
    return _NAMED[told]


def _kept(module: str, text: str) -> str:
    """The file of this source in the folder of compiled code; a name in brackets if there is none to write to."""
    folder = config.CACHE_DIR  # type: ignore[attr-defined]
    if not folder:
        return f"<{module}>"
    file = Path(folder) / f"{module}.py"
    try:
        if not file.exists():
            file.parent.mkdir(parents=True, exist_ok=True)
            with tempfile.NamedTemporaryFile("w", dir=file.parent, encoding="utf-8", delete=False) as part:
                part.write(text)
            os.utime(part.name, (0, 0))  # numba forgets what it compiled when a file's time has changed
            os.replace(part.name, file)
    except OSError:
        return f"<{module}>"
    return str(file)
