"""Documents that programs read: strict JSON, and the provenance that each of them holds."""

from __future__ import annotations

import datetime
import json
import math
import sys
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from twinbench.common.filespec import split_spec
from twinbench.common.store import sha256_of
from twinbench.common.versions import provenance


def to_json(document: Mapping[str, Any]) -> str:
    """Strict JSON, with null for what is no finite number."""
    return json.dumps(strict(document), indent=2, allow_nan=False, ensure_ascii=False)


def strict(value: Any) -> Any:
    """A value as JSON in UTF-8 can hold it: plain Python, None for what is no finite number."""
    if isinstance(value, str):
        return value.encode(errors="replace").decode()  # a path may hold bytes that are no text
    if isinstance(value, Mapping):
        return {strict(str(key)): strict(item) for key, item in value.items()}
    if isinstance(value, np.ndarray | np.generic):
        return strict(value.tolist())
    if isinstance(value, list | tuple):
        return [strict(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


def made_from(settings: Mapping[str, Any], files: Iterable[Mapping[str, Any]]) -> dict[str, Any]:
    """The provenance of a document: the settings that decide it, the files that were read, when, and by what.

    Args:
        settings: by name, as they were given.
        files: each as ``read_file`` tells it; one that is told twice counts once.
    """
    each = list({json.dumps(file): dict(file) for file in files}.values())
    now = datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds")
    return {"time": now, "settings": dict(settings), "files": each, **provenance()}


def read_file(role: str, spec: str | Path, held_out: bool = False) -> Iterator[dict[str, Any]]:
    """Path, size and checksum of the file that a spec names; nothing where it names none, as ``compressor`` does.

    Args:
        role: what the file was read for.
        spec: a path, ``FILE[:NAME]``, or ``package.module:NAME`` whose module is imported already.
        held_out: nothing is learnt from it.
    """
    named = spec.as_posix() if isinstance(spec, Path) else split_spec(spec)[0]
    file = named
    if not named:
        named, colon, _ = str(spec).partition(":")
        file = (getattr(sys.modules.get(named), "__file__", None) or "") if colon else ""
    if file:
        path = Path(file)
        about = {"role": role, "path": named, "held_out": held_out}
        yield {**about, "bytes": path.stat().st_size, "sha256": sha256_of(path)}
