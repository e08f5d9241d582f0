"""Which estimators there are: ours, other packages' by entry point, a user's by file."""

from __future__ import annotations

import contextlib
import difflib
import functools
import importlib
import importlib.metadata
import importlib.util
import pkgutil
import re
import sys
from collections.abc import Mapping
from pathlib import Path
from types import ModuleType
from typing import Any

from twinbench import baselines, methods
from twinbench.bench.roster import LABELS
from twinbench.common.errors import BadInput
from twinbench.common.filespec import spec_of_file, split_spec
from twinbench.common.trial import about_to, tried
from twinbench.methods.estimator import REGISTRY, Estimator, ablated

GROUP = "twinbench.estimators"
LONGEST_NAME = 60
"""Characters: a name is part of a file's name and the head of a column."""


def discover() -> dict[str, type[Estimator]]:
    """Import every module of ``methods`` and ``baselines``, then every entry point.

    Raises:
        BadInput: a plug-in fails to import or is no estimator.
    """
    for room in (methods, baselines):
        for module in pkgutil.walk_packages(room.__path__, f"{room.__name__}."):
            importlib.import_module(module.name)
    for entry in importlib.metadata.entry_points(group=GROUP):
        where = f"plug-in {entry.name!r} ({entry.value})"
        try:
            loaded = entry.load()
        except (Exception, SystemExit) as error:
            raise BadInput(f"{where} fails to load: {one_line(error)}; mend that package or uninstall it") from error
        if not _is_estimator(loaded):
            raise BadInput(f"{where} is no Estimator with a name; point the entry point at the class")
        REGISTRY.setdefault(loaded.name, _complete(loaded, where))
    return REGISTRY


def find(name: str) -> type[Estimator]:
    """An estimator by name, or by ``path/to/file.py`` or ``path/to/file.py:Class``; an ablation with ``:ablation``.

    Raises:
        BadInput: no such name, ablation, file or class, or the file fails to import.
    """
    file, wanted = split_spec(name)
    if file.endswith(".py"):
        wanted, _, part = wanted.partition(":")
        return _without(_from_file(Path(file), wanted), part)
    known = discover()
    own, _, part = name.partition(":")
    if own in known:
        return _without(known[own], part)
    near = difflib.get_close_matches(name, known, n=1)
    hint = f"did you mean {near[0]!r}?" if near else "give a path ending in .py for one of your own."
    raise BadInput(f"no estimator {name!r}; {hint} Known: {', '.join(sorted(known))}")


def _without(kind: type[Estimator], part: str) -> type[Estimator]:
    if part and part not in kind.ablations:
        raise BadInput(f"{kind.name} has no ablation {part!r}; it has: {', '.join(kind.ablations) or 'none'}")
    return ablated(kind, part) if part else kind


def _from_file(path: Path, wanted: str) -> type[Estimator]:
    if not path.is_file():
        raise BadInput(f"no file {path}; give the path of a .py file with a registered Estimator")
    try:
        _try(path, path.read_bytes())
    except (OSError, ValueError) as error:
        raise BadInput(str(error)) from error
    return _estimator_in(_imported(path), path, wanted)


@functools.cache
def _try(path: Path, content: bytes) -> None:
    """Import it elsewhere first, once for each content: whatever it does, this process goes on."""
    tried(lambda: _imported(path), f"plug-in {path}")


def _imported(path: Path) -> ModuleType:
    """The file as a module. Its estimators are known by it, read anew each time, and never join the registry."""
    module_name = f"twinbench_plugin_{path.stem}"
    spec = spec_of_file(module_name, path)
    if spec is None or spec.loader is None:
        raise BadInput(f"plug-in {path} is no Python module; give the path of a .py file")
    module = importlib.util.module_from_spec(spec)
    sys.modules[module_name] = module
    ours = dict(REGISTRY)
    REGISTRY.clear()
    about_to("importing it")
    try:
        with contextlib.redirect_stdout(sys.stderr):  # what a file prints must not get into our output
            spec.loader.exec_module(module)
    except (Exception, SystemExit) as error:
        del sys.modules[module_name]
        raise BadInput(f"plug-in {path} fails to import: {one_line(error)}; mend the file") from error
    finally:
        # What the file is the first to import of ours stays: it will not be imported again.
        imported = {name: kind for name, kind in REGISTRY.items() if kind.__module__.startswith("twinbench.")}
        REGISTRY.clear()
        REGISTRY.update(ours | imported)
    return module


def _estimator_in(module: ModuleType, path: Path, wanted: str) -> type[Estimator]:
    module_name = module.__name__
    found = {c.__name__: c for c in vars(module).values() if _is_estimator(c) and c.__module__ == module_name}
    if wanted and wanted not in found:
        raise BadInput(f"plug-in {path} has no Estimator class {wanted!r}; it has: {', '.join(found) or 'none'}")
    if not wanted and len(found) != 1:
        raise BadInput(
            f"plug-in {path} has {len(found)} Estimator classes ({', '.join(found) or 'none'}); "
            f"decorate one with @register, or name it: {path}:Class"
        )
    kind = _complete(found[wanted] if wanted else next(iter(found.values())), f"plug-in {path}")
    if kind.name in LABELS:
        raise BadInput(f"plug-in {path}: {kind.name!r} is one of the benchmark's own names; choose another")
    return kind


def _is_estimator(what: Any) -> bool:
    return isinstance(what, type) and issubclass(what, Estimator) and hasattr(what, "name")


def _complete(kind: type[Estimator], where: str) -> type[Estimator]:
    if missing := sorted(kind.__abstractmethods__):
        raise BadInput(f"{where}: {kind.__name__} has no {', no '.join(missing)}; write that method")
    if wrong := wrong_name(kind.name):
        raise BadInput(f"{where}: {wrong}")
    for declared in ("settings", "search_space", "ablations"):
        value = getattr(kind, declared)
        if not isinstance(value, Mapping) or not all(isinstance(name, str) for name in value):
            raise BadInput(f"{where}: {declared} of {kind.__name__} is no dict by name; write one")
    return kind


def wrong_name(name: Any) -> str:
    """What is wrong with an estimator's name, which becomes part of file names; empty if nothing."""
    if isinstance(name, str) and len(name) <= LONGEST_NAME and re.fullmatch(r"\w[\w.-]*", name):
        return ""
    shown = repr(name) if len(repr(name)) <= LONGEST_NAME else f"{repr(name)[:LONGEST_NAME]}..."
    return f"the name {shown} cannot be a file name; use at most {LONGEST_NAME} letters, digits, _, - and ."


def one_line(error: BaseException) -> str:
    """An error as one line to read."""
    return f"{type(error).__name__}: {error}".splitlines()[0]
