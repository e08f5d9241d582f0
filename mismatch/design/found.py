"""What an earlier verdict says of the experiment to come: the recordings, what is contested, and what is sure."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from twinbench.common.errors import BadInput
from twinbench.common.shown import shown
from twinbench.common.store import sha256_of
from twinbench.data.sidecar import sidecar_of
from twinbench.mismatch.rounded import ROUNDS
from twinbench.mismatch.stuck import STANDS_STILL

_SETTINGS = ("catalogue", "map", "leave_out", "prior", "measured")


@dataclass(frozen=True)
class Found:
    """A verdict's part in a design.

    Attributes:
        recordings, hold_out: files of recordings, those learnt from and those held back.
        settings: what ``mismatch`` was told, by option.
        linear: do inputs go in lines from sample to sample?
        contested: names of the first finding that has several.
        sure: names of the other findings that have one.
        weights: the verdict's probability of each name of that finding.
        since_s: from when the effects are there, on the recordings' clock.
    """

    recordings: tuple[Path, ...]
    hold_out: tuple[Path, ...]
    settings: Mapping[str, Any]
    linear: bool
    contested: tuple[str, ...]
    sure: tuple[str, ...]
    weights: Mapping[str, float]
    since_s: float


def read_found(path: Path) -> Found:
    """Read a ``verdict.json``.

    Raises:
        BadInput: it is none, or a recording is gone or has changed since.
    """
    document = _document(path)
    try:
        provenance, findings = document["provenance"], document["findings"]
        files = [f for f in provenance["files"] if f["role"] == "recording"]
        settings = {key: provenance["settings"][key] for key in _SETTINGS}
        linear = document["inputs"]["inputs"] == "linear"
        sets = [f for f in findings if f["mechanism"] and f["indistinguishable_from"]]
        single = [f for f in findings if f["mechanism"] and not f["indistinguishable_from"]]
        names = (sets[0]["mechanism"], *sets[0]["indistinguishable_from"]) if sets else ()
        since = [f["since_s"] for f in (*sets, *single) if f["since_s"] is not None]
        sure = tuple(f["mechanism"] for f in single if not f["mechanism"].startswith((ROUNDS, STANDS_STILL)))
        weights = {name: float(p) for name, p in sets[0]["weights"].items()} if sets else {}
        paths = [(_unchanged(f, path), bool(f["held_out"])) for f in files]
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        missing = shown(str(error))
        raise BadInput(f"{path}: is no verdict.json of this version: {missing}; run mismatch again") from error
    joined = {join.resolve() for one, _ in paths for join in sidecar_of(one).join}
    own = [(one, held) for one, held in paths if one.resolve() not in joined]
    return Found(
        tuple(one for one, held in own if not held),
        tuple(one for one, held in own if held),
        settings,
        linear,
        names,
        sure,
        weights,
        float(since[0]) if since else -np.inf,
    )


def rivals_of(told: Sequence[str], found: Found | None) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Names of the rivals, and of what is there besides; those that a verdict contests if none are told."""
    rivals = tuple(dict.fromkeys(told)) or (found.contested if found else ())
    beside = tuple(name for name in (found.sure if found else ()) if name not in rivals)
    return rivals, beside


def _document(path: Path) -> dict[str, Any]:
    try:
        read = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        why = error.strerror
        raise BadInput(f"{path}: cannot be read: {why}; give the verdict.json that mismatch wrote") from error
    except (ValueError, RecursionError) as error:
        raise BadInput(f"{path}: is not JSON; give the verdict.json that mismatch wrote") from error
    if not isinstance(read, dict):
        raise BadInput(f"{path}: is no verdict; give the verdict.json that mismatch wrote")
    return read


def _unchanged(file: Mapping[str, Any], verdict: Path) -> Path:
    path = Path(str(file["path"]))
    if not path.is_file():
        raise BadInput(f"{verdict}: its recording {path} is not there; run this where mismatch was run, or put it back")
    if sha256_of(path) != file["sha256"]:
        raise BadInput(f"{verdict}: its recording {path} has changed since; run mismatch again")
    return path
