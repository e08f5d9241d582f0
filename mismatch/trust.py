"""Whose Python a ``model.toml`` may run: that in or below its own folder or the one the command is called in."""

from __future__ import annotations

import importlib.util
import logging
import os
from dataclasses import dataclass
from importlib.machinery import PathFinder
from pathlib import Path

from twinbench.common.filespec import split_spec
from twinbench.common.shown import printable
from twinbench.physics.load import BUILTIN

_LOG = logging.getLogger("twinbench")
_OURS = "twinbench.physics."


@dataclass(frozen=True)
class Trust:
    """Where the Python that a ``model.toml`` names may lie.

    Attributes:
        toml: the file that the user named; those that it names in turn are judged by its folder.
        folders: resolved; what lies in or below them is run without asking.
        everything: the user has said --trust.
    """

    toml: Path
    folders: tuple[Path, ...]
    everything: bool

    @classmethod
    def of(cls, toml: Path, everything: bool) -> Trust:
        """What a user trusts who names this file from the folder that this is called in."""
        return cls(toml, (Path.cwd().resolve(), toml.resolve().parent), everything)

    def check(self, spec: str) -> None:
        """Say whose Python is about to be run, before anything of it is.

        Args:
            spec: as named in the file, its path told from the folder that this is called in.

        Raises:
            ValueError: it lies elsewhere, symbolic links followed.
        """
        if spec in BUILTIN or spec.startswith(_OURS):
            return
        file = _file_of(spec)
        if file is None:
            return
        if not self.everything and not any(file.is_relative_to(folder) for folder in self.folders):
            raise ValueError(
                f"{self.toml}: would run code from {file}, which is neither in its folder nor in the one you are in; "
                "read that file, and if you trust it, say --trust"
            )
        _LOG.warning("twinbench: %s", printable(f"{self.toml} runs code from {file}"))


def _file_of(spec: str) -> Path | None:
    """The file whose code a spec runs, links followed; of a package its top. Nothing if there is none to be run."""
    file, _ = split_spec(spec)
    if file:
        return Path(file).resolve() if os.path.isfile(file) else None
    package = spec.partition(":")[0].partition(".")[0]
    try:
        found = importlib.util.find_spec(package) or PathFinder.find_spec(package, [str(Path.cwd())])
    except (ImportError, ValueError):
        return None
    if found is None or found.origin in ("frozen", "built-in"):
        return None
    places = [found.origin] if found.origin else list(found.submodule_search_locations or ())
    return Path(places[0]).resolve() if places else None
