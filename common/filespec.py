"""``FILE[:NAME]``: the one place that takes a spec apart, on every system."""

from __future__ import annotations

import importlib.util
import os
import re
from importlib.machinery import ModuleSpec, SourceFileLoader
from pathlib import Path
from types import CodeType

USER_FILE = "twinbench_file_"
"""Modules of users' files are named so."""
# The longest file that there can be, so that the colon of C:\x\my.py is none that a name follows.
_FILE = re.compile(r"(?P<file>.+\.(?:py|toml|fmu))(?::(?P<name>.*))?", re.DOTALL)


def split_spec(spec: str) -> tuple[str, str]:
    """The file (.py, .toml or .fmu) and what follows its colon; no file where the spec names none.

    ``package.module:NAME`` and plain names have no file. The name may hold colons of its own.
    """
    match = _FILE.fullmatch(spec)
    return (match["file"], match["name"] or "") if match else ("", "")


def join_spec(file: str | Path, name: str) -> str:
    """The spec of a file and a name."""
    return f"{file}:{name}" if name else str(file)


def moved(spec: str, was: Path, now: Path) -> str:
    """A spec with its file, if it has one, told from folder ``now`` instead of from ``was``; with strokes forward.

    Where no relative path leads there, as from one drive to another, the path is absolute.
    """
    file, name = split_spec(spec)
    if not file:
        return spec
    target = os.path.join(was.absolute(), file)
    try:
        target = os.path.relpath(target, now.absolute())
    except ValueError:
        target = os.path.abspath(target)
    return join_spec(Path(target).as_posix(), name)


def spec_of_file(name: str, path: Path) -> ModuleSpec | None:
    """What Python imports a user's file by; None where it cannot be a module of Python."""
    if path.suffix != ".py":
        return None
    file = path.absolute()  # what a traceback names has to be the file that the spec names
    return importlib.util.spec_from_file_location(name, file, loader=_FromSource(name, str(file)))


class _FromSource(SourceFileLoader):
    """Compiles the file each time, and leaves nothing beside it.

    Python knows kept bytecode by the file's size and second. Two edits may share both.
    """

    def get_code(self, fullname: str) -> CodeType:
        path = self.get_filename(fullname)
        return self.source_to_code(self.get_data(path), path)  # type: ignore[no-any-return]
